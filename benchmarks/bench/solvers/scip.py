# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""SCIP: the same condensed model; the quadratic cost, which never changes, in one constraint.

A round floor and turns are quadratic and not convex; the first turn is from an axis whose bounds
fix it. Built once; a tick changes the linear objective and its offset (and an arrival's sides, and
the axis). SCIP's gap then counts the whole cost, as everybody's here. The previous solution moved
one step on is offered to it. SCIP runs on one thread.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from pyscipopt import SCIP_PARAMSETTING, Model, quicksum

from benchmarks.bench.solvers import Solution
from benchmarks.bench.solvers.planar import BigM, CondensedPlanar, slope_of
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem, State


class Scip:
    """The mixed-integer program of a planar problem with a floor, a turn rate or boxes.

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
        self._planar, self._closed_loop = CondensedPlanar(problem), closed_loop
        self._model = model = Model()
        model.hideOutput()
        for tune in (model.setHeuristics, model.setPresolve, model.setSeparating):
            tune(SCIP_PARAMSETTING.FAST if fast else SCIP_PARAMSETTING.DEFAULT)
        model.setParam('limits/gap', gap)
        model.setParam('limits/time', cap)
        steps = range(problem.horizon)
        self._z = [[model.addVar(lb=-1.0, ub=1.0) for _ in range(2)] for _ in steps]
        self._quadratic = model.addVar(lb=0.0, ub=None)
        self._norm = self._lengths(problem)
        self._add_cost()
        for x, y in self._z:
            model.addCons(x * x + y * y <= 1.0)
            if problem.floor.shape == 'circle':
                model.addCons(x * x + y * y >= problem.floor.fraction**2)
        self._before = self._turns(problem) if problem.turns_are_angles else []
        self._chosen = [self._choose(each) for each in self._planar.disjunctions]
        self._arrival = self._arrives() if problem.terminal == 'constraint' else []
        self._variables = [self._z, *(binaries for binaries, _ in self._chosen)]
        self._last: list[Array] | None = None

    def _lengths(self, problem: Problem) -> list:
        if self._planar.length == 0.0:
            return []
        norms = [self._model.addVar(lb=0.0, ub=1.0) for _ in range(problem.horizon - 1)]
        for (x, y), norm in zip(self._z, norms, strict=False):
            self._model.addCons(x * x + y * y <= norm * norm)
        return norms

    def _add_cost(self) -> None:
        """Put sum_i z_i^T Q z_i below a variable, as squares alone: seen as convex at once."""
        model, squares = self._model, []
        for row in self._planar.squares:
            for i in range(2):
                term = model.addVar(lb=None, ub=None)
                model.addCons(quicksum(row[k] * z[i] for k, z in enumerate(self._z)) == term)
                squares.append(term * term)
        model.addCons(quicksum(squares) <= self._quadratic)

    def _turns(self, problem: Problem) -> list[Any]:
        """Limit the angle of every turn, and return the axis that the first one is from."""
        before, slope = [self._model.addVar(lb=-1.0, ub=1.0) for _ in range(2)], slope_of(problem)
        for (x, y), (u, v) in itertools.pairwise([before, *self._z]):
            ahead, aside = x * u + y * v, x * v - y * u
            for side in (aside, -aside):
                self._model.addCons(side <= slope * ahead)
        return before

    def _choose(self, disjunction: BigM) -> tuple[list[list[Any]], list[list[Any]]]:
        """Return the binaries of a disjunction, and its rows, whose left sides move, by step."""
        binaries, rows = [], []
        for moved in disjunction.moved:
            chosen = [self._model.addVar(vtype='B') for _ in disjunction.normals]
            self._model.addCons(quicksum(chosen) >= 1)
            flown = [quicksum(moved[k] * z[i] for k, z in enumerate(self._z)) for i in range(2)]
            beyond = [
                normal[0] * flown[0] + normal[1] * flown[1] - disjunction.big * each
                for normal, each in zip(disjunction.normals, chosen, strict=True)
            ]
            binaries.append(chosen)
            rows.append([self._model.addCons(each >= 0.0) for each in beyond])
        return binaries, rows

    def _arrives(self) -> list:
        row = self._planar.arrival
        sums = [quicksum(row[k] * z[i] for k, z in enumerate(self._z)) for i in range(2)]
        return [self._model.addCons(flown == 0.0) for flown in sums]

    def solve(self, state: State, goals: Array) -> None:
        """Change what the instance changes, and optimise."""
        model = self._model
        model.freeTransform()
        linear, constant = self._planar.linear(state, goals)
        cost = quicksum(linear[k, i] * z[i] for k, z in enumerate(self._z) for i in range(2))
        cost += self._quadratic + self._planar.length * quicksum(self._norm)
        model.setObjective(cost + constant)
        for row, side in zip(self._arrival, self._planar.to_go(state, goals), strict=False):
            model.chgLhs(row, -model.infinity())  # never above the right-hand side on the way
            model.chgRhs(row, side)
            model.chgLhs(row, side)
        for variable, value in zip(self._before, state.attitude[:, 0], strict=False):
            model.chgVarLb(variable, -1.0)  # never above the upper bound on the way
            model.chgVarUb(variable, float(value))
            model.chgVarLb(variable, float(value))
        for disjunction, (_, rows) in zip(self._planar.disjunctions, self._chosen, strict=True):
            sides = disjunction.offsets(state) - disjunction.big
            for row, side in ((r, s) for step in rows for r, s in zip(step, sides, strict=True)):
                model.chgLhs(row, float(side))
        if self._closed_loop and self._last is not None:
            self._offer(self._last)
        model.optimize()
        self._last = self._best()

    def _offer(self, last: list[Array]) -> None:
        """Offer values of the variables, moved on by a step, with what follows from them."""
        solution = self._model.createOrigSol()
        moved = [np.concatenate([values[1:], values[-1:]]) for values in last]
        for variables, values in zip(self._variables, moved, strict=True):
            for row, numbers in zip(variables, values, strict=True):
                for variable, number in zip(row, numbers, strict=True):
                    self._model.setSolVal(solution, variable, float(number))
        z = moved[0]
        quadratic = sum(z[:, i] @ self._planar.quadratic @ z[:, i] for i in range(2))
        self._model.setSolVal(solution, self._quadratic, float(quadratic))
        for norm, row in zip(self._norm, z, strict=False):
            self._model.setSolVal(solution, norm, float(np.linalg.norm(row)))
        self._model.addSol(solution)

    def _best(self) -> list[Array] | None:
        """Return the values of the variables in the best solution, if there is one."""
        model = self._model
        if model.getNSols() == 0:
            return None
        best = model.getBestSol()
        return [
            np.array([[model.getSolVal(best, variable) for variable in row] for row in rows])
            for rows in self._variables
        ]

    def solution(self) -> Solution:
        """Return objective and gap."""
        capped = self._model.getStatus() == 'timelimit'
        if self._last is None:
            return Solution(np.nan, np.nan, capped)
        value = self._model.getObjVal()
        gap = (value - self._model.getDualbound()) / max(1e-9, abs(value))
        return Solution(value, gap, capped)
