# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The interface of a solver, and this package's own solver."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.plan import Plan, shifted
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.solver import Solver as OwnSolver

PROJECTION = 'thrust_aligned'


@dataclass(frozen=True)
class Solution:
    """The result of one instance."""

    objective: float  # of its trajectory; NaN if it found none
    gap: float = math.nan  # relative, as it proved it; NaN if it proves nothing
    capped: bool = False  # whether it reached its time limit


class Solver(Protocol):
    """A solver set up for one problem."""

    def ready(self, state: State, goals: Array) -> Callable[[], Solution]:
        """Return the solve of an instance, which alone is timed.

        Args:
            state: start of the plan.
            goals: g_1..g_N, shape (N, n) [m].
        """


class Ours:
    """This package's solver, warm-started with the shifted previous plan.

    Args:
        problem: to solve.
        gap: relative gap within which a plan counts as proved.
        cap: time limit [s].
        closed_loop: whether instances follow each other, so that the previous plan is a warm start.
    """

    def __init__(self, problem: Problem, gap: float, cap: float, *, closed_loop: bool) -> None:
        self._problem, self._cap, self._closed_loop = problem, cap, closed_loop
        self._solver = OwnSolver(problem, projection=PROJECTION, gap_tolerance=gap)
        self._plan: Plan | None = None

    def ready(self, state: State, goals: Array) -> Callable[[], Solution]:
        """Return a solve like the controller's, including the shift of the previous plan."""

        def solve() -> Solution:
            guess, end = None, time.perf_counter() + self._cap
            if self._closed_loop and self._solver.takes_guess and self._plan is not None:
                guess = shifted(self._problem, state, self._plan)
            plan = self._solver.propose(state, goals, guess, lambda: time.perf_counter() > end)
            self._plan = plan
            return Solution(plan.objective, plan.gap, not plan.is_closed)

        return solve
