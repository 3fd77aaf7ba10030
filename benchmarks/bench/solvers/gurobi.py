# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Gurobi: condensed model, rotations and binaries alone, quadratic disks, least big M.

A round floor and turns are quadratic and not convex; the first turn is from an axis whose bounds
fix it. Built once; a tick changes the linear objective (and an arrival's right-hand side, and the
axis). The previous solution moved one step on is its MIP start. One thread.
"""

from __future__ import annotations

from typing import Any

import gurobipy as gp
import numpy as np
from gurobipy import GRB

from benchmarks.bench.solvers import Declined, Solution
from benchmarks.bench.solvers.planar import BigM, CondensedPlanar, slope_of
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem, State


class Gurobi:
    """The mixed-integer program of a planar problem with a floor, a turn rate or boxes.

    Args:
        problem: what to solve.
        gap: relative gap to prove.
        cap: time limit [s].
        closed_loop: whether instances follow each other, so that a shifted start is of use.
        cut: whether t_k >= fraction is put on the norms' epigraphs, a cut of this package's.
    """

    def __init__(
        self, problem: Problem, gap: float, cap: float, *, closed_loop: bool, cut: bool = False
    ) -> None:
        self._planar, self._closed_loop = CondensedPlanar(problem), closed_loop
        quiet = {'OutputFlag': 0, 'Threads': 1, 'MIPGap': gap, 'TimeLimit': cap}
        self._model = gp.Model(env=gp.Env(params=quiet))
        self._z: Any = self._model.addMVar((problem.horizon, 2), lb=-1.0, ub=1.0)
        for k in range(problem.horizon):
            self._model.addConstr(self._z[k] @ self._z[k] <= 1.0)
            if problem.floor.shape == 'circle':
                self._model.addConstr(self._z[k] @ self._z[k] >= problem.floor.fraction**2)
        self._before: Any = self._turns(problem) if problem.turns_are_angles else None
        self._chosen = [self._choose(each) for each in self._planar.disjunctions]
        self._model.setObjective(self._cost(problem, cut))
        self._arrival: Any = None
        if problem.terminal == 'constraint':
            self._arrival = self._model.addConstr(self._planar.arrival @ self._z == np.zeros(2))
        self._model.update()

    def _turns(self, problem: Problem) -> Any:
        """Limit the angle of every turn, and return the axis that the first one is from."""
        before, slope = self._model.addMVar(2, lb=-1.0, ub=1.0), slope_of(problem)
        for k in range(problem.horizon):
            x, y = (before if k == 0 else self._z[k - 1]).tolist()
            ahead = x * self._z[k, 0] + y * self._z[k, 1]
            aside = x * self._z[k, 1] - y * self._z[k, 0]
            for side in (aside, -aside):
                self._model.addConstr(side <= slope * ahead)
        return before

    def _choose(self, disjunction: BigM) -> tuple[Any, Any]:
        """Return the binaries of a disjunction, and its rows, whose right sides move."""
        shape = (len(disjunction.moved), len(disjunction.normals))
        chosen = self._model.addMVar(shape, vtype=GRB.BINARY)
        self._model.addConstr(chosen.sum(axis=1) >= 1)
        beyond = disjunction.moved @ self._z @ disjunction.normals.T - disjunction.big * chosen
        return chosen, self._model.addConstr(beyond >= np.zeros(shape))

    def _cost(self, problem: Problem, cut: bool) -> gp.MQuadExpr:
        quadratic = self._planar.quadratic
        cost = sum(self._z[:, i] @ quadratic @ self._z[:, i] for i in range(2))
        if self._planar.length == 0.0:
            return cost
        norm = self._model.addMVar(problem.horizon - 1, lb=problem.floor.fraction if cut else 0.0)
        for k in range(problem.horizon - 1):
            self._model.addConstr(self._z[k] @ self._z[k] <= norm[k] * norm[k])
        return cost + self._planar.length * norm.sum()

    def solve(self, state: State, goals: Array) -> None:
        """Change what the instance changes, and optimise."""
        self._z.Obj, self._model.ObjCon = self._planar.linear(state, goals)
        if self._arrival is not None:
            self._arrival.RHS = self._planar.to_go(state, goals)
        if self._before is not None:
            self._before.LB = self._before.UB = state.attitude[:, 0]
        for disjunction, (_, rows) in zip(self._planar.disjunctions, self._chosen, strict=True):
            rows.RHS = np.broadcast_to(disjunction.offsets(state) - disjunction.big, rows.shape)
        if not self._closed_loop:
            self._model.reset()
        elif self._model.SolCount:
            self._start()
        try:
            self._model.optimize()
        except gp.GurobiError as error:
            raise Declined(str(error)) from None

    def _start(self) -> None:
        for variables in (self._z, *(chosen for chosen, _ in self._chosen)):
            before = variables.X
            variables.Start = np.concatenate([before[1:], before[-1:]])

    def solution(self) -> Solution:
        """Return objective and gap."""
        capped = self._model.Status == GRB.TIME_LIMIT
        if not self._model.SolCount:
            return Solution(np.nan, np.nan, capped)
        return Solution(self._model.ObjVal, self._model.MIPGap, capped)
