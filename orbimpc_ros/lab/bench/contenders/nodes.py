"""This package's own tree over faces, with CVXPY solved anew at every node."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from orbimpc_ros.lab.bench.contenders.contender import Answer, relative_gap
from orbimpc_ros.lab.bench.contenders.resolve import Resolve
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.disjunctive_bnb import DisjunctiveSearch
from orbimpc_ros.mpc.solve.relaxation import Halfspace, Relaxation
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import SEARCH_SHARE


class _Program:
    """What a search asks of its program, answered by CVXPY."""

    def __init__(self, problem: Problem) -> None:
        self._resolve = Resolve(problem, halfspaces=True)

    def relax(self, request: Request, halfspaces: Iterable[Halfspace] = ()) -> Relaxation:
        self._resolve.bind(request.state, request.goals)
        self._resolve.hold(halfspaces)
        value = self._resolve.optimise()
        if value == float('inf'):
            raise Infeasible('no trajectory satisfies the constraints')
        if value != value:
            return Relaxation(None, -math.inf)
        return self._resolve.relaxation()


class Nodes:
    """Branch and bound over a polygon floor, orders (1, 1), no other disjunctions.

    Args:
        problem: what to solve.
        gap: relative gap to prove; the search goes on to the same share of it as the solver's.
    """

    def __init__(self, problem: Problem, gap: float) -> None:
        self._search = DisjunctiveSearch(problem, SEARCH_SHARE * gap)
        program: Any = _Program(problem)
        self._search.program = program
        self._found: Any = None

    def solve(self, state: State, goals: Array) -> None:
        """Search from scratch."""
        self._found = self._search.solve(Request(state, goals))

    def answer(self) -> Answer:
        """Return the best cost and its gap."""
        found = self._found
        return Answer(found.cost, relative_gap(found.cost, found.lower_bound))
