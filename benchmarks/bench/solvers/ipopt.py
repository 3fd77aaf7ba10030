# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""IPOPT through CasADi: the study's nonlinear program, one cold start.

A local solver: it proves nothing about the global optimum. One thread.
"""

from __future__ import annotations

import numpy as np

from benchmarks.baselines.nonlinear import NonlinearProgram
from benchmarks.bench.solvers import Solution
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem, State


class Ipopt:
    """The nonlinear program of a planar problem with the true floor, without length or arrival.

    Args:
        problem: what to solve.
        tolerance: IPOPT's.
    """

    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._steps = problem.horizon
        self._program = NonlinearProgram(problem, {'ipopt.tol': tolerance})
        self._value = np.nan

    def solve(self, state: State, goals: Array) -> None:
        """Solve from the present heading, held."""
        start = np.tile(state.attitude[:, 0], (self._steps, 1))
        _, self._value = self._program.solve(state, goals, start)

    def solution(self) -> Solution:
        """Return the local optimum's cost."""
        return Solution(self._value)
