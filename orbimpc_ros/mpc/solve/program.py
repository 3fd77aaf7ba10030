# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The general convex program: built once, then updated in place and solved by Clarabel.

The state enters b and a few entries of A, the goals enter q
(:mod:`orbimpc_ros.mpc.solve.statement`). Half-spaces added by a search require a new solver.

Mathematics: docs/mathematics.md, 4.8.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.model.dynamics import (
    adrift,
    attitude_weight,
    first_length,
    position_weights,
    velocity_weight,
    wanted_coordinates,
)
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.solve.conic import SOLVED, extended, run, solver_for
from orbimpc_ros.mpc.solve.relaxation import Multipliers, Relaxation, Row
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.statement import ConicStatement

REFUTED = ('PrimalInfeasible', 'AlmostPrimalInfeasible')
SMALL = 1e-2  # below this cost the program is solved again, with the cost scaled up
TINY = 1e-11  # well below 1e-9, the smallest denominator of a relative gap
STUCK = ('NumericalError', 'InsufficientProgress')
NEAR = 1e-9  # primal residual of a stalled solve that still counts as accurate
ROUGH = 1e-4  # primal residual of a stalled solve that is good enough for branching
FAR = 1.0  # in lengths of the horizon at full speed: the cost is scaled down for goals beyond it


class Program:
    """The convex program of a problem for repeated solves.

    Args:
        problem: what to solve.
        coasting: whether states come with a ``coasted`` rotation (for rotation order 2).
        tolerance: Clarabel's, on feasibility and on the gap.

    Attributes:
        multipliers: see :class:`orbimpc_ros.mpc.solve.relaxation.Relaxed`.
    """

    def __init__(
        self, problem: Problem, *, coasting: bool = False, tolerance: float = 1e-9
    ) -> None:
        self.problem, self._tolerance = problem, tolerance
        statement = self.statement = ConicStatement(problem, coasting=coasting)
        self._data = statement.data
        self._heaviest = float(position_weights(problem).max())
        self._stopping, self._steadying = velocity_weight(problem), attitude_weight(problem)
        self._scale, self._p = 1.0, self._data['P']
        self._solver: Any = solver_for(self._data, tolerance)
        self._request: Request | None = None
        self.multipliers: Multipliers | None = None

    def _bind(self, request: Request) -> None:
        """Set the data of the next solves from state and goals."""
        self._request, state, goals = request, request.state, request.goals
        self._a, self._b = self.statement.put(state, goals)
        self._origins = adrift(self.problem, state)
        seen = goals - self._origins
        weights = position_weights(self.problem)
        constant = float(np.sum(weights[:, None] * seen * seen))
        hastened = self.problem.maps.speeds[-1, -1] * state.disturbance
        constant += self._stopping * float(hastened @ hastened)
        wanted = wanted_coordinates(self.problem, state)
        constant += self._steadying * float(wanted @ wanted)
        self._constant = constant + first_length(self.problem, state)
        self._bind_cost(-2.0 * weights[:, None] * seen, 2.0 * self._stopping * hastened)
        if self._steadying > 0.0:  # otherwise the columns may be those of thrust axes only
            self._q[self.statement.x[-1]] -= 2.0 * self._steadying * wanted / self._scale

    def _bind_cost(self, pull: Array, braking: Array) -> None:
        """Set q from the linear terms of the goals and of the final velocity, scaled.

        The whole cost is scaled down for distant goals: otherwise a goal 1e4 horizons away makes
        an interior-point method report a feasible problem as infeasible.
        """
        reach = self.problem.horizon * self.problem.step * self.problem.forward
        usual = FAR * (1.0 + 2.0 * self._heaviest * reach)
        scale = max(1.0, float(np.abs(pull).max()) / usual)
        if scale != self._scale:
            self._solver.update(P=self._p.data / scale)
            self._scale = scale
        statement = self.statement
        self._q: Array = self._data['q'] / scale
        self._q[statement.moved] += pull / scale
        self._q[statement.last] += braking[: len(statement.last)] / scale

    def stated(self, request: Request) -> dict[str, Any]:
        """Return the program of a request as data for :func:`~.conic.solver_for`."""
        if request is not self._request:
            self._bind(request)
        return self._scaled(self._a, self._b, self._scale)

    def _scaled(self, a: Array, b: Array, scale: float) -> dict[str, Any]:
        """Return the program with the given entries of A and b and its cost over ``scale``."""
        matrix = self._data['A'].copy()
        matrix.data = a
        q = self._q * (self._scale / scale)
        return {**self._data, 'P': self._p / scale, 'q': q, 'A': matrix, 'b': b}

    def relax(
        self, request: Request, rows: Sequence[Row] = (), chords: Array | None = None
    ) -> Relaxation:
        """See :meth:`orbimpc_ros.mpc.solve.relaxation.Relaxed.relax`."""
        if request is not self._request:
            self._bind(request)
        a, b = self._a.copy(), self._b.copy()
        if chords is not None:
            self.statement.narrow(b, chords)
        scale, late = self._scale, request.out_of_time
        if rows:
            relaxed = self._solve_anew(a, b, scale, late, rows)
        else:
            relaxed = self._solve_in_place(a, b, late)
        again = relaxed.bound < SMALL * scale if relaxed.is_accurate else not rows
        if request.late or not again:
            return relaxed
        if relaxed.is_accurate:
            # Near the goal the cost almost vanishes: a gap that is small compared to 1 is not
            # small compared to the cost unless the cost is scaled up.
            scale = max(relaxed.bound, TINY)
        before = self.multipliers
        anew = self._solve_anew(a, b, scale, late, rows)
        if anew.is_accurate or (anew.x is not None and not relaxed.is_accurate):
            return anew
        self.multipliers = before
        return relaxed

    def _solve_in_place(
        self, a: Array, b: Array, out_of_time: Callable[[], bool] | None
    ) -> Relaxation:
        self._solver.update(q=self._q, A=a, b=b)
        answer = run(self._solver, out_of_time)
        if answer is None:  # a panic leaves the solver in an unknown state
            self._solver = solver_for({**self._data, 'P': self._p / self._scale}, self._tolerance)
        return self._relaxation(answer, self._scale)

    def _solve_anew(
        self,
        a: Array,
        b: Array,
        scale: float,
        out_of_time: Callable[[], bool] | None,
        rows: Sequence[Row] = (),
    ) -> Relaxation:
        """Solve with a new Clarabel solver, the cost divided by ``scale``.

        This succeeds in nearly all cases in which the solver updated in place did not.
        """
        data = self.cut(self._scaled(a, b, scale), rows, equal=False)
        return self._relaxation(run(solver_for(data, self._tolerance), out_of_time), scale)

    def cut(self, data: dict[str, Any], rows: Sequence[Row], *, equal: bool) -> dict[str, Any]:
        """Return data with half-spaces added, or their boundary planes if ``equal``."""
        if not rows:
            return data
        shares, normals = (np.array([row[i] for row in rows]) for i in (1, 2))
        entries = np.zeros((len(rows), data['A'].shape[1]))
        axes = self.statement.x[:, : self.problem.dimension]
        entries[:, axes] = -shares[:, :, None] * normals[:, None]
        return extended(data, entries, -np.array([row.offset for row in rows]), equal=equal)

    def _relaxation(self, answer: Any, scale: float) -> Relaxation:
        """Return the relaxation from Clarabel's solution, with its dual value as the bound.

        Raises:
            Infeasible: reported by Clarabel; its multipliers are taken as a Farkas certificate.
        """
        self.multipliers = None if answer is None else self._multipliers(answer, scale)
        if answer is None:
            return Relaxation(None, -np.inf)
        if str(answer.status) in REFUTED:
            raise Infeasible('no trajectory satisfies the constraints')
        accurate = str(answer.status) in SOLVED or _is_within(answer, NEAR)
        if not (accurate or _is_within(answer, ROUGH)):
            return Relaxation(None, -np.inf)
        assert self._request is not None
        x = self.statement.coordinates(np.asarray(answer.x)[self.statement.x], self._request.state)
        bound = scale * answer.obj_val_dual + self._constant if accurate else -np.inf
        return Relaxation(x, bound)

    def _multipliers(self, answer: Any, scale: float) -> Multipliers:
        x, z, count = np.asarray(answer.x), scale * np.asarray(answer.z), len(self._b)
        assert self._request is not None
        sizes = np.maximum(z[count:], 0.0)
        return self.statement.multipliers(x, z[:count], sizes, self._request.state)


def _is_within(answer: Any, tolerance: float) -> bool:
    """Return True if a solve that stalled nevertheless satisfies the constraints."""
    near = answer.r_prim <= tolerance and np.isfinite(answer.x).all()
    return bool(near and str(answer.status) in STUCK)
