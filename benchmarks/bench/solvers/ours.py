# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""This package, as its controller uses it: the guess is the shifted previous plan."""

from __future__ import annotations

import time

from benchmarks.bench.solvers import Solution
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.plan import Plan, shifted
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.solver import Solver

PROJECTION = 'thrust_aligned'


class Ours:
    """The solver of this package; shifting the previous plan is part of what is timed.

    Args:
        problem: what to solve.
        gap: relative gap within which a plan counts as proved.
        cap: time limit [s].
        closed_loop: whether instances follow each other, so that the previous plan is of use.
    """

    def __init__(
        self, problem: Problem, gap: float = 1e-4, cap: float = 60.0, *, closed_loop: bool = False
    ) -> None:
        self._problem, self._cap, self._closed_loop = problem, cap, closed_loop
        self._solver = Solver(problem, projection=PROJECTION, gap_tolerance=gap)
        self._plan: Plan | None = None

    def solve(self, state: State, goals: Array) -> None:
        """Plan as the controller does."""
        guess, end = None, time.perf_counter() + self._cap
        if self._closed_loop and self._solver.takes_guess(state) and self._plan is not None:
            guess = shifted(self._problem, state, goals, self._plan, projection=PROJECTION)
        self._plan = self._solver.propose(state, goals, guess, lambda: time.perf_counter() > end)

    def solution(self) -> Solution:
        """Return the plan's objective and proof."""
        plan = self._plan
        assert plan is not None
        return Solution(plan.objective, plan.gap, not plan.is_closed)
