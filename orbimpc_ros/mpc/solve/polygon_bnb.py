# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The search for the commonest problems of SE(2), in machine code where numba is installed.

Mathematics: docs/mathematics.md, 4.3.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.cells import faces
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.linear import quadratic
from orbimpc_ros.mpc.model.condensed import LONGEST, Condensed
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.cell_tree import CellSearch
from orbimpc_ros.mpc.solve.general import General
from orbimpc_ros.mpc.solve.request import Found, Guess, Request

NODES = 6400


class PolygonSearch:
    """Solves SE(2) problems with no constraint but the hull and a polygonal floor.

    What the kernel cannot settle, it leaves to the general search, unless there is a deadline.

    Args:
        problem: what to solve.
        tolerance: relative gap at which a search stops.
    """

    takes_guess = False  # checking one costs more than it saves
    trusts_guess = True

    def __init__(self, problem: Problem, tolerance: float, *, coasting: bool = False) -> None:
        self._problem, self._tolerance = problem, tolerance
        self._condensed = Condensed(problem)
        count = problem.floor.faces if problem.floor.shape == 'polygon' else 0
        cells = faces(count, problem.floor.fraction)
        self._search = CellSearch(self._condensed.hessian, cells, tolerance, NODES)
        self._general = General(problem, tolerance)
        # The first call compiles, or loads what was compiled before: at start-up, not in a tick.
        self._search.begin(np.zeros((problem.horizon, 2)), 0.0)
        self._search.run()
        self._search.dive()
        origin = np.zeros((problem.horizon, 2))
        self._found(origin, 0.0, Request(State.at(np.zeros(2), np.eye(2)), origin))

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether this method applies to a problem, and is fast on this machine."""
        return (
            COMPILED
            and (problem.dimension, problem.rotation_order) == (2, 1)
            and problem.floor.shape in ('none', 'polygon')
            and problem.terminal == 'penalty'
            and problem.weights.length == problem.max_rate == problem.arrival_weight == 0.0
            and not problem.max_acceleration
            and not problem.obstacles
            and not problem.approach.exists
            and problem.horizon <= LONGEST
        )

    def solve(self, request: Request) -> Found:
        """Return the best trajectory with the bound proved.

        See :class:`orbimpc_ros.mpc.solve.disjunctive_bnb.DisjunctiveSearch` for the rest.
        """
        q, constant = self._condensed.affine(request.state, request.goals)
        search = self._search
        search.begin(q, constant)
        while not search.run(request.out_of_time):
            search.dive()
            if request.late:
                break
        else:
            if search.complete and search.nodes < NODES:
                return self._found(q, constant, request)
            search.dive()
        found = self._found(q, constant, request)
        # Who has a deadline is better off with this than with a search that is slower.
        if request.hurried:
            return found
        assert found.x is not None
        guess = Guess(found.x, found.cost)
        return self._general.solve(request._replace(guess=guess))

    def _found(self, q: Array, constant: float, request: Request) -> Found:
        """Return the best of a search, with the bound that it has proved."""
        search = self._search
        cost = float(quadratic(self._condensed.hessian, q, search.best)) + constant
        proof = search.proof if request.leaves_time_for(search.tangents) else None
        return Found(search.best, cost, search.bound + constant, search.nodes, proof=proof)
