# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The convex program over SO(3) by a compiled method of multipliers (needs numba).

Condensed: positions are eliminated and all iterates satisfy a terminal constraint; the other
constraints are orbitopes, lengths and half-spaces. Solves that do not converge, as with an arrival
out of reach, are left to the general program.

Mathematics: docs/mathematics.md, 4.7.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import coordinates, margin, matrix
from orbimpc_ros.mpc.kernels import COMPILED, bare
from orbimpc_ros.mpc.kernels.augmented_lagrangian import (
    BEST,
    PAUSED,
    REFUTED,
    SETTLED,
    Iterate,
    begun,
    minimise,
)
from orbimpc_ros.mpc.kernels.penalty_terms import Terms, multipliers, scratch
from orbimpc_ros.mpc.model.dynamics import (
    Condensed,
    first_length,
    knowns,
    length_weights,
    minimisers,
    suits_dense_code,
    wanted_coordinates,
)
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.relaxation import Multipliers, Relaxation, Relaxed, Row
from orbimpc_ros.mpc.solve.request import Request

SLICE = 1e6  # multiplications between two polls of the deadline: about a millisecond
SIGMA = (1.0, 1e6)  # first and largest penalty parameter, times the scale of the gradients
EASY = 12  # horizon up to which solves hardly ever stall
USUAL = 100.0  # gradients of problems near their goal
# Largest |rho| of the minimiser without orbitopes. With a larger one, as with a weight on length
# alone, bounds would be small differences of huge numbers.
STEEPEST = 1e4
FLATTEST = 1e-30  # least curvature along rho, which by rounding may be none
PRECISION = 1e-8  # on constraints
GAP = 1e-8  # relative
ROUNDING = 1e-15  # relative to the largest terms that cancel in a cost
INWARD = 1.0 - 1e-15  # factor on a direction: its length must not exceed 1 by rounding
Placed = tuple[int, Array | tuple[float, float, float], float]  # a row's place, normal and offset
FRACTION: tuple[Placed, ...] = (0, (1.0, 0.0, 0.0), 0.0), (0, (-1.0, 0.0, 0.0), -1.0)  # in [0, 1]
INERT: Placed = 0, (0.0, 0.0, 0.0), -1.0  # a row that is always satisfied


class SO3Multipliers:
    """Faster equivalent of :class:`orbimpc_ros.mpc.solve.program.Program` for SE(3).

    Args:
        problem: what to solve.
        coasting: whether states come with a ``coasted`` rotation (for rotation order 2).
        beside: whether there will be half-spaces on control points.
    """

    def __init__(self, problem: Problem, *, coasting: bool = False, beside: bool = False) -> None:
        self.problem = problem
        self._given = problem.rotation_order - 1  # at order 2 the state determines R_1
        self._coasting = coasting and bool(self._given)
        condensed = self._condensed = Condensed(problem)
        self._pulls: Array | None = None  # map from slopes to multipliers of the arrival
        if problem.terminal == 'constraint':
            self._pulls = np.linalg.pinv(condensed.arrival[0][:, self._given :].T)
        self._thrust, self._others = minimisers(problem, condensed)
        self._length = float(length_weights(problem)[1])
        reach = problem.maps.controls.reshape(-1, problem.horizon)
        self._reach = reach if beside else reach[:0]
        self._make_room()
        self._request: Request | None = None
        self._general: Relaxed | None = None
        if self._may_need_general:
            self._build_general()
        if bare(minimise) is minimise:
            # The first call compiles or loads machine code: at start-up rather than in a tick.
            self.relax(Request(_rest(self._coasting), np.zeros((problem.horizon, 3))))

    def _make_room(self) -> None:
        """Allocate the kernel's arrays; rho, if there is one, is the first variable."""
        n = self._places = self.problem.horizon - self._given + self._coasting
        own, places = slice(self._coasting, n), n + len(self._reach)
        self._inverse = np.zeros((2, places, places))
        for whole, maps in zip(self._inverse, (self._thrust, self._others), strict=True):
            whole[own, own] = maps.inverse
        shares = np.eye(n)
        if len(self._reach):
            shares = np.vstack([shares, self._reach])
            whole = shares @ self._thrust.inverse @ shares.T
            self._inverse[0] = 0.5 * (whole + whole.T)
        self._start, self._slide = np.zeros((n, 9)), np.zeros((places, 9))
        self._lengths = length_weights(self.problem)[-n:].copy()
        if self._coasting:
            self._lengths[0] = 0.0  # linear in rho
        self._axes = np.zeros((self.problem.horizon + 5, 3))
        self._rest = np.zeros((3, 6))
        self._own = FRACTION if self._coasting else ()
        count = len(self._own)
        self._work, self._held = scratch(n, count), multipliers(n, count)
        known = self._inverse, self._slide, self._lengths, self._coasting, shares
        self._unbound = Terms(*known, *_arrays(self._own))

    @property
    def _may_need_general(self) -> bool:
        """Return True if solves are likely to need the general program.

        A terminal constraint, or half-spaces on R_1 with a coasted rotation, may be infeasible.
        Over long horizons the method of multipliers occasionally stalls.
        """
        refutable = self._coasting and self.problem.floor.exists
        return refutable or self.problem.terminal == 'constraint' or self.problem.horizon > EASY

    def _build_general(self) -> Relaxed:
        from orbimpc_ros.mpc.solve.program import Program  # imports Clarabel, which is slow

        self._general = Program(self.problem, coasting=self._coasting)
        return self._general

    @staticmethod
    def solves(problem: Problem, *, beside: bool = False) -> bool:
        """Return True if this program applies to a problem and is fast on this machine.

        Args:
            problem: what to solve.
            beside: whether there will be half-spaces on control points.
        """
        return (
            COMPILED
            and problem.dimension == 3
            and problem.weights.input > 0.0
            and problem.max_rate == problem.arrival_weight == 0.0
            and not problem.has_cones
            and not problem.approach.exists
            and not (beside and (problem.rotation_order == 2 or problem.terminal != 'penalty'))
            and problem.horizon >= 2 * max(problem.rotation_order, problem.translation_order)
            and suits_dense_code(problem)
        )

    def _bind(self, request: Request) -> None:
        """Compute the data that depend only on state and goals."""
        self._request, state, goals = request, request.state, request.goals
        axes, rest = self._axes, self._rest
        axes[:-1] = knowns(state, goals)
        rest[0] = state.rotation[:, 1:].T.ravel()
        rest[1] = wanted_coordinates(self.problem, state)[3:]
        self._least = first_length(self.problem, state)
        if self._coasting:
            assert state.coasted is not None
            self._first = coordinates(state.coasted)
            self._choose_fraction()
        elif self._given:
            self._first = coordinates(state.rotation + self.problem.step * state.rotation_rate)
            axes[-1], rest[-1] = self._first[:3], self._first[3:]
            self._least += self._length * math.sqrt(axes[-1] @ axes[-1])
        self._start[self._coasting :, :3] = (self._thrust.minimiser @ axes)[self._given :]
        self._start[self._coasting :, 3:] = (self._others.minimiser @ rest)[self._given :]
        self._least += _quadratic(self._thrust.least, axes) + _quadratic(self._others.least, rest)
        self._rounding = ROUNDING * _quadratic(self._thrust.constant, axes)
        bent = float(np.abs(self._thrust.bent @ axes).max())
        self._scale = max(1.0, bent / USUAL)

    def _choose_fraction(self) -> None:
        """Set R_1 = rho * coasted with the rho that is optimal without the orbitopes.

        The minimiser over all other variables is affine in rho, and its cost a parabola.
        """
        axes, rest, first = self._axes, self._rest, self._first
        axes[-1], rest[-1] = 0.0, 0.0
        slope = 2.0 * float(first[:3] @ (self._thrust.least[-1] @ axes)) + self._length
        slope += 2.0 * float(first[3:] @ (self._others.least[-1] @ rest))
        # The coasted rotation has columns of length one.
        curvature = 2.0 * (self._thrust.least[-1, -1] + 2.0 * self._others.least[-1, -1])
        curvature = max(curvature, FLATTEST)
        rho = -slope / curvature
        axes[-1], rest[-1] = rho * first[:3], rho * first[3:]
        self._least += self._length * rho
        self._start[0, 0] = rho
        self._slide[0, 0] = 1.0
        self._slide[1:, :3] = np.outer(self._thrust.minimiser[1:, -1], first[:3])
        self._slide[1:, 3:] = np.outer(self._others.minimiser[1:, -1], first[3:])
        self._slide /= np.sqrt(curvature)

    def relax(
        self, request: Request, rows: Sequence[Row] = (), chords: Array | None = None
    ) -> Relaxation:
        """See :meth:`orbimpc_ros.mpc.solve.relaxation.Relaxed.relax`; chords are ignored.

        At the deadline, rotations are in their orbitopes but may violate other constraints.
        """
        if request is not self._request:
            self._bind(request)
        if not (self._coasting and abs(self._start[0, 0]) > STEEPEST):
            return self._relaxed(request, rows)
        if request.hurried and self._general is None:
            return Relaxation(None, -np.inf)
        return (self._general or self._build_general()).relax(request, rows)

    def _relaxed(self, request: Request, rows: Sequence[Row]) -> Relaxation:
        """Solve from the multipliers of the last solve, then without, then by the general one."""
        if any(map(self._is_missed, rows)):
            return Relaxation(None, np.inf, empty=True)
        terms, bound, told = self._terms(rows), -np.inf, None
        for warm in (True, False):
            self._take_up(len(rows), warm=warm)
            progress, status = self._minimise(terms, request)
            if progress.numbers[BEST] > bound:
                bound = float(progress.numbers[BEST])
                told = self._told(request, rows, empty=status == REFUTED)
            if status == REFUTED:
                return Relaxation(None, np.inf, told, empty=True)
            found = Relaxation(self._rotations(progress.x), self._least + bound, told)
            if status == SETTLED:
                return found
            if request.late:
                break
        hurried = request.hurried and (self._general is None or request.late)
        if hurried:  # building the general program would take longer than the deadline allows
            return replace(found, x=_within(self._rotations(progress.x)))
        return (self._general or self._build_general()).relax(request, rows)

    def _minimise(self, terms: Terms, request: Request) -> tuple[Iterate, int]:
        first, largest = (self._scale * sigma for sigma in SIGMA)
        limits = PRECISION, GAP, self._least, self._rounding, largest
        progress = begun(self._places, first)
        while True:
            status = minimise(terms, self._start, self._held, limits, self._work, progress, SLICE)
            if status != PAUSED or request.late:
                return progress, status

    def _take_up(self, count: int, *, warm: bool) -> None:
        """Set initial multipliers: of the last solve if ``warm``, else zero (that may mislead).

        Those of the ``count`` half-spaces are zero.
        """
        own = len(self._own)
        held = self._held if warm else multipliers(self._places, own)
        self._held = held._replace(rows=np.append(held.rows[:own], np.zeros(count)))
        if len(self._held.rows) > len(self._work.rows):
            self._work = scratch(self._places, 2 * len(self._held.rows))

    def _told(self, request: Request, rows: Sequence[Row], *, empty: bool) -> Multipliers:
        """Return the multipliers of the last solve, or if ``empty`` of its infeasibility."""
        steps, own = self.problem.horizon, len(self._own)
        sizes = self._work.rows[own : own + len(rows)].copy()
        point, share, tether = self._lowest(), np.zeros((steps, 3)), np.zeros((steps, 3))
        if len(self._ways) and not empty:
            share = -length_weights(self.problem)[1:, None] * self._ways
        pull = np.zeros((0, 3)) if empty else self._pull(request, point)
        return Multipliers(point, sizes, pull, np.zeros((0, 0)), tether, share)

    def _lowest(self) -> Array:
        """Return the minimiser of the last Lagrangian, shape (N, 9)."""
        point = self._of_all(self._work.lowest)
        if self._given:
            point[0] = self._first * (self._work.lowest[0, 0] if self._coasting else 1.0)
        return point

    def _of_all(self, known: Array) -> Array:
        """Return values of the free rotations extended to all steps, 0 for a given R_1."""
        if not self._given:
            return known.copy()
        found = np.zeros((self.problem.horizon, *known.shape[1:]))
        found[self._given :] = known[self._coasting :]
        return found

    @property
    def _ways(self) -> Array:
        """Return the directions of the lengths' multipliers, shape (N, 3), or an empty array."""
        if not self.problem.weights.length:
            return np.zeros((0, 0))
        weighed = self._lengths > 0.0
        ways = np.zeros((self.problem.horizon, 3))
        ways[-len(weighed) :][weighed] = INWARD * self._work.pushes[weighed]
        ways[-len(weighed) :][weighed] /= self._lengths[weighed, None]
        return ways

    def _pull(self, request: Request, point: Array) -> Array:
        """Return the multipliers of an arrival that cancel the slopes and forces at a point."""
        if self._pulls is None:
            return np.zeros((0, 3))
        slopes, _ = self._condensed.affine(request.state, request.goals)
        slopes += self._condensed.hessian @ point[:, :3] + self._of_all(self._work.forces)[:, :3]
        return -(self._pulls @ slopes[self._given :])

    def _rotations(self, x: Array) -> Array:
        if self._coasting:
            fraction = min(1.0, max(0.0, x[0, 0]))
            return np.concatenate([fraction * self._first[None], x[1:]])
        return np.concatenate([self._first[None], x]) if self._given else x

    def _terms(self, imposed: Sequence[Row]) -> Terms:
        if not imposed:
            return self._unbound
        known = [*self._own, *map(self._placed, imposed)]
        places, normals, offsets = _arrays(known)
        return self._unbound._replace(places=places, normals=normals, offsets=offsets)

    def _placed(self, row: Row) -> Placed:
        """Return a half-space on what is not given."""
        place = row.place - self._given + self._coasting
        if place >= self._coasting:
            return place, row.normal, row.offset
        along = float(row.normal @ self._first[:3])
        return (0, (along, 0.0, 0.0), row.offset) if self._coasting else INERT

    def _is_missed(self, row: Row) -> bool:
        """Return True if R_1 is given, and on the wrong side of a half-space."""
        if self._coasting or row.place >= self._given:
            return False
        return bool(row.normal @ self._first[:3] < row.offset - PRECISION)


def _arrays(rows: Sequence[Placed]) -> tuple[np.ndarray, Array, Array]:
    """Return the places, shape (M,), the normals, shape (M, 3), and the offsets, shape (M,)."""
    places = np.array([place for place, _, _ in rows], np.int64)
    normals = np.array([normal for _, normal, _ in rows], float).reshape(-1, 3)
    return places, normals, np.array([offset for _, _, offset in rows], float)


def _within(x: Array) -> Array:
    """Return rotation coordinates, shape (N, 9), scaled down into their orbitopes."""
    return x / (1.0 + np.maximum(0.0, -margin(matrix(x))))[:, None]


def _quadratic(form: Array, known: Array) -> float:
    return float(np.vdot(known, form @ known))


def _rest(coasting: bool) -> State:
    still = np.eye(3)
    return State.at(np.zeros(3), still, coasted=still if coasting else None)
