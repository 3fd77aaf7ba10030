# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""CVXPY with Clarabel: the paper's relaxation, stated once (DPP) and solved at each tick."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import cvxpy as cp
import numpy as np
from oracles import Stated

from benchmarks.bench.solvers import Solution
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem, State

TOLERANCE = 1e-8  # Clarabel's own


class Conic:
    """The relaxation of a problem without floor and boxes, as in the tests.

    Args:
        problem: to solve.
    """

    def __init__(self, problem: Problem) -> None:
        n = problem.dimension
        self._start = {name: cp.Parameter(n) for name in ('position', 'velocity')}
        self._start |= {name: cp.Parameter((n, n)) for name in ('rotation', 'rotation_rate')}
        self._goals = [cp.Parameter(n) for _ in range(problem.horizon)]
        start: Any = SimpleNamespace(**self._start, disturbance=np.zeros(n), coasted=None)
        goals: Any = self._goals
        self._stated = Stated(problem, start, goals)

    def ready(self, state: State, goals: Array) -> Callable[[], Solution]:
        """Set the parameters; return the solve."""
        for name, parameter in self._start.items():
            parameter.value = getattr(state, name)
        for parameter, goal in zip(self._goals, goals, strict=True):
            parameter.value = goal
        return self._solved

    def _solved(self) -> Solution:
        """Return the optimal value, proved by duality to the solver's tolerance, on one thread."""
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # of inaccurate solutions: objectives are compared
            value = self._stated.optimum(enforce_dpp=True, max_threads=1)
        return Solution(float(value), TOLERANCE)
