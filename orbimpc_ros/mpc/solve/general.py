# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The general search, made when something is first left to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.solve.request import Found, Request

if TYPE_CHECKING:
    from orbimpc_ros.mpc.solve.branch_and_bound import BranchAndBound


class General:
    """A search that costs nothing until it is needed.

    Args:
        problem: what to solve.
        tolerance: relative gap at which a search stops.
    """

    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._problem, self._tolerance = problem, tolerance
        self._search: BranchAndBound | None = None

    def solve(self, request: Request) -> Found:
        """Solve as :class:`orbimpc_ros.mpc.solve.branch_and_bound.BranchAndBound` does."""
        if self._search is None:
            from orbimpc_ros.mpc.solve.branch_and_bound import BranchAndBound  # takes Clarabel

            self._search = BranchAndBound(self._problem, self._tolerance)
        return self._search.solve(request)
