# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Turns without bodies: the best path within one plane; interception by such paths.

A fixed wing turns towards its goal in the plane spanned by its heading and the goal. This planar
problem is solved by the search over sectors in a millisecond or two, and its headings, mapped back
to space, satisfy floor and turn rate as they do in the plane. If goals or wind lie in no plane
through the heading, the plane that fits the goals best (weighted least squares) is taken. Among
bodies it is a path to begin with, in planar problems too.

Mathematics: docs/mathematics.md, 4.9.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import carried, coordinates, matrix
from orbimpc_ros.mpc.model.dynamics import position_weights, trajectory_of
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.mpc.problem.reach import decided
from orbimpc_ros.mpc.search.engine import PlanarSearch
from orbimpc_ros.mpc.solve.request import Found, Guess, Method, Request, general

ALONE = 'only paths in the plane of heading and goal were searched'


class PlanarWay:
    """Planner of paths in a plane for problems with a floor and a turn rate.

    Args:
        problem: what to solve; its obstacles are ignored.
        tolerance: relative gap at which the planar search stops.
    """

    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._problem, self._weights = problem, np.sqrt(position_weights(problem))
        self._search = PlanarSearch(_planar(problem), tolerance)

    @staticmethod
    def leads(problem: Problem) -> bool:
        """Return True if planar paths satisfy all constraints of a problem except its obstacles."""
        plain = not (problem.approach.exists or problem.has_cones or problem.max_acceleration)
        fits = problem.dimension == 2 or problem.rotation_order == 1
        return fits and plain and problem.turns_are_angles and PlanarSearch.solves(_planar(problem))

    def way(self, request: Request) -> Array:
        """Return the rotation coordinates of R_1..R_N of the best path found, shape (N, d)."""
        state, attitude = request.state, request.state.attitude
        if self._problem.dimension == 2:
            found = self._search.solve(request)
            assert found.x is not None  # the search begins with one
            return found.x
        aside = (request.goals - decided(self._problem, state)[0][1:]) @ attitude[:, 1:]
        across = np.linalg.svd(self._weights[:, None] * aside)[2][0]
        plane = np.column_stack([attitude[:, 0], attitude[:, 1:] @ across])
        flat = State.at(
            np.zeros(2),
            matrix(plane.T @ state.rotation[:, 0]),
            velocity=plane.T @ state.velocity,
            attitude=np.eye(2),
            disturbance=plane.T @ state.disturbance,
        )
        guess = request.guess and Guess(request.guess.x[:, :3] @ plane, np.inf)
        goals = (request.goals - state.position) @ plane
        found = self._search.solve(request._replace(state=flat, goals=goals, guess=guess))
        assert found.x is not None
        return coordinates(carried(attitude, found.x @ plane.T))


class PlanarCatch:
    """Solver for spatial problems with a floor and a turn rate where only the last goal matters.

    Plans in a plane have no bound in space; unless time is short, the general search is used.

    Args:
        problem: what to solve.
        tolerance: relative gap at which the planar search stops.
    """

    takes_guess = trusts_guess = True

    def __init__(self, problem: Problem, tolerance: float, *, coasting: bool = False) -> None:
        self._problem, self._tolerance = problem, tolerance
        self._plane = PlanarWay(problem, tolerance)

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return True if this method applies to a problem and is fast on this machine."""
        return (
            problem.dimension == 3
            and problem.weights.position == problem.weights.attitude == 0.0
            and not problem.obstacles
            and PlanarWay.leads(problem)
        )

    @cached_property
    def _general(self) -> Method:
        return general(self._problem, self._tolerance)

    def solve(self, request: Request) -> Found:
        """Return the best planar trajectory, or if time allows that of the general search."""
        if not request.hurried:
            return self._general.solve(request)
        x, guess = self._plane.way(request), request.guess
        cost = trajectory_of(self._problem, request.state, request.goals, x).cost
        if guess is not None and guess.cost <= cost:
            x, cost = guess.x, guess.cost
        return Found(x, cost, -np.inf, 1, ALONE)


def _planar(problem: Problem) -> Problem:
    """Return the planar problem without bodies, with a floor that allows every heading."""
    floor = Floor('circle', fraction=problem.floor.circling(problem.dimension))
    weights = replace(problem.weights, attitude=0.0)
    return replace(problem, dimension=2, floor=floor, obstacles=(), weights=weights)
