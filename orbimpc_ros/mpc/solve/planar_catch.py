# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Interception in space by a fixed wing: paths in the plane of its heading and its goal.

Mathematics: docs/mathematics.md, 4.9.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.model.dynamics import trajectory_of
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.solve.planar_way import PlanarWay
from orbimpc_ros.mpc.solve.registry import General
from orbimpc_ros.mpc.solve.request import Found, Request

ALONE = 'only paths in the plane of heading and goal were searched'


class PlanarCatch:
    """Solver for spatial problems with a floor and a turn rate where only the last goal matters.

    Plans in a plane have no bound in space; unless time is short, the general search is used.

    Args:
        problem: what to solve.
        tolerance: relative gap at which the planar search stops.
    """

    takes_guess = trusts_guess = True

    def __init__(self, problem: Problem, tolerance: float, *, coasting: bool = False) -> None:
        self._problem, self._plane = problem, PlanarWay(problem, tolerance)
        self._general = General(problem, tolerance)

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return True if this method applies to a problem and is fast on this machine."""
        return (
            problem.weights.position == problem.weights.attitude == 0.0
            and not problem.obstacles
            and PlanarWay.leads(problem)
        )

    def solve(self, request: Request) -> Found:
        """Return the best planar trajectory, or if time allows that of the general search."""
        if not request.hurried:
            return self._general.solve(request)
        x, guess = self._plane.way(request), request.guess
        cost = trajectory_of(self._problem, request.state, request.goals, x).cost
        if guess is not None and guess.cost <= cost:
            x, cost = guess.x, guess.cost
        return Found(x, cost, -np.inf, 1, ALONE)
