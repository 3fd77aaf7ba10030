# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Turns in space without bodies: the best path within one plane.

A fixed wing turns towards its goal in the plane spanned by its heading and the goal. This planar
problem is solved by the search over sectors in a millisecond or two, and its headings, mapped back
to space, satisfy floor and turn rate as they do in the plane. If goals or wind lie in no plane
through the heading, the plane that fits the goals best (weighted least squares) is taken. Among
bodies it is a path to begin with.

Mathematics: docs/mathematics.md, 4.9.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orbimpc_ros.mpc.geometry.rotations import carried, coordinates, matrix
from orbimpc_ros.mpc.model.dynamics import motion_weights
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.mpc.problem.reach import decided
from orbimpc_ros.mpc.search.engine import PlanarSearch
from orbimpc_ros.mpc.solve.request import Found, Request


class PlanarWay:
    """Planner of paths in a plane for problems in space with a floor and a turn rate.

    Args:
        problem: what to solve; its obstacles are ignored.
        tolerance: relative gap at which the planar search stops.
    """

    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._problem, self._weights = problem, np.sqrt(motion_weights(problem)[:-1])
        self._search = PlanarSearch(_planar(problem), tolerance)

    @staticmethod
    def leads(problem: Problem) -> bool:
        """Return True if planar paths satisfy all constraints of a problem except its obstacles."""
        arrives, aimed = problem.terminal == 'constraint', problem.approach.exists
        plain = not (arrives or aimed or problem.has_cones or problem.max_acceleration)
        fits = problem.dimension == 3 and problem.turns_are_angles and plain
        return fits and PlanarSearch.solves(_planar(problem))

    def solve(self, request: Request) -> Found:
        """Return the best path, as one of many without a bound; none on overflow."""
        state, attitude = request.state, request.state.attitude
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
        guess = None if request.guess is None else request.guess[:, :3] @ plane
        goals = (request.goals - state.position) @ plane
        found = self._search.solve(request._replace(state=flat, goals=goals, guess=guess))
        x = None if found.x is None else coordinates(carried(attitude, found.x @ plane.T))
        return replace(found, x=x, lower_bound=-np.inf, proofs=())


def _planar(problem: Problem) -> Problem:
    """Return the planar problem without bodies, whose floor allows every heading."""
    floor = Floor('circle', fraction=problem.floor.circling(3))
    weights = replace(problem.weights, attitude=0.0)
    return replace(problem, dimension=2, floor=floor, obstacles=(), weights=weights)
