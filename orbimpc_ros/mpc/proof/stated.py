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
from orbimpc_ros.mpc.proof.tree import NOWHERE, POINTS

NARROW = 1e-9  # [rad] margin to a turn, or half a turn, of sectors treated as smaller
WIDER = 1e-12  # [rad] by which sectors are widened, for rounding of angles
ROUNDING = 1e-15  # added to a chord
INWARD = 1.0 - 1e-12  # factor of a speed, for rounding
UNTURNED = math.pi - 1e-9  # [rad]: larger limits on turns are ignored
END, ENDS, STEP = PARTS = 'end', 'ends', 'step'  # what is on one side of a body
UP = [0.0, 0.0, 1.0]
SPEEDS = 'none', 'circle', 'polygon'  # floors whose least speeds are known
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

    axis: list[float]
    angle: float
    least: float
    steps: list[int]


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
    of: str
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
    eased: Array = NOWHERE
    bodies: tuple[Body, ...] = ()
    entry: float = 0.0
    change: float = math.inf


NO_LIMITS = Limits()


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
    """A problem from a state; at rotation order 2 the start gives R_1 up to a factor.

    Attributes:
        n: dimension.
        order: of rotation.
        full: a turn, rounded up [rad].
        narrow: a negligible angle [rad].
        motion: of a step.
        start: its rows, of the d coordinates of a rotation in the cost, shape (6, d).
        goals: g_1..g_N relative to s_0, and in the last column the relaxation of the glide slope,
            shape (N, n + 1).
        weights: of |s_k - g_k|^2 (the first is unused), and of |z_k|, shape (2, N + 1).
        braked: weight of |p_N|^2.
        turned: weight of squared differences of coordinates of rotations.
        aimed: weight of the squared coordinates of R_N - R_g.
        exchanged: number of the first steps that are exchangeable: the cost depends only on the sum
            of their headings and on their lengths, and the floor is their only limit.
        spans: initial ranges of directions in the plane [rad], if turns are limited, and of speeds,
            shape (2 N, 2).
        turn: largest change of direction in a step [rad]; negative without a limit.
        change: largest change of speed in a step; 2 without a limit.
        aim: direction of the approach in the plane [rad].
        aside: largest angle from it [rad]; negative without a limit.
        least: the floor's share of full speed; for a polygon or solid, the distance of its faces.
        share: angle between the normals of a polygon in the plane [rad]; 0 without.
        faces: normals of the faces of a polygon or solid, shape (F, n).
        patches: triangles that cover all directions in space, and then those that cover the cap of
            a cone about +z, shape (F, 3, 3).
        capped: the headings 0..N-1 in that cone, shape (N,).
        cone_step: heading 0..N-1 of each cone, shape (Q,).
        cones: their axes, unit vectors; cosine and sine of their angles, and their least speeds,
            shape (Q, n + 3).
        arrives: number of vectors that vanish at the end: s_N - g_N, and p_N.
        chord: largest chord of R e1 in a step; negative without a limit.
        begun: first step, of 0..N-1, to which the chord applies: at rotation order 2 a body rate
            decides the first turn, and a chord could only limit the thrust, which a floor must not.
        sine: of the glide slope; 0 without.
        cosine: of the glide slope.
        bodies: that plans must stay outside of.
    """

    n: int
    order: int
    full: Number
    narrow: Number
    motion: StepMap
    start: Rows
    goals: Rows
    weights: Rows
    braked: Number
    turned: Number
    aimed: Number
    exchanged: int
    spans: Rows
    turn: Number
    change: Number
    aim: Number
    aside: Number
    least: Number
    share: Number
    faces: Rows
    patches: Rows
    capped: np.ndarray
    cone_step: np.ndarray
    cones: Rows
    arrives: int
    chord: Number
    begun: int
    sine: Number
    cosine: Number
    bodies: Bodies


class Statement:
    """The numbers of one problem for any state, in one arithmetic.

    Args:
        problem: to state, without its obstacles, which are among the limits.
        number: ``float`` or ``Fraction``.

    Raises:
        BadInput: fractions of a model whose numbers are floats only.

    Attributes:
        base: the problem at the origin, without limits on turns and speeds, and without cones.
    """

    def __init__(self, problem: Problem, number: Callable[[Any], Number] = float) -> None:
        self.problem, self._number = problem, number
        w, plane, late = problem.weights, problem.dimension == 2, problem.rotation_order == 2
        self._width = 2 if plane else 9 if problem.weighs_rotations or late else 3
        self._motion = self._moved()
        free = not (late or problem.max_rate or problem.inertial or w.position or w.input)
        self._alike = plane and free  # the first steps are, unless limits from a state differ
        self.base = self._stated()

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
        coefficients = drift, keep, *on_s, *(on_p[0] if on_p else (0, z, 1))
        return StepMap._make([*map(number, coefficients), h / model.degree, model.degree])

    def _stated(self) -> Stated:
        problem, number, n = self.problem, self._number, self.problem.dimension
        floor, count = problem.floor, problem.horizon
        faces = floor.faces if floor.shape == 'polygon' else 0
        share = TURN[number] / faces if faces and n == 2 else number(0)
        outward = self._rows(normals(3, faces) if faces and n == 3 else np.zeros((0, n)))
        if share:
            outward = np.array([direction(i * share) for i in range(faces)])
        least = problem.least_speed if floor.shape in SPEEDS else 0.0
        spans = self._rows(np.full((2 * count, 2), [least, 1.0]))
        spans[:count] = number(0), TURN[number]
        still = self._rows(np.zeros((6, self._width)))
        return Stated(
            n=n,
            order=problem.rotation_order,
            full=TURN[number],
            narrow=number(NARROW),
            motion=self._motion,
            start=still,
            goals=self._rows(np.zeros((count, n + 1))),
            **self._weighed(),
            exchanged=0,
            spans=spans,
            **dict.fromkeys(('turn', 'aside'), number(-1)),
            change=number(2),
            **dict.fromkeys(('aim', 'sine', 'cosine'), number(0)),
            least=number(least),
            share=share,
            faces=outward,
            patches=self._rows(icosahedron() if n == 3 else np.zeros((0, 3, 3))),
            capped=np.zeros(count, bool),
            cone_step=np.zeros(0, np.int64),
            cones=self._rows(np.zeros((0, n + 3))),
            arrives=(1 + problem.inertial) * (problem.terminal == 'constraint'),
            chord=number(problem.chord) + number(ROUNDING) if problem.max_rate else number(-1),
            begun=int(problem.rotation_order == 2 and floor.exists),
            bodies=self._beside(still[0, :n], self.boxes, still),
        )

    def _weighed(self) -> dict[str, Any]:
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
        return {'weights': weights, 'braked': braked, 'turned': turned, 'aimed': double * a}

    def limits(self, state: State, goals: Array) -> Limits:
        """Return the limits of the problem from a state to goals, shape (N, n) [m]."""
        problem = self.problem
        plain = not (problem.has_cones or problem.approach.exists or problem.max_acceleration)
        if plain and not (problem.obstacles or state.hazards):
            return NO_LIMITS
        cones, eased = list[Cone](), NOWHERE
        if problem.has_cones:
            tilted, eased = relief(problem, state, goals)
            if problem.tilt:
                steps = (1 + np.flatnonzero(tilted == 0.0)).tolist()
                cones.append(Cone(UP, problem.tilt, 0.0, steps))
        if problem.approach.exists:
            axis, wide = problem.approach.axis(state), problem.approach.cone + LEEWAY
            cones.append(Cone(axis.tolist(), wide, problem.least_heading, [problem.horizon]))
        paced = problem.max_acceleration > 0.0 and problem.rotation_order == 1
        entry = entry_speed(problem, state) if paced else 0.0
        change = problem.speed_change if paced else math.inf
        met = traffic_of(problem, state)
        # The end of a step alone is bounded more tightly than the hull of its control points.
        tracks = zip(met.bodies, met.shifts, met.grown, strict=True) if met else ()
        moving = (Body(each, of, *how) for each, *how in tracks for of in (END, STEP))
        bodies = self.boxes + tuple(moving)
        return Limits(tuple(cones), problem.glide_slope, eased, bodies, entry, change)

    def of(self, state: State, aims: Array, limits: Limits) -> Stated:
        """Return the problem from a state.

        Args:
            state: where trajectories start, without its hazards, which are among the limits.
            aims: g_1..g_N, shape (N, n) [m].
            limits: in addition to the problem's own.
        """
        base, start, origin = self.base, self._begun(state), self._numbers(state.position)
        goals, spans = base.goals.copy(), base.spans.copy()
        turned = {**self._turned(state, spans), **self._paced(state, limits, spans)}
        made = {'goals': goals, 'spans': spans, **turned, **self._coned(state, limits)}
        goals[:, :-1] = self._numbers(aims) - origin
        if limits.glide_slope:
            goals[:, -1] = self._rows(limits.eased)
            made['cosine'], made['sine'] = direction(self._number(limits.glide_slope))
        if limits.bodies is not self.boxes:
            made['bodies'] = self._beside(origin, limits.bodies, start)
        elif self.boxes:
            made['bodies'] = base.bodies._replace(places=base.bodies.places - origin)
        alone = not (limits.cones or limits.bodies or limits.glide_slope or limits.change < 2.0)
        if alone and self._alike:
            made['exchanged'] = self.problem.horizon - 1
        return base._replace(start=start, **made)

    # --- the start of trajectories

    def _begun(self, state: State) -> Rows:
        """Return the rows of a start; rotations column by column."""
        problem, n, d = self.problem, self.problem.dimension, self._width
        rows, begun = np.zeros((6, d)), state.coasted
        rows[VELOCITY, :n], rows[WIND, :n] = state.velocity, state.disturbance
        rows[FIRST] = rows[TIED] = state.rotation.T.ravel()[:d]
        if state.wanted is not None:
            rows[WANTED] = state.wanted.T.ravel()[:d]
        if problem.rotation_order == 2:
            rows[DECIDED] = (state.rotation_rate if begun is None else begun).T.ravel()[:d]
        elif problem.turns_are_angles:
            rows[TIED, :n] = state.attitude[:, 0]
        start = self._numbers(rows)
        if problem.rotation_order == 2 and begun is None:
            start[DECIDED] = start[FIRST] + self._number(problem.step) * start[DECIDED]
        if not problem.inertial:
            start[VELOCITY] = self._number(problem.forward) * start[FIRST] + start[WIND]
        return start

    # --- the limits of single steps

    def _paced(self, state: State, limits: Limits, spans: Rows) -> dict[str, Any]:
        """Limit speeds; return the limit on their changes."""
        problem, number, coasted = self.problem, self._number, state.coasted
        speeds, late = spans[problem.horizon :], problem.rotation_order == 2
        if late and coasted is None:  # R_1 is given: its factor is 1, and no speed to change from
            speeds[0] = number(1)
            return {}
        entry, change = number(limits.entry), number(min(2.0, limits.change))
        if change < 2:
            changed = change * self._rows(np.arange(1, problem.horizon + 1))
            speeds[:, 0] = np.maximum(speeds[:, 0], entry - changed)
            speeds[:, 1] = np.minimum(speeds[:, 1], entry + changed)
        if coasted is not None and late and problem.floor.shape == 'polygon':
            along = max(self.base.faces @ self._rows(coasted[:, 0]))
            if 0 < along < 1:  # on this axis the faces are farther
                speeds[0, 0] = max(speeds[0, 0], self.base.least / along * number(INWARD))
        return {'change': change}

    def _coned(self, state: State, limits: Limits) -> dict[str, Any]:
        """Return the cones of each step, and the last one in the plane, which a sector meets.

        In space there are those that headings can only leave by turns of several steps, too.
        """
        cones = [each for each in limits.cones if each.steps]
        if self.problem.dimension == 3:
            axis, turned = state.attitude[:, 0].tolist(), self.problem.turned_cones.items()
            cones += [Cone(axis, angle + WIDER, 0.0, [k]) for k, angle in turned]
        if not cones:
            return {}
        number, made = self._number, dict[str, Any]()
        axes = self._rows([each.axis for each in cones])
        units = axes / roots((axes * axes).sum(axis=1))[:, None]
        angles = np.array([direction(number(each.angle)) for each in cones])
        for each in cones:
            if not made and each.axis == UP and each.angle <= STEEPEST_CAP:
                made['patches'] = np.concatenate([self.base.patches, self._rows(cap(each.angle))])
                made['capped'] = np.isin(np.arange(1, self.problem.horizon + 1), each.steps)
        rows = np.concatenate([units, angles, self._rows([[each.least] for each in cones])], axis=1)
        made['cones'] = np.repeat(rows, [len(each.steps) for each in cones], axis=0)
        made['cone_step'] = np.array([k - 1 for each in cones for k in each.steps], np.int64)
        for each in cones:  # of several in a file the last one counts
            if self.problem.dimension == 2 and self.problem.horizon in each.steps:
                made['aim'] = number(math.atan2(*each.axis[::-1]))
                made['aside'] = number(each.angle) + number(WIDER)
        return made

    def _turned(self, state: State, spans: Rows) -> dict[str, Any]:
        """Limit directions in the plane to those that turns reach; return the limit on turns."""
        problem, number = self.problem, self._number
        turn, late = number(problem.step) * number(problem.max_rate), problem.rotation_order == 2
        limited = problem.dimension == 2 and problem.turns_are_angles and turn < UNTURNED
        if not limited or (late and state.coasted is None):
            return {}
        ahead = state.coasted if late and state.coasted is not None else state.attitude
        heading, wider = number(math.atan2(ahead[1, 0], ahead[0, 0])), number(WIDER)
        if number is not float:  # floats trust the arc tangent as much as cosine and sine
            (cosine, sine), (x, y) = direction(heading), self._rows(ahead[:, 0])
            if not abs(cosine * y - sine * x) < WIDER / 4 or not cosine * x + sine * y > 0:
                raise BadInput('state.attitude', ahead.tolist(), 'a rotation')
        count, first = problem.horizon, 2 - problem.rotation_order
        turns = turn * self._rows(np.arange(first, first + count))
        spans[:count] = np.stack([heading - wider - turns, heading + wider + turns], axis=1)
        return {'turn': turn}

    # --- the constraints between steps

    @cached_property
    def boxes(self) -> tuple[Body, ...]:
        """Return the boxes at rest, which are the first of the bodies."""
        problem, n, count = self.problem, self.problem.dimension, self.problem.horizon
        still, kept = np.zeros((count + 1, n)), np.zeros(count)
        of = ENDS if problem.no_corner_cutting else END
        return tuple(Body(each, of, still, kept) for each in problem.boxes)

    def _beside(self, origin: Rows, bodies: Sequence[Body], start: Rows) -> Bodies:
        n, count, degree = self.problem.dimension, self.problem.horizon, self._motion.degree
        shapes = [each.shape for each in bodies]
        low = self._rows([b.minimum if isinstance(b, Box) else b.centre for b in shapes])
        high = self._rows([b.maximum if isinstance(b, Box) else b.centre for b in shapes])
        radii = self._rows([b.radius if isinstance(b, Ball) else 0.0 for b in shapes])
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


@lru_cache(maxsize=64)
def rows_of(of: tuple[str, ...], count: int, degree: int) -> np.ndarray:
    """Return the control points that rows of N steps constrain, -1 for missing rows, (J, N, 4)."""
    at = np.full((len(of), count, POINTS), -1)
    for rows, part in zip(at, of, strict=True):
        points = {END: [degree], ENDS: [0, degree], STEP: range(degree + 1)}[part]
        rows[:, : len(points)] = points
        if part == ENDS:  # the start of the first step is given
            rows[0, :2] = degree, -1
    return at
