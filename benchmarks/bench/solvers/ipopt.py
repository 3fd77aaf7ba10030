# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""IPOPT through CasADi: the nonlinear program with a round floor, one cold start, no proof.

:math:`f^2 \le |z_k|^2 \le 1` for the thrust axes, turns limited in angle, exact derivatives.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from benchmarks.bench.solvers import Declined, Solution
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.problem import Problem, State

QUIET: dict[str, Any] = {'print_time': False, 'ipopt.print_level': 0, 'ipopt.sb': 'yes'}
TINY = 1e-20  # keeps a root smooth


class Ipopt:
    """A planar problem of orders (1, 1), from the present heading, held.

    Args:
        problem: to state; length and arrival are left out.
        tolerance: IPOPT's.

    Raises:
        Declined: a polygonal floor, which takes integers.
    """

    def __init__(self, problem: Problem, tolerance: float) -> None:
        if problem.floor.shape == 'polygon':
            raise Declined('polygonal floors are not stated')
        self._condensed, self._steps = Condensed(problem), problem.horizon
        steps = problem.horizon
        z, linear, first = ca.SX.sym('z', steps, 2), ca.SX.sym('q', steps, 2), ca.SX.sym('a', 1, 2)
        quadratic = ca.DM(self._condensed.hessian)
        least = problem.floor.fraction**2 if problem.floor.exists else -np.inf
        limits = [(ca.sum2(z * z), least, 1.0)]
        if problem.max_rate > 0.0:
            before = ca.vertcat(first, z[:-1, :])
            sizes = ca.sqrt(ca.sum2(z * z) * ca.sum2(before * before) + TINY)
            turned = ca.sum2(z * before) - np.cos(problem.widest_turn) * sizes
            limits.append((turned, 0.0, np.inf))
        self._bounds = {
            'lbg': np.repeat([low for _, low, _ in limits], steps),
            'ubg': np.repeat([high for *_, high in limits], steps),
        }
        program = {
            'x': ca.vec(z),
            'p': ca.vertcat(ca.vec(linear), first.T),
            'f': 0.5 * ca.trace(z.T @ quadratic @ z) + ca.sum1(ca.sum2(linear * z)),
            'g': ca.vertcat(*(limit for limit, _, _ in limits)),
        }
        self._solver = ca.nlpsol('plan', 'ipopt', program, {**QUIET, 'ipopt.tol': tolerance})

    def prepare(self, state: State, goals: Array) -> None:
        """Set the data of an instance."""
        linear, self._constant = self._condensed.affine(state, goals)
        axis = state.attitude[:, 0]
        known = np.append(linear.ravel(order='F'), axis)
        self._data = {'x0': np.repeat(axis, self._steps), 'p': known, **self._bounds}

    def solve(self) -> None:
        """Solve the program."""
        self._found = self._solver(**self._data)

    def solution(self) -> Solution:
        """Return the local optimum's cost; NaN without convergence."""
        if not self._solver.stats()['success']:
            return Solution(np.nan)
        return Solution(float(self._found['f']) + self._constant)
