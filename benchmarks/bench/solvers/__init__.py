# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The interface of a solver, and this package's own solver."""

from __future__ import annotations

import math
import time
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
    """A solver set up for one problem. Only :meth:`solve` is timed."""

    def prepare(self, state: State, goals: Array) -> None:
        """Set the data of an instance.

        Args:
            state: start of the plan.
            goals: g_1..g_N, shape (N, n) [m].
        """

    def solve(self) -> None:
        """Solve the instance."""

    def solution(self) -> Solution:
        """Return the result of the last solve."""


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

    def prepare(self, state: State, goals: Array) -> None:
        """Set the data of an instance."""
        self._state, self._goals = state, goals

    def solve(self) -> None:
        """Plan as the controller does, including the shift of the previous plan."""
        state, goals = self._state, self._goals
        guess, end = None, time.perf_counter() + self._cap
        if self._closed_loop and self._solver.takes_guess and self._plan is not None:
            guess = shifted(self._problem, state, self._plan)
        self._plan = self._solver.propose(state, goals, guess, lambda: time.perf_counter() > end)

    def solution(self) -> Solution:
        """Return the plan's objective and proof."""
        plan = self._plan
        assert plan is not None
        return Solution(plan.objective, plan.gap, not plan.is_closed)
