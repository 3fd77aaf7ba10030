# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Gurobi, SCIP and IPOPT on one program: only rotations and binaries, least big M.

In z_k = R_k e1, k = 1..N, with s_k = s_1 + h z sum_{j<k} R_j e1 (n = 2, orders (1, 1)),

    cost = sum_i |F z_i|^2 + q_i^T z_i + c + l h z sum_{k=1..N-1} |z_k|    (i: coordinates).

A round floor and turns are quadratic and not convex. Each solver has one thread; the model is built
before the clock runs, with the previous solution, shifted by a step, as a warm start. IPOPT starts
from the present heading, held constant, finds a local optimum, and proves nothing.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.bench.solvers import Solution
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.model.dynamics import Condensed
from orbimpc_ros.mpc.problem import Problem, State

LOCAL = 1e-6  # largest tolerance of a local solver: looser ones violate limits
QUIET: dict[str, Any] = {'expand': True, 'print_time': False, 'ipopt.print_level': 0}
SIDES = np.array([[-1.0, 0.0], [0.0, -1.0], [1.0, 0.0], [0.0, 1.0]])


class MixedInteger:
    """The program of a planar problem with a floor, turns below a quarter, boxes or an arrival.

    A subclass implements it in a solver's Python interface.

    Args:
        problem: to solve.
        gap: relative gap to prove.
        cap: time limit [s].
        closed_loop: whether instances follow each other, so that a warm start is possible.
    """

    emphasis = 'FAST'  # SCIP's settings, four times as fast as its defaults around the rope
    model: Any  # of the solver's Python interface
    open: Callable[[], None]  # begins a model with the solver's options
    require: Callable[[Any], None]  # adds a constraint
    minimise: Callable[[Array, Any], None]  # of a sum of squares and a linear part
    start: Callable[[Any], None]  # offers pairs of variable and value
    solve: Callable[[], None]
    found: Callable[[], Solution]  # objective and gap; NaN without a solution
    value: Callable[[Any], float]  # of a variable in the best solution

    def __init__(self, problem: Problem, gap: float, cap: float, *, closed_loop: bool) -> None:
        self.problem, self.gap, self.cap, self._closed_loop = problem, gap, cap, closed_loop
        condensed = Condensed(problem)
        self.factor, self._affine = _factor(0.5 * condensed.hessian), condensed.affine
        self._advance = problem.step * problem.forward
        self._reach = problem.maps.reach[:, 1:]  # coefficients of z in s_1..s_N, shape (N, N)
        self._groups: list[Array] = []  # variables by constraint, step and coordinate
        self._begun = False  # whether the last solution is a warm start

    def ready(self, state: State, goals: Array) -> Callable[[], Solution]:
        """Build the model of an instance; return its solve."""
        problem, self.heading = self.problem, state.attitude[:, 0]
        last = [np.vectorize(self.value)(group) for group in self._groups] if self._begun else []
        self.open()
        self._groups = []
        z = self._free(problem.horizon, 2, lb=-1.0, ub=1.0)
        for x, y in z:
            self.require(x * x + y * y <= 1.0)
            if problem.floor.shape == 'circle':
                self.require(x * x + y * y >= problem.floor.fraction**2)
        if problem.turns_are_angles:
            self._limit_turns([self.heading.tolist(), *z])
        if problem.floor.shape == 'polygon':
            low = problem.floor.fraction
            faces = normals(2, problem.floor.faces)
            self._choose(z, faces, np.full(len(faces), low), 1.0 + low)
        first = state.position + self._advance * state.rotation[:, 0]  # s_1, which is decided
        flown = self._reach @ z
        for box in problem.boxes:
            offsets = np.concatenate([-box.minimum, box.maximum]) - SIDES @ first
            # The big M is twice the distance flown in a horizon.
            self._choose(flown[1:], SIDES, offsets, 2.0 * problem.horizon * self._advance)
        if problem.terminal == 'constraint':
            for moved, distance in zip(flown[-1], goals[-1] - first, strict=True):
                self.require(moved == float(distance))
        linear, constant = self._affine(state, goals)
        cost = linear.ravel() @ z.ravel() + constant + self._lengths(z[:-1])
        self.minimise((self.factor @ z).ravel(), cost)
        if last:
            moved = [np.concatenate([group[1:], group[-1:]]) for group in last]
            self.start(zip(_flat(self._groups), _flat(moved), strict=True))
        return self._solved

    def _free(self, *shape: int, **kind: Any) -> Array:
        """Return new variables, one row per step."""
        made = np.empty(shape, dtype=object)
        for place in np.ndindex(shape):
            made[place] = self.model.addVar(**kind)
        self._groups.append(made)
        return made

    def _limit_turns(self, axes: Sequence[Any]) -> None:
        """Limit the angle a of every turn: |x cross y| <= tan(a) x . y."""
        slope = float(np.tan(self.problem.widest_turn))
        for (x, y), (u, v) in itertools.pairwise(axes):
            ahead, aside = x * u + y * v, x * v - y * u
            self.require(aside <= slope * ahead)
            self.require(-aside <= slope * ahead)

    def _choose(self, points: Array, faces: Array, offsets: Array, big: float) -> None:
        """Require faces_i . point >= offsets_i for some i, for every point, by binaries."""
        chosen = self._free(len(points), len(faces), vtype='B')
        for each in chosen.sum(axis=1):
            self.require(each >= 1.0)
        beyond = points @ faces.T - big * chosen
        for place in np.ndindex(beyond.shape):
            self.require(beyond[place] >= float(offsets[place[1]]) - big)

    def _lengths(self, axes: Array) -> Any:
        """Return the cost of the length, with |z_k| as an epigraph."""
        weight = self.problem.weights.length * self._advance
        if weight == 0.0:
            return 0.0
        norms = [self.model.addVar(lb=0.0, ub=1.0) for _ in axes]
        for (x, y), norm in zip(axes, norms, strict=True):
            self.require(x * x + y * y <= norm * norm)
        return sum(weight * norm for norm in norms)

    def _solved(self) -> Solution:
        self.solve()
        found = self.found()
        self._begun = self._closed_loop and not np.isnan(found.objective)
        return found


class _Gurobi(MixedInteger):
    """A quadratic objective, cones and nonconvex quadratic constraints."""

    def open(self) -> None:
        import gurobipy

        self._library = gurobipy
        quiet = {'OutputFlag': 0, 'Threads': 1, 'MIPGap': self.gap, 'TimeLimit': self.cap}
        self.model = gurobipy.Model(env=gurobipy.Env(params=quiet))

    def require(self, constraint: Any) -> None:
        self.model.addConstr(constraint)

    def minimise(self, squared: Array, linear: Any) -> None:
        squares = self._library.quicksum(each * each for each in squared)
        self.model.setObjective(squares + linear)
        self.model.update()

    def start(self, values: Any) -> None:
        for variable, value in values:
            variable.Start = value

    def solve(self) -> None:
        self.model.optimize()

    def found(self) -> Solution:
        capped = self.model.Status == self._library.GRB.TIME_LIMIT
        if not self.model.SolCount:
            return Solution(np.nan, np.nan, capped)
        return Solution(self.model.ObjVal, self.model.MIPGap, capped)

    def value(self, variable: Any) -> float:
        return float(variable.X)


class _Scip(MixedInteger):
    """The quadratic cost as one constraint of pure squares, which SCIP recognises as convex."""

    def open(self) -> None:
        import pyscipopt

        self._library, self.model = pyscipopt, pyscipopt.Model()
        model, settings = self.model, pyscipopt.SCIP_PARAMSETTING
        model.hideOutput()
        for tune in (model.setHeuristics, model.setPresolve, model.setSeparating):
            tune(getattr(settings, self.emphasis))
        model.setParam('limits/gap', self.gap)
        model.setParam('limits/time', self.cap)

    def require(self, constraint: Any) -> None:
        self.model.addCons(constraint)

    def minimise(self, squared: Array, linear: Any) -> None:
        total = self.model.addVar(lb=0.0, ub=None)
        terms = [self.model.addVar(lb=None, ub=None) for _ in squared]
        for term, each in zip(terms, squared, strict=True):
            self.model.addCons(each == term)
        squares = self._library.quicksum(term * term for term in terms)
        self.model.addCons(squares <= total)
        self.model.setObjective(total + linear)

    def start(self, values: Any) -> None:
        solution = self.model.createPartialSol()
        for variable, value in values:
            self.model.setSolVal(solution, variable, value)
        self.model.addSol(solution)

    def solve(self) -> None:
        self.model.optimize()

    def found(self) -> Solution:
        capped = self.model.getStatus() == 'timelimit'
        if self.model.getNSols() == 0:
            return Solution(np.nan, np.nan, capped)
        value = self.model.getObjVal()
        gap = (value - self.model.getDualbound()) / max(1e-9, abs(value))
        return Solution(value, gap, capped)

    def value(self, variable: Any) -> float:
        return float(self.model.getVal(variable))


class _Ipopt(MixedInteger):
    """A program without binaries, in CasADi, with exact derivatives: no polygon, no boxes."""

    def open(self) -> None:
        import casadi

        self._library, self.model, self._opti = casadi, self, casadi.Opti()

    def addVar(self, **_bounds: float) -> Any:  # noqa: N802
        return self._opti.variable()  # bounded by the unit disk

    def require(self, constraint: Any) -> None:
        self._opti.subject_to(constraint)

    def minimise(self, squared: Array, linear: Any) -> None:
        opti = self._opti
        opti.minimize(squared @ squared + linear)
        program = {'x': opti.x, 'f': opti.f, 'g': opti.g}
        tuned = QUIET | {'ipopt.sb': 'yes', 'ipopt.tol': min(self.gap, LOCAL)}
        self._solver = self._library.nlpsol('plan', 'ipopt', program, tuned)
        limits = {name: opti.value(getattr(opti, name)) for name in ('lbg', 'ubg')}
        self._data: dict[str, Any] = {'x0': np.resize(self.heading, opti.nx), **limits}

    def solve(self) -> None:
        self._found = self._solver(**self._data)

    def found(self) -> Solution:
        done = self._solver.stats()['success']
        return Solution(float(self._found['f']) if done else np.nan)


PROGRAMS: dict[str, type[MixedInteger]] = {
    'gurobipy': _Gurobi,
    'pyscipopt': _Scip,
    'casadi': _Ipopt,
}


def _flat(groups: list[Array]) -> Array:
    return np.concatenate([group.ravel() for group in groups])


def _factor(matrix: Array) -> Array:
    """Return F, as small as can be, with F^T F a positive semidefinite matrix."""
    values, vectors = np.linalg.eigh(matrix)
    kept = values > 1e-12 * max(values[-1], 1.0)
    return np.asarray(np.linalg.qr(np.sqrt(values[kept])[:, None] * vectors[:, kept].T, 'r'))
