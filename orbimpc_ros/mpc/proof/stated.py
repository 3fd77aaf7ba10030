# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A problem in numbers, floats or fractions, as its bounds are verified from; its limits.

Nothing here is condensed: motion is stated a step at a time, costs as weights of squares. Whatever
a state eases (who is outside of a cone, or inside of a margin) is a number here, which proofs take
for granted.

Mathematics: docs/mathematics.md, 1 and 3.7 to 3.10, and docs/proofs.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.faces import STEEPEST_CAP, cap, icosahedron, normals
from orbimpc_ros.mpc.model.translation import step_of
from orbimpc_ros.mpc.problem import Ball, Problem, State
from orbimpc_ros.mpc.problem.approach import LEEWAY
from orbimpc_ros.mpc.problem.cones import relief
from orbimpc_ros.mpc.problem.pace import entry_speed
from orbimpc_ros.mpc.problem.traffic import traffic_of
from orbimpc_ros.mpc.proof.arithmetic import TURN, Number, direction, root, roots
from orbimpc_ros.mpc.proof.flight import (
    DECIDED,
    END,
    ENDS,
    FIRST,
    STEP,
    TIED,
    VELOCITY,
    WANTED,
    WIND,
    Motion,
    control_points,
    controls_of,
    flown_by,
)

NARROW = 1e-9  # [rad] by which what is treated as below half a turn, or a turn, is
WIDER = 1e-12  # [rad] by which sectors are wider than they are stated, for rounding of angles
ROUNDING = 1e-15  # of a chord
INWARD = 1.0 - 1e-12  # of a speed, for rounding
UNTURNED = math.pi - 1e-9  # [rad] a turn limit that is as good as none
FREE, SEGMENT, POINT = range(3)  # what R_1 may be
SPEEDS = 'none', 'circle', 'polygon'  # floors whose least speeds are known
UP = 0.0, 0.0, 1.0
NOTHING: Array = np.zeros(0)
Rows = Any  # an array of numbers, of floats or of fractions


class Cone(NamedTuple):
    """Directions that headings of some steps are in.

    At its least speed it ends flat: z . axis >= cos(angle) max(|z|, least).

    Attributes:
        axis: of any length, n numbers.
        angle: [rad].
        least: share of full speed.
        steps: k >= 1.
    """

    axis: tuple[float, ...]
    angle: float
    least: float
    steps: tuple[int, ...]


class Body(NamedTuple):
    """A box, or a ball, that plans are outside of.

    Attributes:
        low: corner, shape (n,); of a ball its centre [m].
        high: corner; of a ball its centre.
        radius: of a ball [m]; 0 of a box.
        of: what of each step is on one of its sides: its ``END``; both ``ENDS``, from the second
            step on; or all of the ``STEP``, that is, its control points.
        shifts: by how much it has moved by the ends of steps 0..N, shape (N + 1, n) [m].
        grown: by how much it counts as larger in each step, shape (N,) [m].
    """

    low: Array
    high: Array
    radius: float
    of: int
    shifts: Array
    grown: Array


class Limits(NamedTuple):
    """What a problem's own numbers do not say.

    Attributes:
        cones: of the tilt, where it is not eased, and of the approach.
        glide_slope: angle [rad]; 0 without.
        eased: by how much s_1..s_N may be outside of it, shape (N,) [m].
        bodies: in the order in which choices number them.
        entry: share of full speed that changes begin from.
        change: by how much it changes in a step at most; infinity without a limit.
    """

    cones: tuple[Cone, ...] = ()
    glide_slope: float = 0.0
    eased: Array = NOTHING
    bodies: tuple[Body, ...] = ()
    entry: float = 0.0
    change: float = math.inf


NO_LIMITS = Limits()


class Costs(NamedTuple):
    """Weights of squares, and of lengths.

    Attributes:
        weights: of |s_k - g_k|^2 (the first is of no use), and of |z_k|, shape (2, N + 1).
        braked: of |p_N|^2.
        turned: of squared differences of coordinates of rotations.
        aimed: of the squared coordinates of R_N - R_g.
    """

    weights: Rows
    braked: Number
    turned: Number
    aimed: Number


class Root(NamedTuple):
    """What is known of single steps before any split.

    Attributes:
        span: least and greatest direction [rad] of each step in the plane, a turn or more apart
            where all are allowed, and least and greatest speed, shape (4, N).
        turn: by how much directions change in a step at most; negative without a limit.
        change: the same of speeds; 2 without a limit.
        aim: direction of the approach in the plane [rad].
        aside: largest angle from it [rad]; negative without a limit.
        patches: triangles that cover all directions, and then those that cover the tilt's cap,
            shape (F, 3, 3).
        exchanged: how many of the first steps can be exchanged, with no limit but the floor that
            tells them apart.
    """

    span: Rows
    turn: Number
    change: Number
    aim: Number
    aside: Number
    patches: Rows
    exchanged: int


class Sets(NamedTuple):
    """What stage sets are made of.

    Attributes:
        least: the floor's share of full speed; of a polygon or solid the distance of its faces.
        polygon: faces of a polygon in the plane; 0 without.
        faces: normals of the faces of a solid in space, shape (F, n).
        cone_step: which headings 0..N-1 cones are of, shape (Q,).
        cones: their axes, unit vectors; cosine and sine of their angles, their least speeds, and 1
            where patches of the tilt's cap are as wide, shape (Q, n + 4).
        full: a turn, or hardly more [rad].
        narrow: what is as good as no angle [rad].
    """

    least: Number
    polygon: int
    faces: Rows
    cone_step: np.ndarray
    cones: Rows
    full: Number
    narrow: Number


class Ends(NamedTuple):
    """What couples steps, but for bodies.

    Attributes:
        goals: g_1..g_N less s_0, and in the last column by how much the glide slope is eased, shape
            (N, n + 1).
        arrives: how many vectors vanish at the end: s_N - g_N, and p_N.
        chord: how far R e1 moves in a step at most; negative without a limit.
        begun: the first step 0..N-1 of which that is so.
        sine: of the glide slope; 0 without.
        cosine: of it.
    """

    goals: Rows
    arrives: int
    chord: Number
    begun: int
    sine: Number
    cosine: Number


class Bodies(NamedTuple):
    """What plans are outside of.

    Attributes:
        of: what of a step is on a side of a body, shape (J,).
        extents: of boxes, -low and then high, less s_0; last the radius of balls, 0 of boxes;
            shape (J, 2 n + 1).
        centres: of balls, less s_0, and by how much bodies have moved, at each control point,
            shape (J, N, 4, n).
        margins: by how much bodies count as larger, and how far apart control points of a step
            are, as a body sees them, shape (2, J, N).
    """

    of: np.ndarray
    extents: Rows
    centres: Rows
    margins: Rows


class Stated(NamedTuple):
    """A problem: dimension n, d coordinates of a rotation that its cost sees, rotation order."""

    n: int
    width: int
    order: int
    decided: int  # ``FREE``, ``SEGMENT`` or ``POINT``: what R_1 may be
    motion: Motion
    costs: Costs
    start: Rows
    root: Root
    sets: Sets
    ends: Ends
    bodies: Bodies


def width_of(problem: Problem) -> int:
    """Return how many coordinates of a rotation the cost sees."""
    w = problem.weights
    if problem.dimension == 2:
        return 2
    return 9 if w.input or w.attitude or problem.rotation_order == 2 else 3


class Statement:
    """States one problem for any state, in one arithmetic.

    Args:
        problem: whose numbers; its obstacles count only as the limits have them.
        number: ``float`` or ``Fraction``.

    Raises:
        BadInput: a model whose numbers are known as floats alone, in fractions.
    """

    def __init__(self, problem: Problem, number: Callable[[Any], Number] = float) -> None:
        self.problem, self._number = problem, number
        self.width = width_of(problem)
        self._motion = self._moved()
        self._costs = self._weighed()
        self._root: Root | None = None

    def _rows(self, values: Any) -> Rows:
        """Return an array of numbers."""
        array = np.array(values, float, order='C')  # of our own: machine code tells them apart
        if self._number is float:
            return array
        made = np.empty(array.shape, object)
        made.ravel()[:] = [Fraction(each) for each in array.ravel().tolist()]
        return made

    def _moved(self) -> Motion:
        problem, number, model = self.problem, self._number, self.problem.translation
        if number is not float and problem.translation_order > 2:
            allowed = 'a model that certificates can state'
            raise BadInput('translation_order', problem.translation_order, allowed)
        h, z = number(problem.step), number(problem.forward)
        once = step_of(model, h, z)
        pairs = ([*map(number, each), number(0)][:2] for each in once[1:])
        (push, add), (follow, after), (blow, gust) = pairs
        drift, keep = map(number, once.transition[:, 1] if model.inertial else (0, 0))
        lead, inertial = h / model.degree, int(model.inertial)
        moved = drift, keep, push, add, follow, after, blow, gust, lead, z, inertial, model.degree
        return Motion(*moved)

    def _weighed(self) -> Costs:
        problem, number, w = self.problem, self._number, self.problem.weights
        q, r, m, a = map(number, (w.position, w.input, w.terminal, w.attitude))
        h, z, more = number(problem.step), number(problem.forward), number(problem.arrival_weight)
        double = 2 if problem.dimension == 2 else 1  # coordinates of R that are there twice
        weights = self._rows(np.full((2, problem.horizon + 1), float(w.position)))
        weights[0, -1] = q + m + more
        braked = more * h * h if problem.inertial else 0 * h
        move = self._motion
        late = move.follow if not problem.inertial else move.after
        late = late / (late + (move.add if problem.inertial else move.push))
        weights[1] = number(w.length) * h * z
        weights[1, 0], weights[1, -1] = (1 - late) * weights[1, 0], late * weights[1, -1]
        turned = double * r / h ** (2 * problem.rotation_order)
        return Costs(weights, braked, turned, double * a)

    def limits(self, state: State, goals: Array) -> Limits:
        """Return what :func:`limits_of` does, bodies at rest as they were the last time."""
        return limits_of(self.problem, state, goals, self.boxes)

    def of(self, state: State, goals: Array, limits: Limits) -> Stated:
        """Return the problem from a state.

        Args:
            state: where trajectories start; not its hazards, which are among the limits.
            goals: g_1..g_N, shape (N, n) [m].
            limits: beside those that are the problem's own.
        """
        problem = self.problem
        decided, start = self._begun(state)
        cones = self._cones(state, limits)
        root = self._rooted(state, limits, cones)
        sets = self._set(cones) if cones else self._without_cones
        origin = self._rows(state.position)
        ends = self._ended(self._rows(goals) - origin, limits)
        rest = limits.bodies is self.boxes
        bodies = self._beside_boxes(origin) if rest else self._beside(origin, limits.bodies, start)
        kinds = problem.dimension, self.width, problem.rotation_order, decided
        return Stated(*kinds, self._motion, self._costs, start, root, sets, ends, bodies)

    # --- where trajectories begin

    def _begun(self, state: State) -> tuple[int, Rows]:
        """Return what R_1 may be, and what is known of a start."""
        problem, n = self.problem, self.problem.dimension
        known, kind = np.zeros((6, self.width)), FREE
        known[VELOCITY, :n], known[WIND, :n] = state.velocity, state.disturbance
        known[FIRST] = known[TIED] = self._seen(state.rotation)
        if state.wanted is not None:
            known[WANTED] = self._seen(state.wanted)
        if problem.rotation_order == 2:
            kind = POINT if state.coasted is None else SEGMENT
            known[DECIDED] = self._seen(state.rotation_rate if kind == POINT else state.coasted)
        elif problem.turns_are_angles:
            known[TIED, :n] = state.attitude[:, 0]
        start = self._rows(known)
        if kind == POINT:
            start[DECIDED] = start[FIRST] + self._number(problem.step) * start[DECIDED]
        return kind, start

    def _seen(self, rotation: Any) -> Array:
        """Return the coordinates of a rotation, column by column, as far as the cost sees them."""
        return rotation.T.ravel() if self.width == 9 else rotation[:, 0]

    # --- what single steps are subject to

    def _rooted(self, state: State, limits: Limits, cones: Sequence[Cone]) -> Root:
        problem, number, count = self.problem, self._number, self.problem.horizon
        plain = limits is NO_LIMITS and not problem.max_rate and state.coasted is None
        if plain and self._root is not None:
            return self._root
        steps, change = np.arange(1, count + 1), number(2)
        turn, low, high = self._turned(state)
        span = self._rows(np.zeros((4, count)))
        span[0], span[1], span[2], span[3] = low, high, number(self._least), number(1)
        if limits.change < 2.0:
            entry, change = number(limits.entry), number(limits.change)
            span[2] = np.maximum(span[2], entry - steps * change)
            span[3] = np.minimum(span[3], entry + steps * change)
        if problem.floor.shape == 'polygon' and state.coasted is not None:
            n, axis = problem.dimension, self._rows(state.coasted[:, 0])
            along = max(self._rows(normals(n, problem.floor.faces)) @ axis)
            if problem.rotation_order == 2 and 0 < along < 1:  # on its way the faces are farther
                span[2, 0] = max(span[2, 0], number(self._least) / along * number(INWARD))
        aim, aside = number(0), number(-1)
        for each in cones if problem.dimension == 2 else ():  # of the approach, the only one
            aim, aside = number(math.atan2(each.axis[1], each.axis[0])), number(each.angle)
        root = Root(span, turn, change, aim, aside, self._patches, self._exchanged(limits))
        if plain:
            self._root = root  # which no state changes
        return root

    @cached_property
    def _least(self) -> float:
        floor = self.problem.floor
        return floor.fraction if floor.exists and floor.shape in SPEEDS else 0.0

    @cached_property
    def _patches(self) -> Rows:
        """Return the triangles that directions begin with, and those of the tilt's cap."""
        problem = self.problem
        if problem.dimension == 2:
            return self._rows(np.zeros((0, 3, 3)))
        capped = 0.0 < problem.tilt <= STEEPEST_CAP
        return self._rows(np.concatenate([icosahedron(), *[cap(problem.tilt)] * capped]))

    @cached_property
    def _without_cones(self) -> Sets:
        return self._set(())

    def _set(self, cones: Sequence[Cone]) -> Sets:
        problem, number, n = self.problem, self._number, self.problem.dimension
        floor = problem.floor
        faces = floor.faces if floor.shape == 'polygon' and floor.exists else 0
        solid = normals(3, faces) if faces and n == 3 else np.zeros((0, n))
        step = np.array([k - 1 for each in cones for k in each.steps], np.int64)
        rows = self._coned([each for each in cones for _ in each.steps])
        known = number(self._least), faces if n == 2 else 0, self._rows(solid), step, rows
        return Sets(*known, number(TURN), number(NARROW))

    def _cones(self, state: State, limits: Limits) -> list[Cone]:
        """Return cones, those included that turns lead out of only after some steps."""
        problem, cones = self.problem, [each for each in limits.cones if each.steps]
        if problem.dimension == 2 or problem.rotation_order == 2 or not problem.turns_are_angles:
            return cones
        axis, turn = tuple(state.attitude[:, 0].tolist()), problem.widest_turn
        steps = range(1, 1 + min(problem.horizon, math.ceil(math.pi / turn) - 1))
        return cones + [Cone(axis, k * turn + WIDER, 0.0, (k,)) for k in steps]

    def _coned(self, cones: Sequence[Cone]) -> Rows:
        n, tilt = self.problem.dimension, self.problem.tilt
        rows = self._rows(np.zeros((len(cones), n + 4)))
        for row, each in zip(rows, cones, strict=True):
            axis = self._rows(each.axis)
            row[:n] = axis / root((axis * axis).sum())
            row[n : n + 2] = direction(self._number(each.angle))
            row[n + 2] = self._number(each.least)
            capped = 0.0 < tilt <= STEEPEST_CAP and each.axis == UP and each.angle == tilt
            row[n + 3] = self._number(1 if capped else 0)
        return rows

    def _turned(self, state: State) -> tuple[Number, Rows, Rows]:
        """Return by how much directions change at most, the least and the greatest of each step."""
        problem, number = self.problem, self._number
        count, turn = problem.horizon, number(problem.step) * number(problem.max_rate)
        whole = self._rows(np.zeros(count))
        limited = problem.dimension == 2 and problem.turns_are_angles and turn < UNTURNED
        if not limited or (problem.rotation_order == 2 and state.coasted is None):
            return number(-1), whole, whole + number(7)
        late = problem.rotation_order - 1
        ahead = state.attitude if state.coasted is None or not late else state.coasted
        heading = number(math.atan2(ahead[1, 0], ahead[0, 0]))
        cosine, sine = direction(heading)
        x, y = self._rows(ahead[:, 0])
        if not abs(cosine * y - sine * x) < WIDER / 4 or not cosine * x + sine * y > 0:
            raise BadInput('state.attitude', ahead.tolist(), 'a rotation')
        turns = (np.arange(1, count + 1) - late) * (turn + whole) + number(WIDER)
        low, high = heading - turns, heading + turns
        return turn, low, high

    def _exchanged(self, limits: Limits) -> int:
        """Return how many first steps the cost sees only the sum and the lengths of headings of."""
        alone = not (limits.cones or limits.bodies or limits.glide_slope or limits.change < 2.0)
        return self.problem.horizon - 1 if alone and self._alike else 0

    @cached_property
    def _alike(self) -> bool:
        problem, costs, move = self.problem, self._costs, self._motion
        costly = bool((costs.weights[0, 1:-1] != 0).any()) or costs.turned or problem.inertial
        if costly or problem.max_rate or problem.rotation_order == 2:
            return False
        return bool(problem.dimension == 2 and move.drift == 0 and problem.horizon > 1)

    # --- what couples steps

    def _ended(self, goals: Rows, limits: Limits) -> Ends:
        problem, number, n = self.problem, self._number, self.problem.dimension
        known = self._rows(np.zeros((problem.horizon, n + 1)))
        known[:, :n], slope = goals, (number(0), number(0))
        if limits.glide_slope:
            known[:, n] = self._rows(limits.eased)
            slope = direction(number(limits.glide_slope))[::-1]
        chord = number(-1)
        if problem.max_rate:
            chord = number(problem.chord) + number(ROUNDING)
        arrives = (1 + problem.inertial) * (problem.terminal == 'constraint')
        begun = int(problem.first_turn_is_decided)
        return Ends(known, arrives, chord, begun, *slope)

    @cached_property
    def boxes(self) -> tuple[Body, ...]:
        """Return what is at rest among bodies."""
        return boxes_of(self.problem)

    @cached_property
    def _at_rest(self) -> Bodies:
        """Return that, seen from the origin."""
        start = self._rows(np.zeros((6, self.width)))
        return self._beside(self._rows(np.zeros(self.problem.dimension)), self.boxes, start)

    def _beside_boxes(self, origin: Rows) -> Bodies:
        n, known = self.problem.dimension, self._at_rest
        if not self.boxes:
            return known
        extents = known.extents.copy()
        extents[:, :n] += origin
        extents[:, n : 2 * n] -= origin
        return known._replace(extents=extents)

    def _beside(self, origin: Rows, bodies: Sequence[Body], start: Rows) -> Bodies:
        n, count = self.problem.dimension, self.problem.horizon
        low = self._rows([each.low for each in bodies]).reshape(-1, n) - origin
        high = self._rows([each.high for each in bodies]).reshape(-1, n) - origin
        radii = self._rows([each.radius for each in bodies])
        grown = self._rows([each.grown for each in bodies]).reshape(-1, count)
        shifts = self._rows([each.shifts for each in bodies]).reshape(-1, count + 1, n)
        of = np.array([each.of for each in bodies], np.int64)
        still = np.where(radii[:, None] > 0, low, 0 * low)
        begun, moved = still[:, None] + shifts[:, :-1], shifts[:, 1:] - shifts[:, :-1]
        at = control_points(tuple(of.tolist()), count, self._motion.degree)
        along = self._rows(np.maximum(at, 0))[..., None] / self._motion.degree
        centres = begun[:, :, None] + moved[:, :, None] * along
        margins = np.stack([grown, 0 * grown])
        if any(each.radius and each.of == STEP for each in bodies):
            margins[1] = self._spread(bodies, centres, start)
        extents = np.concatenate([-low, high, radii[:, None]], axis=1)
        return Bodies(of, extents, centres, margins)

    def _spread(self, bodies: Sequence[Body], centres: Rows, start: Rows) -> Rows:
        """Return how far apart control points of steps get, as bodies see them, shape (J, N).

        Headings are no longer than 1.
        """
        n, count, m = self.problem.dimension, self.problem.horizon, self._motion.degree + 1
        flown = flown_by(self._motion, start[:, :n], self._rows(np.zeros((count, n))))
        free, (a, b) = controls_of(self._motion, flown), np.triu_indices(m, 1)
        fastest = max(self._number(1), root((start[DECIDED, :n] ** 2).sum()))  # R_1 may be longer
        spread = self._rows(np.zeros((len(bodies), count)))
        for j, body in enumerate(bodies):
            if body.radius and body.of == STEP:
                places = free - centres[j, :, :m]
                gaps = roots(((places[:, a] - places[:, b]) ** 2).sum(axis=-1))
                spread[j] = (fastest * self._apart + gaps).max(axis=1)
        return spread

    @cached_property
    def _apart(self) -> Rows:
        """Return how far apart headings of length 1 take two control points, shape (N, pairs)."""
        units, none = (
            self._rows(each)
            for each in (np.eye(self.problem.horizon), np.zeros((6, self.problem.horizon)))
        )
        reach = controls_of(self._motion, flown_by(self._motion, none, units))
        a, b = np.triu_indices(self._motion.degree + 1, 1)
        return np.abs(reach[:, a] - reach[:, b]).sum(axis=-1)


# --- the limits of a problem from one state


def limits_of(
    problem: Problem, state: State, goals: Array, boxes: tuple[Body, ...] | None = None
) -> Limits:
    """Return the limits of a problem from a state to goals.

    Args:
        problem: whose limits.
        state: where plans start.
        goals: g_1..g_N, shape (N, n) [m].
        boxes: those of :func:`boxes_of`, where they are known.
    """
    plain = not (problem.has_cones or problem.approach.exists or problem.max_acceleration)
    if plain and not (problem.obstacles or state.hazards):
        return NO_LIMITS
    cones, slope = list[Cone](), 0.0
    eased: Array = NOTHING
    if problem.has_cones:
        outside = relief(problem, state, goals)
        if problem.tilt:
            steps = tuple((1 + np.flatnonzero(outside.tilt == 0.0)).tolist())
            cones.append(Cone((0.0, 0.0, 1.0), problem.tilt, 0.0, steps))
        if problem.glide_slope:
            slope, eased = problem.glide_slope, outside.slope
    if problem.approach.exists:
        axis, wide = tuple(problem.approach.axis(state).tolist()), problem.approach.cone + LEEWAY
        cones.append(Cone(axis, wide, problem.least_heading, (problem.horizon,)))
    entry, change = 0.0, math.inf
    if problem.max_acceleration and problem.rotation_order == 1:
        entry, change = entry_speed(problem, state), problem.speed_change
    still = boxes_of(problem) if boxes is None else boxes
    return Limits(tuple(cones), slope, eased, still + _moving(problem, state), entry, change)


def boxes_of(problem: Problem) -> tuple[Body, ...]:
    """Return the boxes at rest that plans are outside of, which bodies begin with."""
    n, count = problem.dimension, problem.horizon
    still, kept = np.zeros((count + 1, n)), np.zeros(count)
    of = ENDS if problem.no_corner_cutting else END
    return tuple(Body(each.minimum, each.maximum, 0.0, of, still, kept) for each in problem.boxes)


def _moving(problem: Problem, state: State) -> tuple[Body, ...]:
    """Return each other body twice.

    Of these the end of a step alone is held closer than the hull of its control points.
    """
    traffic, found = traffic_of(problem, state), list[Body]()
    if traffic is None:
        return ()
    for body, shifts, grown in zip(traffic.bodies, traffic.shifts, traffic.grown, strict=True):
        low, high, radius = (
            (body.centre, body.centre, body.radius)
            if isinstance(body, Ball)
            else (body.minimum, body.maximum, 0.0)
        )
        found += [Body(low, high, radius, of, shifts, grown) for of in (END, STEP)]
    return tuple(found)
