# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""IPOPT from many starts, to beat a plan: a local solver of the problem as the judge states it.

Floors by faces and boxes are unions of half-spaces: each start settles which of them holds when,
and IPOPT finds the best trajectory within. What comes back is rolled out and judged anew.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import casadi as ca
import judge
import numpy as np
from judge import Array, PosedProblem

TIGHT = 1e-8  # by so much constraints are tightened, so that what IPOPT leaves open stays legal
LEGAL = 1e-9  # violation of a trajectory that counts; of an arrival ten times as much, at its price
# What a miss saves may grow like a root of it: where an arrival leaves nothing to choose, heading
# by heading at full speed. The price where the miss ends is then a share of what it was on average.
CAUTION = 10.0
OPTIONS = {
    'print_time': False,
    'ipopt.print_level': 0,
    'ipopt.sb': 'yes',
    'ipopt.tol': 1e-9,
    'ipopt.constr_viol_tol': 1e-10,
    'ipopt.bound_relax_factor': 0.0,
    'ipopt.max_iter': 300,
    'ipopt.honor_original_bounds': 'yes',
}


@dataclass(frozen=True)
class Rival:
    """A legal trajectory.

    Attributes:
        cost: its objective, and what the miss of an arrival is worth on top.
        rotations: R_0..R_N, shape (N + 1, n, n).
        start: where the search for it began.
    """

    cost: float
    rotations: Array
    start: str


# --- parametrisations of R_k: variables, R of them, and both ways between


@dataclass(frozen=True)
class Coordinates:
    """How one R_k is made of variables.

    Attributes:
        size: of the variables.
        low, high: bounds on them.
        matrix: R, shape (n, n), of the symbolic variables.
        equal: what must be 0, of the symbolic variables.
        positive: what must be >= 0.
        of: the variables of a given R.
        value: R of given variables, exactly inside the orbitope.
    """

    size: int
    low: list[float]
    high: list[float]
    matrix: Callable[[ca.SX], ca.SX]
    equal: Callable[[ca.SX], list[ca.SX]]
    positive: Callable[[ca.SX], list[ca.SX]]
    of: Callable[[Array], Array]
    value: Callable[[Array], Array]


def _flat(a: ca.SX, b: ca.SX) -> ca.SX:
    return ca.vertcat(ca.horzcat(a, -b), ca.horzcat(b, a))


def _flat_value(a: float, b: float) -> Array:
    shrink = 1.0 / max(1.0, np.hypot(a, b))
    return shrink * np.array([[a, -b], [b, a]])


def disk() -> Coordinates:
    return Coordinates(
        2,
        [-1.0] * 2,
        [1.0] * 2,
        matrix=lambda x: _flat(x[0], x[1]),
        equal=lambda x: [],
        positive=lambda x: [1.0 - ca.sumsqr(x)],
        of=lambda r: r[:, 0],
        value=lambda x: _flat_value(*x),
    )


def annulus(least: float) -> Coordinates:
    """Angle and speed: the round floor is a bound, and speed 1 no thin set."""

    def of(r: Array) -> Array:
        return np.array([np.arctan2(r[1, 0], r[0, 0]), np.clip(np.hypot(*r[:, 0]), least, 1.0)])

    return Coordinates(
        2,
        [-np.inf, least],
        [np.inf, 1.0],
        matrix=lambda x: _flat(x[1] * ca.cos(x[0]), x[1] * ca.sin(x[0])),
        equal=lambda x: [],
        positive=lambda x: [],
        of=of,
        value=lambda x: _flat_value(x[1] * np.cos(x[0]), x[1] * np.sin(x[0])),
    )


def _of_moments(z):
    """R of the moments of its quaternion, entry by entry: numbers or symbols."""
    return [
        [z[0][0] + z[1][1] - z[2][2] - z[3][3], 2 * (z[1][2] - z[0][3]), 2 * (z[1][3] + z[0][2])],
        [2 * (z[1][2] + z[0][3]), z[0][0] - z[1][1] + z[2][2] - z[3][3], 2 * (z[2][3] - z[0][1])],
        [2 * (z[1][3] - z[0][2]), 2 * (z[2][3] + z[0][1]), z[0][0] - z[1][1] - z[2][2] + z[3][3]],
    ]


def _triangular(x) -> list[list]:
    """The moments L L^T of the ten entries of L."""
    rows = [[x[i * (i + 1) // 2 + j] for j in range(i + 1)] for i in range(4)]
    return [[sum(a * b for a, b in zip(p, q, strict=False)) for q in rows] for p in rows]


def _symbolic(rows: list[list]) -> ca.SX:
    return ca.vertcat(*(ca.horzcat(*row) for row in rows))


def moments(least: float) -> Coordinates:
    """The moments L L^T of a quaternion: all of conv SO(3), exactly."""

    def of(r: Array) -> Array:
        z = (1.0 - 1e-4) * judge.quaternion_moments(r) + 0.25e-4 * np.eye(4)
        worst = np.linalg.eigvalsh(z)[0]
        lower = np.linalg.cholesky(z + max(0.0, 1e-9 - worst) * np.eye(4))
        return lower[np.tril_indices(4)]

    def value(x: Array) -> Array:
        return np.array(_of_moments(_triangular(x / np.linalg.norm(x))))

    def positive(x: ca.SX) -> list[ca.SX]:
        heading = _symbolic(_of_moments(_triangular(x)))[:, 0]
        return [ca.sumsqr(heading) - (least * (1.0 + TIGHT)) ** 2] if least else []

    return Coordinates(
        10,
        [-1.0] * 10,
        [1.0] * 10,
        matrix=lambda x: _symbolic(_of_moments(_triangular(x))),
        equal=lambda x: [ca.sumsqr(x) - 1.0],
        positive=positive,
        of=of,
        value=value,
    )


def framed(least: float) -> Coordinates:
    """A speed times a rotation whose last two axes may shrink: where the speed is (almost) 1."""

    def turned(q) -> list[list]:
        return _of_moments([[a * b for b in q] for a in q])

    def of(r: Array) -> Array:
        rotation = judge.nearest_rotation(r)
        z = judge.quaternion_moments(rotation)
        best = int(np.argmax(np.diag(z)))
        speed = np.clip(np.linalg.norm(r[:, 0]), least, 1.0)
        return np.concatenate([z[best] / np.sqrt(z[best, best]), [0.999, 0.0, speed]])

    def matrix(x: ca.SX) -> ca.SX:
        q = _symbolic(turned([x[i] for i in range(4)]))
        across = _flat(x[4], x[5])
        return x[6] * ca.horzcat(q[:, 0], q[:, 1:] @ across)

    def value(x: Array) -> Array:
        q = np.array(turned(x[:4] / np.linalg.norm(x[:4])))
        return x[6] * np.column_stack([q[:, 0], q[:, 1:] @ _flat_value(x[4], x[5])])

    return Coordinates(
        7,
        [-1.0] * 6 + [least],
        [1.0] * 7,
        matrix=matrix,
        equal=lambda x: [ca.sumsqr(x[:4]) - 1.0],
        positive=lambda x: [1.0 - ca.sumsqr(x[4:6])],
        of=of,
        value=value,
    )


def along(coasted: Array, least: float) -> Coordinates:
    """A speed times the rotation that the body's rate decides."""
    n = len(coasted)
    return Coordinates(
        1,
        [least],
        [1.0],
        matrix=lambda x: x[0] * ca.DM(coasted),
        equal=lambda x: [],
        positive=lambda x: [],
        of=lambda r: np.clip([np.sum(r * coasted) / n], least, 1.0),
        value=lambda x: x[0] * coasted,
    )


def coordinates_of(case: PosedProblem, k: int) -> Coordinates:
    """The parametrisation of R_k."""
    least = case.floor['fraction'] if case.floor['shape'] == 'circle' else 0.0
    if k == 1 and case.rotation_order == 2:
        assert case.coasted is not None
        return along(case.coasted, least)
    if case.n == 2:
        return annulus(least) if least else disk()
    return framed(least) if least > 0.999 else moments(least)


# --- the program


class _Rows:
    """The constraints of a program, as they are collected: expressions with their bounds."""

    def __init__(self) -> None:
        self.rows: list[ca.SX] = []
        self.high: list[float] = []

    def equal(self, row: ca.SX) -> None:
        self._add(row, 0.0)

    def positive(self, row: ca.SX) -> None:
        self._add(row, np.inf)

    def _add(self, row: ca.SX, high: float) -> None:
        self.rows.append(row)
        self.high += [high] * row.numel()


class Beater:
    """Looks for trajectories of one problem."""

    def __init__(self, case: PosedProblem, seconds: float) -> None:
        self.case = case
        coasting = case.rotation_order == 2 and case.coasted is not None
        self._free = range(1 if coasting else case.first_free, case.horizon + 1)
        self._parts = {k: coordinates_of(case, k) for k in self._free}
        self._rows, self._settled = _Rows(), []
        self._x = [ca.SX.sym(f'x{k}', part.size) for k, part in self._parts.items()]
        self._build(seconds)

    def _build(self, seconds: float) -> None:
        rows = self._rows
        matrices = self._matrices()
        positions, last = self._positions(matrices)
        self._limits(matrices)
        self._boxes(positions)
        for row in last:
            rows.equal(row)
        self._arrival_rows = sum(row.numel() for row in last)
        scale = ca.SX.sym('scale')
        program = {
            'x': ca.vertcat(*self._x, *self._extra),
            'p': ca.vertcat(scale, *self._settled),
            'f': scale * self._cost(matrices, positions),
            'g': ca.vertcat(*rows.rows) if rows.rows else ca.SX(0, 1),
        }
        options = {**OPTIONS, 'ipopt.max_cpu_time': seconds}
        determined = rows.high.count(0.0) >= program['x'].numel()
        self._solver = None if determined else ca.nlpsol('beater', 'ipopt', program, options)
        self._low = np.concatenate([*(p.low for p in self._parts.values()), *self._loose(-np.inf)])
        self._high = np.concatenate([*(p.high for p in self._parts.values()), *self._loose(np.inf)])

    def _loose(self, value: float) -> list[list[float]]:
        return [[value] * each.numel() for each in self._extra]

    def _matrices(self) -> list[ca.SX]:
        case, rows = self.case, self._rows
        matrices = [ca.DM(case.rotation)]
        if case.rotation_order == 2 and case.coasted is None:
            matrices.append(ca.DM(judge.first_rotation(case, 1.0)))
        for x, part in zip(self._x, self._parts.values(), strict=True):
            matrices.append(part.matrix(x))
            for row in part.equal(x):
                rows.equal(row)
            for row in part.positive(x):
                rows.positive(row - TIGHT)
        return matrices

    def _positions(self, matrices: list[ca.SX]) -> tuple[list[ca.SX], list[ca.SX]]:
        """s_0..s_N in units from s_0, as variables with their dynamics; and what must vanish."""
        case, self._extra = self.case, []
        goal = (case.goals[-1] - case.position) / case.unit
        s, p = [ca.DM.zeros(case.n)], ca.DM(case.step * case.velocity / case.unit)
        blown = ca.DM(case.disturbance / case.forward * np.ones(case.n))  # in a step, in units
        for k in range(case.horizon):
            old, new = matrices[k][:, 0], matrices[k + 1][:, 0]
            push = (0.5 * (old + new) if case.exact else old) + blown
            ahead = s[-1] + (push if case.translation_order == 1 else p)
            if case.translation_order == 2:
                if case.exact:
                    ahead = ahead + old / 3.0 + new / 6.0 + 0.5 * blown
                p = self._named(f'p{k}', p + push)
            s.append(self._named(f's{k}', ahead))
        if not case.arrives:
            return s, []
        return s, [s[-1] - ca.DM(goal), *([p] if case.translation_order == 2 else [])]

    def _named(self, name: str, expression: ca.SX) -> ca.SX:
        """A variable that stands for an expression: it keeps the program sparse."""
        variable = ca.SX.sym(name, self.case.n)
        self._extra.append(variable)
        self._rows.equal(variable - expression)
        return variable

    def _limits(self, matrices: list[ca.SX]) -> None:
        case, rows = self.case, self._rows
        headings = [m[:, 0] for m in matrices]
        if case.floor['shape'] == 'polygon':
            for k in self._free:
                face = self._parameter(f'face{k}', case.n)
                rows.positive(ca.dot(face, headings[k]) - case.floor['fraction'] - TIGHT)
        if not case.max_rate:
            return
        angle = case.step * case.max_rate * (1.0 - TIGHT)
        chord = 4.0 * np.sin(angle / 2.0) ** 2
        if case.has_floor:
            axes = [ca.DM(case.attitude[:, 0]), *headings[1:]][case.rotation_order - 1 :]
            for before, after in itertools.pairwise(axes):
                sizes = ca.sqrt(ca.sumsqr(before) * ca.sumsqr(after) + 1e-20)
                rows.positive(ca.dot(before, after) - np.cos(angle * (1.0 - 1e-6)) * sizes)
            return
        for k in range(case.horizon):
            if k + 1 in self._parts:
                rows.positive(chord - ca.sumsqr(headings[k + 1] - headings[k]) - TIGHT * chord)

    @property
    def _avoiding(self) -> range:
        """The k of those s_k that the state does not decide."""
        return range(
            1 if self.case.exact else 1 + self.case.translation_order, self.case.horizon + 1
        )

    def _boxes(self, positions: list[ca.SX]) -> None:
        case = self.case
        for i in range(len(case.boxes)):
            for k in self._avoiding:
                side = self._parameter(f'side{i},{k}', case.n)
                place = self._parameter(f'place{i},{k}', 1)
                self._rows.positive(ca.dot(side, positions[k]) - place - TIGHT)
                if case.shares_faces and k > 1:
                    self._rows.positive(ca.dot(side, positions[k - 1]) - place - TIGHT)

    def _parameter(self, name: str, size: int) -> ca.SX:
        self._settled.append(ca.SX.sym(name, size))
        return self._settled[-1]

    def _cost(self, matrices: list[ca.SX], positions: list[ca.SX]) -> ca.SX:
        case, w = self.case, self.case.weights
        goals = (case.goals - case.position) / case.unit
        area = case.unit**2
        cost = w['terminal'] * area * ca.sumsqr(positions[-1] - ca.DM(goals[-1]))
        for k in range(1, case.horizon + 1):
            cost += w['position'] * area * ca.sumsqr(positions[k] - ca.DM(goals[k - 1]))
        for u in self._changes(matrices):
            cost += w['input'] / case.step ** (2 * case.rotation_order) * ca.sumsqr(u)
        if w['length']:
            late = 0.5 if case.exact else 0.0
            for old, new in itertools.pairwise(matrices):
                speed = (1.0 - late) * ca.sqrt(ca.sumsqr(old[:, 0]) + 1e-16)
                speed += late * ca.sqrt(ca.sumsqr(new[:, 0]) + 1e-16)
                cost += w['length'] * case.step * case.forward * speed
        return cost

    def _changes(self, matrices: list[ca.SX]) -> list[ca.SX]:
        once = [b - a for a, b in itertools.pairwise(matrices)]
        if self.case.rotation_order == 1:
            return once
        return [b - a for a, b in itertools.pairwise(once)]

    # --- a start, and what IPOPT makes of it

    def improved(self, name: str, start: Array) -> Rival | None:
        """The legal trajectory that IPOPT finds from rotations R_0..R_N, or None."""
        case = self.case
        if self._solver is None:
            return judged(case, start, name)
        size = judge.cost(case, start) or case.natural_cost or 1.0
        found = self._solver(
            x0=self._start(start),
            p=np.concatenate([[1.0 / size], *self._sides(start)]),
            lbx=self._low,
            ubx=self._high,
            lbg=0.0,
            ubg=np.array(self._rows.high),
        )
        x = np.array(found['x']).ravel()
        if not np.isfinite(x).all():
            return None
        prices = np.abs(np.array(found['lam_g']).ravel()) * size
        last = prices[len(prices) - self._arrival_rows :] if self._arrival_rows else np.zeros(0)
        return judged(case, self._rotations(start, x), name, last)

    def _start(self, start: Array) -> Array:
        case = self.case
        x = [part.of(start[k]) for k, part in self._parts.items()]
        positions, velocities = judge.rollout(case, start)
        s = (positions - case.position) / case.unit
        p = case.step * velocities / case.unit
        for k in range(1, case.horizon + 1):
            x += [p[k], s[k]] if case.translation_order == 2 else [s[k]]
        return np.concatenate(x)

    def _sides(self, start: Array) -> Iterator[Array]:
        """The faces and sides that a start is beyond, in the order of the parameters."""
        case = self.case
        if case.floor['shape'] == 'polygon':
            normals = judge.faces(case)
            yield from (normals[np.argmax(normals @ start[k][:, 0])] for k in self._free)
        positions = judge.rollout(case, start)[0]
        normals = np.concatenate([-np.eye(case.n), np.eye(case.n)])
        for box in case.boxes:
            beyond = judge.clearances(box, positions)
            for k in self._avoiding:
                before = beyond[k - 1] if case.shares_faces and k > 1 else beyond[k]
                side = int(np.argmax(np.minimum(before, beyond[k])))
                edge = box[side // case.n] - case.position
                yield normals[side]
                yield np.array([normals[side] @ edge / case.unit])

    def _rotations(self, start: Array, x: Array) -> Array:
        rotations, at = start.copy(), 0
        for k, part in self._parts.items():
            rotations[k] = part.value(x[at : at + part.size])
            at += part.size
        return rotations


def judged(
    case: PosedProblem, rotations: Array, name: str, prices: Array | None = None
) -> Rival | None:
    """A trajectory if it is legal; an arrival that it misses by a little is paid for."""
    broken = judge.violations(case, rotations)
    miss = broken.pop('terminal')
    if max(broken.values()) > LEGAL or miss > 10.0 * LEGAL:
        return None
    cost = judge.cost(case, rotations)
    if prices is not None and len(prices):
        missed = judge.arrival_miss(case, *judge.rollout(case, rotations)) / case.unit
        cost += CAUTION * float(prices @ np.abs(missed))
    return Rival(cost, rotations, name)


# --- starts


def starts(
    case: PosedProblem, plan: Array | None, rng: np.random.Generator
) -> Iterator[tuple[str, Array]]:
    """Where to begin, the most promising first."""
    if plan is not None:
        yield 'plan', plan
    yield 'straight', straight(case)
    held = judge.held(case)[1]
    yield 'held', held
    if not (case.has_floor or case.boxes):
        return  # a convex problem: they would all end in the same place
    if plan is not None:
        yield 'nudged plan', nudged(case, plan, rng, 0.5)
    for i in range(3):
        yield f'random {i}', nudged(case, held, rng, 3.0)
    if plan is not None:
        yield 'shaken plan', nudged(case, plan, rng, 1.5)


def straight(case: PosedProblem) -> Array:
    """Full speed towards the goal from the first step on."""
    towards = case.goals[-1] - case.position
    size = np.linalg.norm(towards)
    axis = towards / size if size > 0.0 else case.attitude[:, 0]
    # The rotation nearest to one that has this axis: its other columns are the attitude's.
    wanted = case.attitude.copy()
    wanted[:, 0] = 0.0
    wanted -= np.outer(axis, axis @ wanted)
    wanted[:, 0] = axis
    if case.n == 2:
        wanted[:, 1] = (-axis[1], axis[0])
    return _from_second(case, np.tile(judge.nearest_rotation(wanted), (case.horizon, 1, 1)))


def nudged(case: PosedProblem, rotations: Array, rng: np.random.Generator, size: float) -> Array:
    """Rotations turned by a smooth random walk of up to a size [rad], at full speed."""
    walk = np.cumsum(rng.normal(size=(case.horizon, 3)), axis=0)
    walk *= size / np.abs(walk).max()
    moved = []
    for r, (yaw, pitch, roll) in zip(rotations[1:], walk, strict=True):
        speed = max(np.linalg.norm(r[:, 0]), min(1.0, judge.widest(case)))
        upright = judge.nearest_rotation(r + 1e-12 * np.eye(case.n))
        moved.append(speed * upright @ _euler(case.n, yaw, pitch, roll))
    return _from_second(case, np.array(moved))


def _euler(n: int, yaw: float, pitch: float, roll: float) -> Array:
    c, s = np.cos, np.sin
    if n == 2:
        return np.array([[c(yaw), -s(yaw)], [s(yaw), c(yaw)]])
    about_z = np.array([[c(yaw), -s(yaw), 0.0], [s(yaw), c(yaw), 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[c(pitch), 0.0, s(pitch)], [0.0, 1.0, 0.0], [-s(pitch), 0.0, c(pitch)]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, c(roll), -s(roll)], [0.0, s(roll), c(roll)]])
    return about_z @ about_y @ about_x


def _from_second(case: PosedProblem, later: Array) -> Array:
    """R_0..R_N of R_1..R_N, where the state decides R_1 as it does."""
    rotations = np.concatenate([case.rotation[None], later])
    if case.rotation_order == 2:
        rotations[1] = judge.first_rotation(case, 1.0)
    return rotations


def trajectories(
    case: PosedProblem, plan: Array | None, rng: np.random.Generator, patience: float
) -> Iterator[Rival]:
    """Legal trajectories: what needs no solver, then IPOPT's until the patience [s] is over."""
    begun = time.perf_counter()
    for kept in judge.held(case):
        found = judged(case, kept, 'held, unchanged')
        if found:
            yield found
    beater = Beater(case, 0.4 * patience)
    for name, start in starts(case, plan, rng):
        if time.perf_counter() - begun > patience:
            return
        found = beater.improved(name, start)
        if found:
            yield found
