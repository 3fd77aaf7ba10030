# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""IPOPT through CasADi: the nonlinear program with a round floor, one cold start, no proof.

:math:`f^2 \le |z_k|^2 \le 1` for the thrust axes, turns limited in angle, exact derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.bench.solvers import Declined, Solution
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.problem import Problem, State

QUIET: dict[str, Any] = {'print_time': False, 'ipopt.print_level': 0, 'ipopt.sb': 'yes'}
# Bounds are not relaxed, as is IPOPT's habit: a cost below that of every legal plan says nothing.
OPTIONS = {'ipopt.tol': 1e-9, 'ipopt.bound_relax_factor': 0.0, 'ipopt.max_iter': 500}
TINY = 1e-20  # keeps a root smooth


class NonlinearProgram:
    """The nonlinear program of a planar problem of orders (1, 1), length and arrival left out.

    Args:
        problem: to state.
        options: of CasADi and IPOPT.

    Raises:
        Declined: a polygonal floor, which takes integers.
    """

    def __init__(self, problem: Problem, options: Mapping[str, Any]) -> None:
        if problem.floor.shape == 'polygon':
            raise Declined('polygonal floors are not stated')
        self._condensed, steps = Condensed(problem), problem.horizon
        z, linear, first = ca.SX.sym('z', steps, 2), ca.SX.sym('q', steps, 2), ca.SX.sym('a', 1, 2)
        quadratic = ca.DM(self._condensed.hessian)
        least = problem.floor.fraction**2 if problem.floor.exists else -np.inf
        limits = [(ca.sum2(z * z), least, 1.0)]
        if problem.max_rate > 0.0:
            before = ca.vertcat(first, z[:-1, :])
            sizes = ca.sqrt(ca.sum2(z * z) * ca.sum2(before * before) + TINY)
            turned = ca.sum2(z * before) - np.cos(problem.widest_turn) * sizes
            limits.append((turned, 0.0, np.inf))
        self._low = np.repeat([low for _, low, _ in limits], steps)
        self._high = np.repeat([high for *_, high in limits], steps)
        program = {
            'x': ca.vec(z),
            'p': ca.vertcat(ca.vec(linear), first.T),
            'f': 0.5 * ca.trace(z.T @ quadratic @ z) + ca.sum1(ca.sum2(linear * z)),
            'g': ca.vertcat(*(limit for limit, _, _ in limits)),
        }
        self._solver = ca.nlpsol('plan', 'ipopt', program, {**QUIET, **options})

    def solve(self, state: State, goals: Array, start: Array) -> tuple[Array | None, float]:
        """Return axes z_1..z_N, shape (N, 2), and their cost; None and NaN without convergence.

        Args:
            state: start of the plan.
            goals: g_1..g_N, shape (N, 2) [m].
            start: axes to start from, shape (N, 2).
        """
        linear, constant = self._condensed.affine(state, goals)
        found = self._solver(
            x0=start.ravel(order='F'),
            p=np.append(linear.ravel(order='F'), state.attitude[:, 0]),
            lbg=self._low,
            ubg=self._high,
        )
        if not self._solver.stats()['success']:
            return None, np.nan
        return np.asarray(found['x']).reshape(2, -1).T, float(found['f']) + constant


class Ipopt:
    """One start from the present heading, held.

    Args:
        problem: to solve.
        tolerance: IPOPT's.
    """

    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._steps = problem.horizon
        self._program = NonlinearProgram(problem, {'ipopt.tol': tolerance})
        self._value = np.nan

    def prepare(self, state: State, goals: Array) -> None:
        """Set the data of an instance."""
        self._data = state, goals, np.tile(state.attitude[:, 0], (self._steps, 1))

    def solve(self) -> None:
        """Solve the program."""
        _, self._value = self._program.solve(*self._data)

    def solution(self) -> Solution:
        """Return the local optimum's cost."""
        return Solution(self._value)
