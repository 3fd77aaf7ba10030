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
from importlib import import_module

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
    minimise,
)
from orbimpc_ros.mpc.kernels.penalty_terms import Terms, multipliers, scratch
from orbimpc_ros.mpc.model.dynamics import (
    Condensed,
    beside,
    first_length,
    knowns,
    length_weights,
    minimisers,
    suits_dense_code,
)
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.relaxation import Multipliers, Relaxation, Relaxed, Row, stacked
from orbimpc_ros.mpc.solve.request import Request

SLICE = 1e6  # multiplications between two polls of the deadline: about a millisecond
SIGMA = (0.01, 1e6)  # first and largest penalty parameter, times the scale of the gradients
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


class SO3Multipliers:
    """Faster equivalent of :class:`orbimpc_ros.mpc.solve.program.Program` for SE(3).

    Args:
        problem: what to solve.
        coasting: whether states come with a ``coasted`` rotation (for rotation order 2).
        beside: whether there will be half-spaces on control points.
    """

    def __init__(self, problem: Problem, *, coasting: bool = False, beside: bool = False) -> None:
        self.problem, steps = problem, problem.horizon
        self._decided = problem.rotation_order - 1  # at order 2 the state decides R_1
        self._coasting = coasting and bool(self._decided)
        self._condensed = Condensed(problem)
        self._thrust, self._others = minimisers(problem, self._condensed)
        self._speeds = length_weights(problem)[1:]
        lengths = self._speeds.copy()
        lengths[: self._decided] = 0.0
        # Of headings, and then of the control points of all steps.
        reach = problem.maps.controls.reshape(-1, steps)
        shares = np.vstack([np.eye(steps), reach if beside else reach[:0]])
        inverse = np.zeros((2, len(shares), len(shares)))
        gram = shares @ self._thrust.inverse @ shares.T
        inverse[0] = 0.5 * (gram + gram.T)
        inverse[1, :steps, :steps] = self._others.inverse
        self._slide = np.zeros((len(shares), 9))
        self._fixed = inverse, self._slide, lengths, self._decided, shares
        self._own: tuple[Row, ...] = ()  # of a coasted R_1
        self._work, self._held = scratch(steps, 2), multipliers(steps, 2)
        self._request: Request | None = None
        self._general: Relaxed | None = None
        if self._may_need_general:
            self._build_general()
        if bare(minimise) is minimise:
            # The first call compiles or loads machine code: at start-up rather than in a tick.
            still = State.at(np.zeros(3), np.eye(3), coasted=np.eye(3))
            self.relax(Request(still, np.zeros((steps, 3))))

    @property
    def _may_need_general(self) -> bool:
        """Return True if solves are likely to need the general program.

        A terminal constraint, or half-spaces on R_1 with a coasted rotation, may be infeasible.
        Over long horizons the method of multipliers occasionally stalls.
        """
        refutable = self._coasting and self.problem.floor.exists
        return refutable or self.problem.terminal == 'constraint' or self.problem.horizon > EASY

    def _build_general(self) -> Relaxed:
        import_module('scipy.linalg')  # early: its new threads keep a core busy for some 60 ms
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
        problem, state, thrust, others = self.problem, request.state, self._thrust, self._others
        self._request, self._least, self._fraction = request, first_length(problem, state), 1.0
        data = np.concatenate([knowns(state, request.goals), np.zeros((1, 9))])
        if self._coasting:
            assert state.coasted is not None
            self._first = coordinates(state.coasted)
            self._choose_fraction(data)
        elif self._decided:
            self._first = coordinates(state.rotation + problem.step * state.rotation_rate)
        if self._decided:
            data[-1] = self._fraction * self._first
            fast = self._fraction * math.sqrt(self._first[:3] @ self._first[:3])
            self._least += float(self._speeds[0]) * fast
        self._start = beside(data, thrust.minimiser, others.minimiser)
        self._least += float(np.vdot(data, beside(data, thrust.least, others.least)))
        axes, squared = data[:-1, :3], self._condensed.axes.squared
        self._rounding = ROUNDING * float(np.vdot(axes, squared @ axes))
        bent = self._condensed.hessian @ self._start[:, :3]
        self._scale = max(1.0, float(np.abs(bent).max()) / USUAL)

    def _choose_fraction(self, data: Array) -> None:
        """Choose R_1 = rho * coasted with the rho that is optimal without the orbitopes.

        The minimiser over all other variables is affine in rho, and its cost a parabola.

        Args:
            data: the knowns and a zero, shape (N + 5, 9).
        """
        thrust, others, first = self._thrust, self._others, self._first
        steepest = beside(data, thrust.least[-1:], others.least[-1:])[0]
        slope = 2.0 * float(first @ steepest) + float(self._speeds[0])
        # The coasted rotation has columns of length one.
        curvature = 2.0 * (thrust.least[-1, -1] + 2.0 * others.least[-1, -1])
        curvature = max(curvature, FLATTEST)
        self._fraction = -slope / curvature
        moves = beside(first[None], thrust.minimiser[:, -1:], others.minimiser[:, -1:])
        self._slide[:] = moves / np.sqrt(curvature)
        one = np.eye(self.problem.horizon)[0]
        self._own = Row(0, one, first[:3], 0.0), Row(0, one, -first[:3], -1.0)

    def relax(
        self, request: Request, rows: Sequence[Row] = (), chords: Array | None = None
    ) -> Relaxation:
        """See :meth:`orbimpc_ros.mpc.solve.relaxation.Relaxed.relax`; chords are ignored.

        At the deadline, rotations are in their orbitopes but may violate other constraints.
        """
        if request is not self._request:
            self._bind(request)
        if abs(self._fraction) <= STEEPEST:
            return self._relaxed(request, rows)
        if request.hurried and self._general is None:
            return Relaxation(None, -np.inf)
        return (self._general or self._build_general()).relax(request, rows)

    def _relaxed(self, request: Request, rows: Sequence[Row]) -> Relaxation:
        """Solve from the last solve's multipliers, else from zeros, else by the general program."""
        if any(map(self._is_missed, rows)):
            return Relaxation(None, np.inf, empty=True)
        terms, bound, dual = Terms(*self._fixed, *stacked([*self._own, *rows], 3)), -np.inf, None
        for warm in (True, False):
            self._take_up(len(rows), warm=warm)
            progress, status = self._minimise(terms, request)
            if progress.numbers[BEST] > bound:
                bound = float(progress.numbers[BEST])
                dual = self._multipliers(request, rows, empty=status == REFUTED)
            if status == REFUTED:
                return Relaxation(None, np.inf, dual, empty=True)
            relaxation = Relaxation(self._rotations(progress.x), self._least + bound, dual)
            if status == SETTLED:
                return relaxation
            if request.late:
                break
        hurried = request.hurried and (self._general is None or request.late)
        if hurried:  # building the general program would take longer than the deadline allows
            return replace(relaxation, x=_within(self._rotations(progress.x)))
        return (self._general or self._build_general()).relax(request, rows)

    def _minimise(self, terms: Terms, request: Request) -> tuple[Iterate, int]:
        first, largest = (self._scale * sigma for sigma in SIGMA)
        limits = PRECISION, GAP, self._least, self._rounding, largest
        x, numbers = np.zeros_like(self._start), np.array([first, -np.inf, np.inf])
        progress = Iterate(x, x.copy(), numbers, np.zeros(2, np.int64))
        while True:
            status = minimise(terms, self._start, self._held, limits, self._work, progress, SLICE)
            if status != PAUSED or request.late:
                return progress, status

    def _take_up(self, count: int, *, warm: bool) -> None:
        """Set initial multipliers: the last solve's if ``warm``, which may mislead; else zeros.

        Those of the ``count`` half-spaces are zero.
        """
        steps, own = self.problem.horizon, len(self._own)
        held = self._held if warm else multipliers(steps, own)
        self._held = held._replace(rows=np.append(held.rows[:own], np.zeros(count)))
        if len(self._held.rows) > len(self._work.rows):
            self._work = scratch(steps, 2 * len(self._held.rows))

    def _multipliers(self, request: Request, rows: Sequence[Row], *, empty: bool) -> Multipliers:
        """Return the multipliers of the last solve, or if ``empty`` of its infeasibility."""
        steps, own = self.problem.horizon, len(self._own)
        sizes = self._work.rows[own : own + len(rows)].copy()
        point, none = self._work.lowest.copy(), np.zeros((steps, 3))
        pull, share = self._thrust.lift.T @ none, none if empty else -INWARD * self._work.pushes
        if self.problem.terminal == 'constraint' and not empty:
            # The multipliers of an arrival cancel slopes and forces.
            slopes, _ = self._condensed.affine(request.state, request.goals)
            slopes += self._condensed.hessian @ point[:, :3] + self._work.forces[:, :3]
            pull = -(self._thrust.lift.T @ slopes)
        return Multipliers(point, sizes, pull, none[:0, :0], none, share)

    def _rotations(self, x: Array) -> Array:
        if self._coasting:
            first = self._first
            return np.vstack([min(1.0, max(0.0, float(first[:3] @ x[0, :3]))) * first, x[1:]])
        return x

    def _is_missed(self, row: Row) -> bool:
        """Return True if R_1 is given, and on the wrong side of a half-space."""
        if self._coasting or row.place >= self._decided:
            return False
        return bool(row.normal @ self._first[:3] < row.offset - PRECISION)


def _within(x: Array) -> Array:
    """Return rotation coordinates, shape (N, 9), scaled down into their orbitopes."""
    return x / (1.0 + np.maximum(0.0, -margin(matrix(x))))[:, None]
