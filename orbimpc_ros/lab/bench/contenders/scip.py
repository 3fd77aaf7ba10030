"""SCIP: the same condensed model; the quadratic cost, which never changes, in one constraint.

Built once; a tick changes the linear objective and its offset (and an arrival's sides). SCIP's
gap then counts the whole cost, as everybody's here. The previous solution moved one step on is
offered to it. SCIP runs on one thread.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pyscipopt import SCIP_PARAMSETTING, Model, quicksum

from orbimpc_ros.lab.bench.contenders.condensed import SIDES, Condensed
from orbimpc_ros.lab.bench.contenders.contender import Answer, relative_gap
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.problem import Box, Problem, State


class Scip:
    """The mixed-integer program of a planar problem with a polygon floor or boxes.

    Args:
        problem: what to solve.
        gap: relative gap to prove.
        cap: time limit [s].
        closed_loop: whether instances follow each other, so that a shifted start is of use.
        fast: whether to take SCIP's fast settings: four times as fast as its defaults on the
            tick around the rope.
    """

    def __init__(
        self, problem: Problem, gap: float, cap: float, *, closed_loop: bool, fast: bool = True
    ) -> None:
        self._condensed, self._closed_loop = Condensed(problem), closed_loop
        self._model = model = Model()
        model.hideOutput()
        for tune in (model.setHeuristics, model.setPresolve, model.setSeparating):
            tune(SCIP_PARAMSETTING.FAST if fast else SCIP_PARAMSETTING.DEFAULT)
        model.setParam('limits/gap', gap)
        model.setParam('limits/time', cap)
        steps = range(problem.horizon)
        self._z = [[model.addVar(lb=-1.0, ub=1.0) for _ in range(2)] for _ in steps]
        self._face: list[list[Any]] = []
        self._quadratic = model.addVar(lb=0.0, ub=None)
        self._norm = self._lengths(problem)
        self._add_cost()
        for x, y in self._z:
            model.addCons(x * x + y * y <= 1.0)
        if problem.floor.shape == 'polygon':
            self._add_floor(problem)
        self._boxes = [(box, self._avoid(box)) for box in problem.obstacles]
        self._arrival = self._arrives() if problem.terminal == 'constraint' else []
        self._constant = 0.0
        self._last: tuple[Array, Array] | None = None
        self._value = self._bound = np.nan

    def _lengths(self, problem: Problem) -> list:
        if self._condensed.length == 0.0:
            return []
        norms = [self._model.addVar(lb=0.0, ub=1.0) for _ in range(problem.horizon - 1)]
        for (x, y), norm in zip(self._z, norms, strict=False):
            self._model.addCons(x * x + y * y <= norm * norm)
        return norms

    def _add_cost(self) -> None:
        """Put sum_i z_i^T Q z_i below a variable, as squares alone: seen as convex at once."""
        model, squares = self._model, []
        for row in self._condensed.squares:
            for i in range(2):
                term = model.addVar(lb=None, ub=None)
                model.addCons(quicksum(row[k] * z[i] for k, z in enumerate(self._z)) == term)
                squares.append(term * term)
        model.addCons(quicksum(squares) <= self._quadratic)

    def _add_floor(self, problem: Problem) -> None:
        low = problem.floor.fraction
        big = 1.0 + low  # the least that leaves a face without its binary inert
        self._face = [self._choice(problem.floor.faces) for _ in self._z]
        for (x, y), chosen in zip(self._z, self._face, strict=True):
            for normal, face in zip(normals(2, problem.floor.faces), chosen, strict=True):
                self._model.addCons(normal[0] * x + normal[1] * y >= low - big + big * face)

    def _choice(self, alternatives: int) -> list[Any]:
        """Return binaries, at least one of which must be chosen."""
        chosen = [self._model.addVar(vtype='B') for _ in range(alternatives)]
        self._model.addCons(quicksum(chosen) >= 1)
        return chosen

    def _avoid(self, box: Box) -> list[list[Any]]:
        """Keep s_2..s_N beyond a side of a box; return a row per step and side.

        The state decides s_1: whether that is outside is no question to a solver.
        """
        big, rows = self._condensed.map_size, []
        for reach in self._condensed.reach[1:]:
            free = self._choice(len(SIDES))
            flown = [quicksum(reach[k] * z[i] for k, z in enumerate(self._z)) for i in range(2)]
            beyond = [
                side[0] * flown[0] + side[1] * flown[1] - big * chosen
                for side, chosen in zip(SIDES, free, strict=True)
            ]
            rows.append([self._model.addCons(each >= 0.0) for each in beyond])
        return rows

    def _arrives(self) -> list:
        row = self._condensed.arrival
        sums = [quicksum(row[k] * z[i] for k, z in enumerate(self._z)) for i in range(2)]
        return [self._model.addCons(flown == 0.0) for flown in sums]

    def solve(self, state: State, goals: Array) -> None:
        """Change what the instance changes, and optimise."""
        model = self._model
        model.freeTransform()
        linear, constant = self._condensed.linear(state, goals)
        cost = quicksum(linear[k, i] * z[i] for k, z in enumerate(self._z) for i in range(2))
        cost += self._quadratic + self._condensed.length * quicksum(self._norm)
        model.setObjective(cost + constant)
        for row, side in zip(self._arrival, self._condensed.to_go(state, goals), strict=False):
            model.chgLhs(row, -model.infinity())  # never above the right-hand side on the way
            model.chgRhs(row, side)
            model.chgLhs(row, side)
        for box, rows in self._boxes:
            sides = self._condensed.side_offsets(box, state) - self._condensed.map_size
            for row, side in ((r, s) for step in rows for r, s in zip(step, sides, strict=True)):
                model.chgLhs(row, float(side))
        if self._closed_loop and self._last is not None:
            self._offer()
        model.optimize()
        self._keep()

    def _offer(self) -> None:
        assert self._last is not None
        z, face = (np.concatenate([a[1:], a[-1:]]) for a in self._last)
        solution = self._model.createOrigSol()
        for variables, values in ((self._z, z), (self._face, face)):
            for row, numbers in zip(variables, values, strict=True):
                for variable, number in zip(row, numbers, strict=True):
                    self._model.setSolVal(solution, variable, float(number))
        quadratic = sum(z[:, i] @ self._condensed.quadratic @ z[:, i] for i in range(2))
        self._model.setSolVal(solution, self._quadratic, float(quadratic))
        for norm, row in zip(self._norm, z, strict=False):
            self._model.setSolVal(solution, norm, float(np.linalg.norm(row)))
        self._model.addSol(solution)

    def _keep(self) -> None:
        model = self._model
        if model.getNSols() == 0:
            self._last = None
            return
        best = model.getBestSol()
        z, face = (
            np.array([[model.getSolVal(best, v) for v in row] for row in rows])
            for rows in (self._z, self._face)
        )
        self._last = (z, face)

    def answer(self) -> Answer:
        """Return objective and gap."""
        capped = self._model.getStatus() == 'timelimit'
        if self._last is None:
            return Answer(np.nan, np.nan, capped)
        value = self._model.getObjVal()
        return Answer(value, relative_gap(value, self._model.getDualbound()), capped)
