"""Gurobi: condensed model, rotations and binaries alone, quadratic disks, least big M.

Built once; a tick changes the linear objective (and an arrival's right-hand side). The previous
solution moved one step on is its MIP start. One thread.
"""

from __future__ import annotations

from typing import Any

import gurobipy as gp
import numpy as np
from gurobipy import GRB

from orbimpc_ros.lab.bench.contenders.condensed import SIDES, Condensed
from orbimpc_ros.lab.bench.contenders.contender import Answer, Refused
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.problem import Box, Problem, State


class Gurobi:
    """The mixed-integer program of a planar problem with a polygon floor or boxes.

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
        self._condensed, self._closed_loop = Condensed(problem), closed_loop
        quiet = {'OutputFlag': 0, 'Threads': 1, 'MIPGap': gap, 'TimeLimit': cap}
        self._model = gp.Model(env=gp.Env(params=quiet))
        self._z: Any = self._model.addMVar((problem.horizon, 2), lb=-1.0, ub=1.0)
        for k in range(problem.horizon):
            self._model.addConstr(self._z[k] @ self._z[k] <= 1.0)
        self._binaries: list[Any] = []
        if problem.floor.shape == 'polygon':
            self._add_floor(problem)
        self._boxes = [(box, self._avoid(box)) for box in problem.obstacles]
        self._model.setObjective(self._cost(problem, cut))
        self._arrival: Any = None
        if problem.terminal == 'constraint':
            self._arrival = self._model.addConstr(self._condensed.arrival @ self._z == np.zeros(2))
        self._model.update()

    def _add_floor(self, problem: Problem) -> None:
        low, m = problem.floor.fraction, problem.floor.faces
        face = self._choice(problem.horizon, m)
        big = 1.0 + low  # the least that leaves a face without its binary inert
        self._model.addConstr(self._z @ normals(2, m).T >= low - big + big * face)

    def _choice(self, steps: int, alternatives: int) -> Any:
        """Return binaries, at least one of which must be chosen at every step."""
        chosen = self._model.addMVar((steps, alternatives), vtype=GRB.BINARY)
        self._model.addConstr(chosen.sum(axis=1) >= 1)
        self._binaries.append(chosen)
        return chosen

    def _avoid(self, box: Box) -> Any:
        """Keep every s_k beyond a side of a box; return the rows, whose right sides move."""
        flown = self._condensed.reach @ self._z
        free = self._choice(len(self._condensed.reach), len(SIDES))
        beyond = flown @ SIDES.T - self._condensed.map_size * free
        return self._model.addConstr(beyond >= np.zeros(free.shape))

    def _cost(self, problem: Problem, cut: bool) -> gp.MQuadExpr:
        quadratic = self._condensed.quadratic
        cost = sum(self._z[:, i] @ quadratic @ self._z[:, i] for i in range(2))
        if self._condensed.length == 0.0:
            return cost
        norm = self._model.addMVar(problem.horizon - 1, lb=problem.floor.fraction if cut else 0.0)
        for k in range(problem.horizon - 1):
            self._model.addConstr(self._z[k] @ self._z[k] <= norm[k] * norm[k])
        return cost + self._condensed.length * norm.sum()

    def solve(self, state: State, goals: Array) -> None:
        """Change what the instance changes, and optimise."""
        self._z.Obj, self._model.ObjCon = self._condensed.linear(state, goals)
        if self._arrival is not None:
            self._arrival.RHS = self._condensed.to_go(state, goals)
        for box, rows in self._boxes:
            beyond = self._condensed.side_offsets(box, state) - self._condensed.map_size
            rows.RHS = np.broadcast_to(beyond, rows.shape)
        if not self._closed_loop:
            self._model.reset()
        elif self._model.SolCount:
            self._start()
        try:
            self._model.optimize()
        except gp.GurobiError as error:
            raise Refused(str(error)) from None

    def _start(self) -> None:
        for variables in (self._z, *self._binaries):
            before = variables.X
            variables.Start = np.concatenate([before[1:], before[-1:]])

    def answer(self) -> Answer:
        """Return objective and gap."""
        capped = self._model.Status == GRB.TIME_LIMIT
        if not self._model.SolCount:
            return Answer(np.nan, np.nan, capped)
        return Answer(self._model.ObjVal, self._model.MIPGap, capped)
