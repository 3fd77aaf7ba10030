# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Turns in space: the best way in one plane.

A wing that cannot stop, and is to be somewhere else, turns in the plane of its heading and its
goal. What it flies there is a problem of the plane, which the search over sectors settles in a
millisecond or two; carried into space, its headings hold floor and turn rate as they do in the
plane. Where goals or wind leave every plane through the heading, it is the one that they leave the
least.

Mathematics: docs/mathematics.md, 4.9.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import carried, coordinates, matrix
from orbimpc_ros.mpc.model.dynamics import drift, position_weights
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.mpc.search.engine import Engine
from orbimpc_ros.mpc.solve.request import Guess, Request


class PlanarWay:
    """Finds ways that turn in a plane, for problems of space with a floor and a turn rate.

    Args:
        problem: what to solve; its obstacles are not seen.
        tolerance: relative gap, in the plane, at which a way is good enough.
    """

    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._problem, self._weights = problem, np.sqrt(position_weights(problem))
        self._search = Engine(_planar(problem), tolerance)

    @staticmethod
    def leads(problem: Problem) -> bool:
        """Return whether ways in a plane hold all of a problem but its obstacles."""
        plain = not (problem.approach.exists or problem.has_cones or problem.max_acceleration)
        spatial = (problem.dimension, problem.rotation_order) == (3, 1)
        return spatial and plain and problem.turns_are_angles and Engine.solves(_planar(problem))

    def way(self, request: Request) -> Array:
        """Return the rotation coordinates R_1..R_N of the best way found, shape (N, 9)."""
        state, attitude = request.state, request.state.attitude
        aside = (request.goals - drift(self._problem, state)) @ attitude[:, 1:]
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
        assert found.x is not None  # the search begins with one
        return coordinates(carried(attitude, found.x @ plane.T))


def _planar(problem: Problem) -> Problem:
    """Return the problem in a plane, at speeds that every heading of space may have."""
    floor = Floor('circle', fraction=problem.floor.circling(3))
    weights = replace(problem.weights, attitude=0.0)
    return replace(problem, dimension=2, floor=floor, obstacles=(), weights=weights)
