# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""CVXPY with Clarabel: the paper's relaxation, stated once (DPP), solved anew at each tick."""

from __future__ import annotations

import warnings

import cvxpy as cp

from benchmarks.bench.solvers import Solution
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem, State

TOLERANCE = 1e-8  # Clarabel's own


class Conic:
    """The relaxation of a problem with explicit Euler steps, without floor and boxes.

    Args:
        problem: to solve.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, n, steps = problem, problem.dimension, problem.horizon
        self._s_0, self._p_0 = cp.Parameter(n), cp.Parameter(n)
        self._x_0, self._w_0 = cp.Parameter(n * n), cp.Parameter(n * n)
        self._goals = cp.Parameter((steps, n))
        # R_k, column by column, in row k: the first n entries are R_k e1.
        self._x = cp.Variable((steps + 1, n * n))
        self._s = cp.Variable((steps + 1, n))
        rows = [*self._rotations(), *self._translations()]
        self._program = cp.Problem(cp.Minimize(self._cost()), rows)

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
        problem, s, h = self._problem, self._s, self._problem.step
        pushed = h * problem.forward * self._x[:-1, : problem.dimension]
        arrives = problem.terminal == 'constraint'
        rows = [s[0] == self._s_0]
        if problem.translation_order == 1:
            rows.append(s[1:] == s[:-1] + pushed)
        else:
            p = cp.Variable(s.shape)
            rows += [p[0] == self._p_0, p[1:] == p[:-1] + pushed, s[1:] == s[:-1] + h * p[:-1]]
            rows += [p[-1] == 0] if arrives else []
        return [*rows, s[-1] == self._goals[-1]] if arrives else rows

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

    def prepare(self, state: State, goals: Array) -> None:
        """Set the parameters."""
        self._s_0.value, self._p_0.value, self._goals.value = state.position, state.velocity, goals
        self._x_0.value = state.rotation.ravel(order='F')
        self._w_0.value = state.rotation_rate.ravel(order='F')

    def solve(self) -> None:
        """Solve on one thread."""
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # of inaccurate solutions: objectives are compared
            self._program.solve(solver=cp.CLARABEL, enforce_dpp=True, max_threads=1)

    def solution(self) -> Solution:
        """Return the optimal value, proved by duality to the solver's tolerance."""
        return Solution(float(self._program.value), TOLERANCE)


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
