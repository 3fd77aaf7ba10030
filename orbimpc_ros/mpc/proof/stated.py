# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A problem and its limits in floats or in fractions, to verify bounds from.

Nothing here is condensed: motion is stated step by step, and costs as weights of squares. Limits
that are relaxed for a state (outside of a cone, or inside of a margin) are numbers here, which
proofs take for granted.

Mathematics: docs/mathematics.md, 1 and 3.7 to 3.10, and docs/proofs.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.faces import STEEPEST_CAP, cap, icosahedron, normals
from orbimpc_ros.mpc.model.translation import controls, step_of
from orbimpc_ros.mpc.problem import Ball, Box, Problem, State
from orbimpc_ros.mpc.problem.cones import relief
from orbimpc_ros.mpc.problem.problem import LEEWAY
from orbimpc_ros.mpc.problem.reach import entry_speed
from orbimpc_ros.mpc.problem.traffic import traffic_of
from orbimpc_ros.mpc.proof.arithmetic import TURN, Number, as_fractions, direction, root, roots
from orbimpc_ros.mpc.proof.flight import (
    DECIDED,
    FIRST,
    TIED,
    VELOCITY,
    WANTED,
    WIND,
    StepMap,
    flown_by,
)
from orbimpc_ros.mpc.proof.tree import POINTS

NARROW = 1e-9  # [rad] margin to a turn, or half a turn, of sectors treated as smaller
WIDER = 1e-12  # [rad] by which sectors are widened, for rounding of angles
ROUNDING = 1e-15  # added to a chord
INWARD = 1.0 - 1e-12  # factor of a speed, for rounding
UNTURNED = math.pi - 1e-9  # [rad]: larger limits on turns are ignored
END, ENDS, STEP = range(3)  # the part of a step that is on one side of a body
UP = 0.0, 0.0, 1.0
SPEEDS = 'none', 'circle', 'polygon'  # floors whose least speeds are known
NOTHING: Array = np.zeros(0)
Rows = Any  # an array of numbers, of floats or of fractions


class Cone(NamedTuple):
    """A cone that contains the headings of some steps.

    It ends flat at its least speed: z . axis >= cos(angle) max(|z|, least).

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
    """A box or a ball that plans must stay outside of.

    Attributes:
        shape: its size, and its place at the start.
        of: the part of each step that is on one of its sides: its ``END``; both ``ENDS``, from the
            second step on; or the whole ``STEP``, that is, its control points.
        shifts: its displacement at the ends of steps 0..N, shape (N + 1, n) [m].
        grown: margin added to its size in each step, shape (N,) [m].
    """

    shape: Box | Ball
    of: int
    shifts: Array
    grown: Array


class Limits(NamedTuple):
    """The limits that are not part of a problem's own numbers.

    Attributes:
        cones: of the tilt, where it is not relaxed, and of the approach.
        glide_slope: angle [rad]; 0 without.
        eased: relaxation of the glide slope for s_1..s_N, shape (N,) [m].
        bodies: in the order in which choices number them.
        entry: initial speed for the limit on changes, as a share of full speed.
        change: largest change of this share in a step; infinity without a limit.
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
        weights: of |s_k - g_k|^2 (the first is unused), and of |z_k|, shape (2, N + 1).
        braked: of |p_N|^2.
        turned: of squared differences of coordinates of rotations.
        aimed: of the squared coordinates of R_N - R_g.
    """

    weights: Rows
    braked: Number
    turned: Number
    aimed: Number


class Root(NamedTuple):
    """The restrictions of single steps before any split.

    Attributes:
        span: least and greatest direction [rad] of each step in the plane, which differ by a turn
            or more if all are allowed, and least and greatest speed, shape (4, N).
        turn: largest change of direction in a step [rad]; negative without a limit.
        change: largest change of speed in a step; 2 without a limit.
        aim: direction of the approach in the plane [rad].
        aside: largest angle from it [rad]; negative without a limit.
        patches: triangles that cover all directions in space, and then those that cover the
            tilt's cap, shape (F, 3, 3).
        exchanged: number of the first steps that are exchangeable: the cost depends only on the sum
            of their headings and on their lengths, and the floor is their only limit.
    """

    span: Rows
    turn: Number
    change: Number
    aim: Number
    aside: Number
    patches: Rows
    exchanged: int


class Sets(NamedTuple):
    """The data of stage sets.

    Attributes:
        least: the floor's share of full speed; for a polygon or solid, the distance of its faces.
        share: angle between the normals of a polygon in the plane [rad]; 0 without.
        faces: normals of the faces of a solid in space, shape (F, n).
        cone_step: heading 0..N-1 of each cone, shape (Q,).
        cones: their axes, unit vectors; cosine and sine of their angles, their least speeds, and 1
            if the patches of the tilt's cap cover them, shape (Q, n + 4).
        full: a turn, rounded up [rad].
        narrow: a negligible angle [rad].
    """

    least: Number
    share: Number
    faces: Rows
    cone_step: np.ndarray
    cones: Rows
    full: Number
    narrow: Number


class Ends(NamedTuple):
    """The constraints between steps, except for bodies.

    Attributes:
        goals: g_1..g_N relative to s_0, and in the last column the relaxation of the glide slope,
            shape (N, n + 1).
        arrives: number of vectors that vanish at the end: s_N - g_N, and p_N.
        chord: largest chord of R e1 in a step; negative without a limit.
        begun: first step, of 0..N-1, to which the chord applies.
        sine: of the glide slope; 0 without.
        cosine: of the glide slope.
    """

    goals: Rows
    arrives: int
    chord: Number
    begun: int
    sine: Number
    cosine: Number


class Bodies(NamedTuple):
    """The boxes and balls that plans must stay outside of.

    Attributes:
        at: the control point of a step that a row constrains, -1 if there is no such row, shape
            (J, N, 4).
        extents: of boxes, 0 and then their size; last the radius of balls, 0 for boxes; shape
            (J, 2 n + 1).
        places: of a box's lower corner or a ball's centre, relative to s_0, at each row's control
            point, shape (J, N, 4, n).
        margins: added to the size of bodies, and the largest distance between control points of
            a step relative to a body, shape (2, J, N).
    """

    at: np.ndarray
    extents: Rows
    places: Rows
    margins: Rows


class Stated(NamedTuple):
    """A problem: dimension n, d coordinates of a rotation in the cost, rotation order, data.

    At rotation order 2 the start gives R_1 up to a factor, which the first range of speeds limits.
    """

    n: int
    width: int
    order: int
    motion: StepMap
    costs: Costs
    start: Rows
    root: Root
    sets: Sets
    ends: Ends
    bodies: Bodies


def width_of(problem: Problem) -> int:
    """Return the number of coordinates of a rotation that are in the cost."""
    w = problem.weights
    if problem.dimension == 2:
        return 2
    return 9 if w.input or w.attitude or problem.rotation_order == 2 else 3


class Statement:
    """The numbers of one problem for any state, in one arithmetic.

    Args:
        problem: to state, without its obstacles, which are among the limits.
        number: ``float`` or ``Fraction``.

    Raises:
        BadInput: fractions of a model whose numbers are floats only.
    """

    def __init__(self, problem: Problem, number: Callable[[Any], Number] = float) -> None:
        self.problem, self._number = problem, number
        self.width = width_of(problem)
        self._motion = self._moved()
        self._costs = self._weighed()
        self._roots = dict[int, Root]()

    def _rows(self, values: Any) -> Rows:
        """Return an array of numbers."""
        return self._numbers(np.array(values, float, order='C'))  # a copy: numba wants it writable

    def _numbers(self, array: Array) -> Rows:
        return array if self._number is float else as_fractions(array)

    def _moved(self) -> StepMap:
        problem, number, model = self.problem, self._number, self.problem.translation
        if number is not float and problem.translation_order > 2:
            allowed = 'a model that certificates can state'
            raise BadInput('translation_order', problem.translation_order, allowed)
        h, z = number(problem.step), number(problem.forward)
        once = step_of(model, h, z)
        drift, keep = once.transition[:, 1] if model.inertial else (0, 0)
        on_s, *on_p = zip(once.push, once.follow, once.blow, strict=True)
        known = drift, keep, *on_s, *(on_p[0] if on_p else (0, z, 1))
        return StepMap._make([*map(number, known), h / model.degree, model.degree])

    def _weighed(self) -> Costs:
        problem, number, w = self.problem, self._number, self.problem.weights
        q, r, m, a = map(number, (w.position, w.input, w.terminal, w.attitude))
        h, z, more = number(problem.step), number(problem.forward), number(problem.arrival_weight)
        double = 2 if problem.dimension == 2 else 1  # coordinates of R that appear twice
        weights = self._rows(np.full((2, problem.horizon + 1), float(w.position)))
        weights[0, -1] = q + m + more
        braked = more * h * h if problem.inertial else 0 * h
        move = self._motion
        early, late = (move.add, move.after) if problem.inertial else (move.push, move.follow)
        late = late / (early + late)
        weights[1] = number(w.length) * h * z
        weights[1, 0], weights[1, -1] = (1 - late) * weights[1, 0], late * weights[1, -1]
        turned = double * r / h ** (2 * problem.rotation_order)
        return Costs(weights, braked, turned, double * a)

    def limits(self, state: State, goals: Array) -> Limits:
        """Return the limits of the problem from a state to goals, shape (N, n) [m]."""
        problem = self.problem
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
            axis, wide = problem.approach.axis(state), problem.approach.cone + LEEWAY
            last = problem.least_heading, (problem.horizon,)
            cones.append(Cone(tuple(axis.tolist()), wide, *last))
        entry, change = 0.0, math.inf
        if problem.max_acceleration and problem.rotation_order == 1:
            entry, change = entry_speed(problem, state), problem.speed_change
        bodies = self.boxes + _moving(problem, state)
        return Limits(tuple(cones), slope, eased, bodies, entry, change)

    def of(self, state: State, goals: Array, limits: Limits) -> Stated:
        """Return the problem from a state.

        Args:
            state: where trajectories start, without its hazards, which are among the limits.
            goals: g_1..g_N, shape (N, n) [m].
            limits: in addition to the problem's own.
        """
        problem = self.problem
        cones = self._cones(state, limits)
        root = self._rooted(state, limits, cones)
        sets = self._set(cones) if cones else self._without_cones
        start, origin = self._begun(state), self._numbers(state.position)
        ends = self._ended(self._numbers(goals) - origin, limits)
        if limits.bodies is self.boxes:
            bodies = self._at_rest
            if self.boxes:
                bodies = bodies._replace(places=bodies.places - origin)
        else:
            bodies = self._beside(origin, limits.bodies, start)
        kinds = problem.dimension, self.width, problem.rotation_order
        return Stated(*kinds, self._motion, self._costs, start, root, sets, ends, bodies)

    # --- the start of trajectories

    def _begun(self, state: State) -> Rows:
        """Return the rows of a start; rotations column by column."""
        problem, n, d = self.problem, self.problem.dimension, self.width
        known, begun = np.zeros((6, d)), state.coasted
        known[VELOCITY, :n], known[WIND, :n] = state.velocity, state.disturbance
        known[FIRST] = known[TIED] = state.rotation.T.ravel()[:d]
        if state.wanted is not None:
            known[WANTED] = state.wanted.T.ravel()[:d]
        if problem.rotation_order == 2:
            known[DECIDED] = (state.rotation_rate if begun is None else begun).T.ravel()[:d]
        elif problem.turns_are_angles:
            known[TIED, :n] = state.attitude[:, 0]
        start = self._numbers(known)
        if problem.rotation_order == 2 and begun is None:
            start[DECIDED] = start[FIRST] + self._number(problem.step) * start[DECIDED]
        if not problem.inertial:
            start[VELOCITY] = self._number(problem.forward) * start[FIRST] + start[WIND]
        return start

    # --- the limits of single steps

    def _rooted(self, state: State, limits: Limits, cones: Sequence[Cone]) -> Root:
        problem, number, count = self.problem, self._number, self.problem.horizon
        plain = not (cones or limits.change < 2.0 or problem.max_rate or state.coasted is not None)
        exchanged = self._exchanged(limits)
        if plain and exchanged in self._roots:
            return self._roots[exchanged]
        change = number(min(2.0, limits.change))
        turn, low, high = self._turned(state)
        span = self._rows(np.zeros((4, count)))
        span[0], span[1] = low, high
        self._set_speeds(span[2:], limits)
        if problem.rotation_order == 2 and state.coasted is None:
            span[2:, 0] = number(1)  # R_1 is given
        if problem.floor.shape == 'polygon' and state.coasted is not None:
            n, axis = problem.dimension, self._rows(state.coasted[:, 0])
            along = max(self._rows(normals(n, problem.floor.faces)) @ axis)
            if problem.rotation_order == 2 and 0 < along < 1:  # on this axis the faces are farther
                span[2, 0] = max(span[2, 0], number(self._least) / along * number(INWARD))
        aim, aside = number(0), number(-1)
        aimed = [each for each in cones if count in each.steps]  # a file may state several
        if problem.dimension == 2 and aimed:
            x, y = aimed[-1].axis
            aim, aside = number(math.atan2(y, x)), number(aimed[-1].angle) + number(WIDER)
        root = Root(span, turn, change, aim, aside, self._patches, exchanged)
        if plain:
            self._roots[exchanged] = root
        return root

    def _set_speeds(self, span: Rows, limits: Limits) -> None:
        """Set the least and the greatest speed of each step, shape (2, N)."""
        number, steps = self._number, np.arange(1, self.problem.horizon + 1)
        span[0], span[1] = number(self._least), number(1)
        if limits.change < 2.0:
            entry, change = number(limits.entry), number(limits.change)
            span[0] = np.maximum(span[0], entry - steps * change)
            span[1] = np.minimum(span[1], entry + steps * change)

    @cached_property
    def _least(self) -> float:
        return self.problem.least_speed if self.problem.floor.shape in SPEEDS else 0.0

    @cached_property
    def _patches(self) -> Rows:
        """Return the triangles that cover all directions, and those of the tilt's cap."""
        if self.problem.dimension == 2:
            return self._rows(np.zeros((0, 3, 3)))
        tilt = self.problem.tilt
        capped = 0.0 < tilt <= STEEPEST_CAP
        return self._rows(np.concatenate([icosahedron(), *[cap(tilt)] * capped]))

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
        share = TURN[number] / faces if faces and n == 2 else number(0)
        known = number(self._least), share, self._rows(solid), step, rows
        return Sets(*known, TURN[number], number(NARROW))

    def _cones(self, state: State, limits: Limits) -> list[Cone]:
        """Return cones, including those that headings can only leave by turns of several steps."""
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
        """Return the largest change of direction, and the least and greatest one of each step."""
        problem, number = self.problem, self._number
        count, turn = problem.horizon, number(problem.step) * number(problem.max_rate)
        whole = self._rows(np.zeros(count))
        limited = problem.dimension == 2 and problem.turns_are_angles and turn < UNTURNED
        if not limited or (problem.rotation_order == 2 and state.coasted is None):
            return number(-1), whole, whole + number(7)
        late = problem.rotation_order - 1
        ahead = state.attitude if state.coasted is None or not late else state.coasted
        heading = number(math.atan2(ahead[1, 0], ahead[0, 0]))
        if number is not float:  # floats trust the arc tangent as much as cosine and sine
            cosine, sine = direction(heading)
            x, y = self._rows(ahead[:, 0])
            if not abs(cosine * y - sine * x) < WIDER / 4 or not cosine * x + sine * y > 0:
                raise BadInput('state.attitude', ahead.tolist(), 'a rotation')
        turns = (np.arange(1, count + 1) - late) * (turn + whole) + number(WIDER)
        low, high = heading - turns, heading + turns
        return turn, low, high

    def _exchanged(self, limits: Limits) -> int:
        """Return the number of first steps that are exchangeable under limits."""
        alone = not (limits.cones or limits.bodies or limits.glide_slope or limits.change < 2.0)
        return self.problem.horizon - 1 if alone and self._alike else 0

    @cached_property
    def _alike(self) -> bool:
        problem, weights = self.problem, self.problem.weights
        costly = weights.position or weights.input or problem.inertial
        freely = problem.rotation_order == 1 and not problem.max_rate
        return problem.dimension == 2 and freely and not costly

    # --- the constraints between steps

    def _ended(self, goals: Rows, limits: Limits) -> Ends:
        problem, number, n = self.problem, self._number, self.problem.dimension
        known = self._numbers(np.zeros((problem.horizon, n + 1)))
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
        """Return the boxes at rest, which are the first of the bodies."""
        problem, n, count = self.problem, self.problem.dimension, self.problem.horizon
        still, kept = np.zeros((count + 1, n)), np.zeros(count)
        of = ENDS if problem.no_corner_cutting else END
        return tuple(Body(each, of, still, kept) for each in problem.boxes)

    @cached_property
    def _at_rest(self) -> Bodies:
        """Return the boxes, relative to the origin."""
        start = self._rows(np.zeros((6, self.width)))
        return self._beside(start[0, : self.problem.dimension], self.boxes, start)

    def _beside(self, origin: Rows, bodies: Sequence[Body], start: Rows) -> Bodies:
        n, count, degree = self.problem.dimension, self.problem.horizon, self._motion.degree
        sizes = [_corners_and_radius(each.shape) for each in bodies]
        low, high, radii = map(self._rows, zip(*sizes, strict=True) if sizes else ((), (), ()))
        low, high, radii = low.reshape(-1, n), high.reshape(-1, n), radii.reshape(-1, 1)
        extents = np.concatenate([0 * low, high - low, radii], axis=1)
        shifts = self._rows([each.shifts for each in bodies]).reshape(-1, count + 1, n)
        at = rows_of(tuple(each.of for each in bodies), count, degree)
        along = self._rows(np.maximum(at, 0))[..., None] / degree
        begun, moved = shifts[:, :-1, None], np.diff(shifts, axis=1)[:, :, None]
        places = (low - origin)[:, None, None] + begun + moved * along
        grown = self._rows([each.grown for each in bodies]).reshape(-1, count)
        margins = np.stack([grown, 0 * grown])
        curved = [j for j, each in enumerate(bodies) if each.of != END and radii[j] > 0]
        if curved:
            spread = self._rows(np.arange(degree + 1.0))[:, None] / degree
            margins[1, curved] = self._spread((begun + moved * spread)[curved], start)
        return Bodies(at, extents, places, margins)

    def _spread(self, centres: Rows, start: Rows) -> Rows:
        """Return the largest distance of control points, relative to bodies, shape (J, N).

        Headings have a length of at most 1. Bodies are at ``centres``, shape (J, N, degree + 1, n).
        """
        n, count, m = self.problem.dimension, self.problem.horizon, self._motion.degree + 1
        free, (a, b) = self._controls(start[:, :n], np.zeros((count, n))), np.triu_indices(m, 1)
        fastest = max(self._number(1), root((start[DECIDED, :n] ** 2).sum()))  # R_1 may be longer
        places = free - centres
        gaps = roots(((places[:, :, a] - places[:, :, b]) ** 2).sum(axis=-1))
        return (fastest * self._apart + gaps).max(axis=2)

    def _controls(self, start: Rows, point: Array) -> Rows:
        """Return the control points of steps from a start, shape (N, degree + 1, n)."""
        motion = self._motion
        flown = flown_by(motion, start, self._rows(point))
        return controls(motion.degree, motion.degree * motion.lead, *flown)

    @cached_property
    def _apart(self) -> Rows:
        """Return the most that headings of length 1 separate control points, shape (N, pairs)."""
        units, none = np.eye(self.problem.horizon), np.zeros((6, self.problem.horizon))
        reach = self._controls(self._rows(none), units)
        a, b = np.triu_indices(self._motion.degree + 1, 1)
        return np.abs(reach[:, a] - reach[:, b]).sum(axis=-1)


# --- bodies


def _corners_and_radius(shape: Box | Ball) -> tuple[Array, Array, float]:
    """Return the corners of a box and 0, or twice the centre of a ball and its radius."""
    if isinstance(shape, Ball):
        return shape.centre, shape.centre, shape.radius
    return shape.minimum, shape.maximum, 0.0


@lru_cache(maxsize=64)
def rows_of(of: tuple[int, ...], count: int, degree: int) -> np.ndarray:
    """Return the control points that rows of N steps constrain, -1 for missing rows, (J, N, 4)."""
    at = np.full((len(of), count, POINTS), -1)
    for rows, part in zip(at, of, strict=True):
        points = {END: [degree], ENDS: [0, degree], STEP: range(degree + 1)}[part]
        rows[:, : len(points)] = points
        if part == ENDS:  # the start of the first step is given
            rows[0, :2] = degree, -1
    return at


def _moving(problem: Problem, state: State) -> tuple[Body, ...]:
    """Return each moving body twice: for the end of a step, and for its control points.

    The end of a step alone is bounded more tightly than the hull of its control points.
    """
    traffic, found = traffic_of(problem, state), list[Body]()
    if traffic is None:
        return ()
    for body, shifts, grown in zip(traffic.bodies, traffic.shifts, traffic.grown, strict=True):
        found += [Body(body, of, shifts, grown) for of in (END, STEP)]
    return tuple(found)
