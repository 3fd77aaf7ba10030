# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The general convex program: stated once, then solved by Clarabel for states and goals.

The state enters b and a few entries of A, the goals enter q
(:mod:`orbimpc_ros.mpc.solve.statement`).

Mathematics: docs/mathematics.md, 4.8.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.dynamics import (
    adrift,
    attitude_weight,
    first_length,
    position_weights,
    velocity_weight,
    wanted_coordinates,
)
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.solve.conic import SOLVED, extended, run
from orbimpc_ros.mpc.solve.relaxation import Relaxation, Row
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
    """

    def __init__(
        self, problem: Problem, *, coasting: bool = False, tolerance: float = 1e-9
    ) -> None:
        self.problem, self._tolerance = problem, tolerance
        self.statement = ConicStatement(problem, coasting=coasting)
        self._request: Request | None = None

    def _bind(self, request: Request) -> None:
        """Set the data of the next solves from state and goals."""
        problem, statement = self.problem, self.statement
        self._request, state, goals = request, request.state, request.goals
        weights, stopping = position_weights(problem), velocity_weight(problem)
        steadying, wanted = attitude_weight(problem), wanted_coordinates(problem, state)
        seen = goals - adrift(problem, state)
        hastened = problem.maps.speeds[-1, -1] * state.disturbance
        constant = float(np.sum(weights[:, None] * seen * seen)) + first_length(problem, state)
        constant += stopping * float(hastened @ hastened) + steadying * float(wanted @ wanted)
        self._data, self._constant = statement.put(state, goals), constant
        pull, q = -2.0 * weights[:, None] * seen, self._data['q']
        q[statement.moved] += pull
        q[statement.last] += 2.0 * stopping * hastened[: len(statement.last)]
        if steadying > 0.0:  # otherwise the columns may be those of thrust axes only
            q[statement.x[-1]] -= 2.0 * steadying * wanted
        # The whole cost is scaled down for distant goals: otherwise a goal 1e4 horizons away makes
        # an interior-point method report a feasible problem as infeasible.
        reach = problem.horizon * problem.step * problem.forward
        usual = FAR * (1.0 + 2.0 * float(weights.max()) * reach)
        self._scale = max(1.0, float(np.abs(pull).max()) / usual)

    def stated(self, request: Request) -> dict[str, Any]:
        """Return the program of a request as data for :func:`~.conic.run`."""
        if request is not self._request:
            self._bind(request)
        return self._data

    def relax(
        self, request: Request, rows: Sequence[Row] = (), chords: Array | None = None
    ) -> Relaxation:
        """See :meth:`orbimpc_ros.mpc.solve.relaxation.Relaxed.relax`."""
        data = self.stated(request)
        if chords is not None:
            data = self.statement.narrowed(data, chords)
        data = self.cut(data, rows)
        relaxed = self._solved(request, data, self._scale)
        if request.late or not relaxed.is_accurate or relaxed.bound >= SMALL * self._scale:
            return relaxed
        # Near the goal the cost almost vanishes: a gap that is small compared to 1 is not small
        # compared to the cost unless the cost is scaled up.
        anew = self._solved(request, data, max(relaxed.bound, TINY))
        return anew if anew.is_accurate else relaxed

    def cut(
        self, data: dict[str, Any], rows: Sequence[Row], *, equal: bool = False
    ) -> dict[str, Any]:
        """Return data with half-spaces added, or their boundary planes if ``equal``."""
        if not rows:
            return data
        shares, normals = (np.array([row[i] for row in rows]) for i in (1, 2))
        entries = np.zeros((len(rows), self.statement.columns))
        axes = self.statement.x[:, : self.problem.dimension]
        entries[:, axes] = -shares[:, :, None] * normals[:, None]
        return extended(data, entries, -np.array([row.offset for row in rows]), equal=equal)

    def _solved(self, request: Request, data: dict[str, Any], scale: float) -> Relaxation:
        """Solve with the cost divided by ``scale``.

        If Clarabel reports infeasibility, its multipliers are taken as a Farkas certificate.
        """
        answer = run(data, self._tolerance, scale, request.out_of_time)
        if answer is None:
            return Relaxation(None, -np.inf)
        x, z, count = np.asarray(answer.x), scale * np.asarray(answer.z), len(self._data['b'])
        sizes = np.maximum(z[count:], 0.0)
        multipliers = self.statement.multipliers(x, z[:count], sizes, request.state)
        if str(answer.status) in REFUTED:
            return Relaxation(None, np.inf, multipliers, empty=True)
        accurate = str(answer.status) in SOLVED or _is_within(answer, NEAR)
        if not (accurate or _is_within(answer, ROUGH)):
            return Relaxation(None, -np.inf, multipliers)
        rotations = self.statement.coordinates(x[self.statement.x], request.state)
        bound = scale * answer.obj_val_dual + self._constant if accurate else -np.inf
        return Relaxation(rotations, bound, multipliers)


def _is_within(answer: Any, tolerance: float) -> bool:
    """Return True if a solve that stalled nevertheless satisfies the constraints."""
    near = answer.r_prim <= tolerance and np.isfinite(answer.x).all()
    return bool(near and str(answer.status) in STUCK)
