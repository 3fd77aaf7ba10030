"""The general search, made when something is first left to it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.request import Found, Guess

if TYPE_CHECKING:
    from orbimpc_ros.mpc.solve.disjunctive_bnb import Search


class General:
    """A search that costs nothing until it is needed.

    Args:
        problem: what to solve.
        tolerance: relative gap at which a search stops.
    """

    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._problem, self._tolerance = problem, tolerance
        self._search: Search | None = None

    def solve(
        self,
        state: State,
        goals: Array,
        guess: Guess | None,
        out_of_time: Callable[[], bool] | None,
    ) -> Found:
        """Solve as :class:`orbimpc_ros.mpc.solve.disjunctive_bnb.Search` does."""
        if self._search is None:
            from orbimpc_ros.mpc.solve.disjunctive_bnb import (
                Search,  # brings CVXPY, half of a start-up
            )

            self._search = Search(self._problem, self._tolerance)
        return self._search.solve(state, goals, guess, out_of_time)
