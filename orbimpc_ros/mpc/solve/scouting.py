# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A first way among what is round or moves, for a search to start from.

Mathematics: docs/mathematics.md, 4.11.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.scout import (
    ANYWHERE,
    CHANGING,
    TURNING,
    Craft,
    World,
    advance,
    begun,
    flood,
    traced,
)
from orbimpc_ros.mpc.model.dynamics import input_weight, position_weights, velocity_weight
from orbimpc_ros.mpc.model.translation import step_of
from orbimpc_ros.mpc.problem import Ball, Box, Problem, State
from orbimpc_ros.mpc.problem.leaving import directions
from orbimpc_ros.mpc.problem.traffic import Traffic

BEAM = 64
SPEEDS = (1.0, 0.5)  # shares of the way from the least to the full one
STEERED = (1.0, 2 / 3, 1 / 3, 0.01)  # speeds; who stands still has no heading to be turned
TURNS = (0.0, -1.0, 1.0, -0.5, 0.5)  # of the widest
WITHIN = 1.0 - 1e-6
CELL = 0.25  # of a step's length, and of a step's change of speed
GRID = 48


class Scout:
    """Looks for ways in a problem with vehicles of rotation order 1.

    Args:
        problem: what to solve.
        steered: whether headings turn by no more than ``max_rate`` allows, however slow they are,
            though the problem bounds chords; in the plane.
    """

    def __init__(self, problem: Problem, *, steered: bool = False) -> None:
        self._problem, n = problem, problem.dimension
        self._widest = WITHIN * problem.chord if steered else np.inf
        self._kind, self._moves = (
            (TURNING, _turns(problem, STEERED)) if steered else _moves(problem)
        )
        self._weights = position_weights(problem)
        if self.useful:  # the first call compiles, or loads what was compiled before
            start = State.at(np.zeros(n), np.eye(n))
            still = np.zeros((1, problem.horizon + 1, n)) + 1e3
            self._scouted(
                start, np.ones((problem.horizon, n)), still, np.ones((1, problem.horizon))
            )

    @property
    def useful(self) -> bool:
        """Return whether there is a scout for a problem, and it is fast on this machine."""
        return COMPILED and self._problem.rotation_order == 1 and len(self._moves) > 0

    def way(
        self,
        state: State,
        goals: Array,
        traffic: Traffic,
        out_of_time: Callable[[], bool] | None = None,
    ) -> Array | None:
        """Return headings R_1 e1..R_N e1, shape (N, n); None if no way was found in time."""
        if not self.useful:
            return None
        pairs = [_ball(body) for body in traffic.bodies]
        centres = np.array([centre for centre, _ in pairs])[:, None] + traffic.shifts
        radii = np.array([radius for _, radius in pairs])[:, None] + traffic.grown
        return self._scouted(state, goals, centres, np.maximum(radii, 0.0), out_of_time)

    def _scouted(
        self,
        state: State,
        goals: Array,
        centres: Array,
        radii: Array,
        out_of_time: Callable[[], bool] | None = None,
    ) -> Array | None:
        problem, n = self._problem, self._problem.dimension
        start = np.array([state.position, state.velocity])
        vehicle, world = self._vehicle(state), self._world(state, goals, centres, radii)
        cell = CELL * problem.length_unit
        swift = CELL * problem.step * problem.forward if problem.inertial else 1e9
        known = start, state.rotation[:, 0], state.attitude[:, 0]
        trail = begun(*known, problem.horizon, BEAM)
        for k in range(problem.horizon):
            late = out_of_time is not None and out_of_time()
            if late or not advance(vehicle, world, k, trail, cell * (1 + (n == 3)), swift):
                return None
        return traced(trail)

    def _vehicle(self, state: State) -> Craft:
        problem = self._problem
        once = step_of(problem.translation, problem.step, problem.forward)
        m, blown = len(once.push), np.zeros((2, problem.dimension))
        transition, push, follow = np.zeros((2, 2)), np.zeros(2), np.zeros(2)
        transition[:m, :m], push[:m], follow[:m] = once.transition, once.push, once.follow
        blown[:m] = np.outer(once.blow, state.disturbance)
        least = problem.least_speed
        known = transition, push, follow, blown
        return Craft(*known, self._kind, self._moves, least, self._widest, problem.inertial)

    def _world(self, state: State, goals: Array, centres: Array, radii: Array) -> World:
        field, corner, spacing = self._field(state, goals, centres, radii)
        return World(
            np.ascontiguousarray(centres),
            np.ascontiguousarray(radii),
            np.array(goals),
            self._weights.astype(float),
            input_weight(self._problem) / self._problem.step**2,
            velocity_weight(self._problem),
            field,
            corner,
            spacing,
        )

    def _field(
        self, state: State, goals: Array, centres: Array, radii: Array
    ) -> tuple[Array, Array, float]:
        """Return how far the last goal is, around what stands still; in the plane only."""
        still = np.ptp(centres, axis=1).max(axis=1) == 0.0
        if self._problem.dimension == 3 or not still.any():
            return np.zeros((0, 0)), np.zeros(self._problem.dimension), 1.0
        ends = np.array([state.position, goals[-1], *centres[still, 0]])
        low, high = ends.min(axis=0), ends.max(axis=0)
        room = 2.0 * radii[still].max() + self._problem.length_unit
        low, size = low - room, float((high - low).max()) + 2.0 * room
        spacing = size / (GRID - 1)
        places = low + spacing * np.moveaxis(np.indices((GRID, GRID)), 0, -1)
        apart = np.linalg.norm(places[:, :, None] - centres[still, 0], axis=-1)
        free = (apart > radii[still].max(axis=1)).all(axis=-1)
        goal = np.rint((goals[-1] - low) / spacing).astype(np.int64)
        return flood(free, goal, spacing), low, spacing


def _ball(body: Box | Ball) -> tuple[Array, float]:
    """Return centre and radius of a ball around a body."""
    if isinstance(body, Box):
        return 0.5 * (body.minimum + body.maximum), float(
            np.linalg.norm(0.5 * (body.maximum - body.minimum))
        )
    return body.centre, body.radius


def _moves(problem: Problem) -> tuple[int, Array]:
    """Return which headings follow a heading, and as which moves; none where that is not known."""
    least = problem.floor.circling(problem.dimension) if problem.floor.exists else 0.0
    speeds = [least + share * (1.0 - least) for share in SPEEDS]
    if problem.turns_are_angles:
        if problem.dimension == 3:
            return TURNING, np.zeros((0, 2))
        return TURNING, _turns(problem, speeds)
    units = directions(problem.dimension)
    if problem.max_rate:
        changes = [share * WITHIN * problem.chord * units for share in (1.0, 0.5)]
        return CHANGING, np.vstack([np.zeros((1, problem.dimension)), *changes])
    every = [speed * units for speed in speeds]
    still = [] if least else [np.zeros((1, problem.dimension))]
    return ANYWHERE, np.vstack([*every, *still])


def _turns(problem: Problem, speeds: Sequence[float]) -> Array:
    """Return the angles of turns, and speeds, as rows, shape (A, 2)."""
    widest = WITHIN * problem.widest_turn
    return np.array([[turn * widest, speed] for speed in speeds for turn in TURNS])
