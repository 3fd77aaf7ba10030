# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""CVXPY solved anew at each tick: stated once, DPP, only parameters change.

Its solver runs on one thread, with its own tolerances (Clarabel: 1e-8, QOCO: 1e-7).
"""

from __future__ import annotations

import warnings

import cvxpy as cp
import numpy as np

from benchmarks.bench.solvers import Solution
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.translation import step_of
from orbimpc_ros.mpc.problem import Problem, State


class Resolve:
    """The relaxed problem as the paper states it, in CVXPY.

    Args:
        problem: what to solve; its floor and boxes are left out.
        solver: by its name in CVXPY.
    """

    def __init__(self, problem: Problem, *, solver: str = cp.CLARABEL) -> None:
        if solver not in cp.installed_solvers():
            raise ImportError(solver)
        self._solver = solver
        self._options = {'max_threads': 1} if solver == cp.CLARABEL else {}
        self._problem, n, steps = problem, problem.dimension, problem.horizon
        self._s_0, self._p_0 = cp.Parameter(n), cp.Parameter(n)
        self._goals, self._wind = cp.Parameter((steps, n)), cp.Parameter(n)
        self._x_0, self._w_0 = cp.Parameter(n * n), cp.Parameter(n * n)
        # R_k, column by column, in row k: the first n entries are R_k e1.
        self._x = cp.Variable((steps + 1, n * n))
        self._s = cp.Variable((steps + 1, n))
        rows = [*self._rotations(), *self._translations()]
        self._program = cp.Problem(cp.Minimize(self._cost()), rows)
        self._value = np.nan

    def _rotations(self) -> list[cp.Constraint]:
        problem, x, h = self._problem, self._x, self._problem.step
        rows = [x[0] == self._x_0]
        if problem.rotation_order == 1:
            self._u = (x[1:] - x[:-1]) / h
        else:
            rates = cp.Variable((problem.horizon, problem.dimension**2))
            rows += [rates[0] == self._w_0, x[1:] == x[:-1] + h * rates]
            self._u = (rates[1:] - rates[:-1]) / h
        for k in range(1, problem.horizon + 1):
            rows += _orbitope(x[k], problem.dimension)
        return rows

    def _translations(self) -> list[cp.Constraint]:
        problem, s, n = self._problem, self._s, self._problem.dimension
        once = step_of(problem.translation, problem.step, problem.forward)
        before, after = self._x[:-1, :n], self._x[1:, :n]
        blown = cp.reshape(self._wind, (1, n), order='C')
        pushed = [
            push * before + follow * after + np.ones((problem.horizon, 1)) @ (blow * blown)
            for push, follow, blow in zip(once.push, once.follow, once.blow, strict=True)
        ]
        rows = [s[0] == self._s_0]
        if problem.translation_order == 1:
            rows.append(s[1:] == s[:-1] + pushed[0])
        else:
            p = cp.Variable(s.shape)
            rows += [p[0] == self._p_0, p[1:] == p[:-1] + pushed[1]]
            rows.append(s[1:] == s[:-1] + problem.step * p[:-1] + pushed[0])
            if problem.terminal == 'constraint':
                rows.append(p[-1] == 0)
        if problem.terminal == 'constraint':
            rows.append(s[-1] == self._goals[-1])
        return rows

    def _cost(self) -> cp.Expression:
        problem, w, n = self._problem, self._problem.weights, self._problem.dimension
        cost = w.input * cp.sum_squares(self._u)
        if w.position:
            cost += w.position * cp.sum_squares(self._s[1:] - self._goals)
        if w.terminal:
            cost += w.terminal * cp.sum_squares(self._s[-1] - self._goals[-1])
        if w.length:
            lengths = cp.norm(self._x[:, :n], axis=1)
            cost += w.length * problem.step * problem.forward * (problem.maps.lasting @ lengths)
        return cost

    def solve(self, state: State, goals: Array) -> None:
        """Set the parameters and solve."""
        self._s_0.value, self._p_0.value, self._goals.value = state.position, state.velocity, goals
        self._wind.value = state.disturbance
        self._x_0.value = state.rotation.ravel(order='F')
        self._w_0.value = state.rotation_rate.ravel(order='F')
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # of inaccurate solutions: objectives are compared
            self._program.solve(solver=self._solver, enforce_dpp=True, **self._options)
        self._value = float(self._program.value)

    def solution(self) -> Solution:
        """Return the optimal value, which the solver's duality proves to its tolerance."""
        relaxed = self._problem.floor.exists or bool(self._problem.obstacles)
        tolerance = 1e-8 if self._solver == cp.CLARABEL else 1e-7
        return Solution(self._value, tolerance, relaxed=relaxed)


def _orbitope(x: cp.Expression, n: int) -> list[cp.Constraint]:
    """Return R in conv SO(n): a disk for n = 2, the paper's 4x4 matrix for n = 3."""
    if n == 2:
        return [x[3] == x[0], x[2] == -x[1], cp.norm(x[:2]) <= 1]
    a = cp.reshape(x, (3, 3), order='F')
    rows = [
        [1 + a[0, 0] + a[1, 1] + a[2, 2], a[2, 1] - a[1, 2], a[0, 2] - a[2, 0], a[1, 0] - a[0, 1]],
        [a[2, 1] - a[1, 2], 1 + a[0, 0] - a[1, 1] - a[2, 2], a[1, 0] + a[0, 1], a[0, 2] + a[2, 0]],
        [a[0, 2] - a[2, 0], a[1, 0] + a[0, 1], 1 - a[0, 0] + a[1, 1] - a[2, 2], a[2, 1] + a[1, 2]],
        [a[1, 0] - a[0, 1], a[0, 2] + a[2, 0], a[2, 1] + a[1, 2], 1 - a[0, 0] - a[1, 1] + a[2, 2]],
    ]
    return [cp.bmat(rows) >> 0]
