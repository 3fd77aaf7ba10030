# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Scenarios by name: what flies from where, what it is after, and the problem its planner solves.

The numbers that the paper does not give were chosen; the files of the same names in ``config/`` say
how.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from orbimpc_ros.mpc.arrays import ABOVE_ZERO, within
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Approach, Box, Floor, Hazard, Problem, Weights
from orbimpc_ros.sim.rope import Rope, fixed
from orbimpc_ros.sim.vehicle import Model, Vehicle, launched, model_of

MAX_TICKS = 1_000_000
FINISHES = ('capture', 'arrival')
LIMITS: dict[str, tuple[float, float]] = {  # of a scenario, by attribute
    'capture_radius': (ABOVE_ZERO, 1e6),
    'max_ticks': (1, MAX_TICKS),
    'arrival_radius': (ABOVE_ZERO, 1e6),
    'arrival_speed': (0.0, 1e6),
    'rope_length': (0.0, 1e6),
}


@dataclass(frozen=True)
class Scenario:
    """A vehicle, its start and its goal.

    Attributes:
        model: how the vehicle answers to commands.
        start: where it is at the start; its time is the start's.
        rope: the goal, swinging or fixed.
        capture_radius: the goal counts as caught within it [m].
        max_ticks: steps after which the flight ends.
        finish: ``capture``, it ends as soon as the goal is caught; ``arrival``, it ends after
            ``max_ticks`` and has to be at the goal then.
        arrival_radius: how far from the goal a vehicle that has arrived may be [m].
        arrival_speed: and how fast [m/s]; 0 for any speed.
        obstacles: boxes; who touches one has not done the job.
        traffic: balls that move, each evenly from the start on; who touches one has not either.
        approach: who is headed elsewhere at a capture has not done it either; its direction is
            given where there is a cone.
        rope_length: the rope hangs so far [m], half of it above the plane of flight, for vehicles
            that may leave it.
    """

    model: Model
    start: Vehicle
    rope: Rope
    capture_radius: float
    max_ticks: int
    finish: str = 'capture'
    arrival_radius: float = 0.05
    arrival_speed: float = 0.0
    obstacles: tuple[Box, ...] = ()
    traffic: tuple[Hazard, ...] = ()
    approach: Approach = field(default_factory=Approach)
    rope_length: float = 0.0

    def __post_init__(self) -> None:
        n = self.model.dimension
        self.approach.validate(n)
        if self.approach.is_the_goals:
            raise BadInput('approach.direction', [], f'{n} numbers')
        if len(self.start.position) != n:
            raise BadInput('start.position', self.start.position.tolist(), f'{n} numbers')
        if len(self.rope.center) != n:
            raise BadInput('rope.center', self.rope.center.tolist(), f'{n} numbers')
        within(self, LIMITS)
        if self.finish not in FINISHES:
            raise BadInput.choice('finish', self.finish, FINISHES)


def retrieval_problem() -> Problem:
    """Return the paper's UAV problem: five steps ahead, det R > 0.3 by a square."""
    return Problem(floor=Floor('polygon', 4, math.sqrt(0.3)))


def retrieval() -> Scenario:
    """Return the paper's UAV retrieval: a rope swinging about (5, 0), caught in flight."""
    model = model_of(retrieval_problem())
    return Scenario(
        model=model,
        start=launched(model, np.zeros(2), np.eye(2)),
        rope=Rope(
            np.array([5.0, 0.0]), np.array([0.5, 0.5]), 0.1, np.array([5.0, 3.5]) * np.pi / 3.0
        ),
        capture_radius=0.2,
        max_ticks=60,
    )


def retrieval3d_problem() -> Problem:
    """Return the UAV's problem in space: as in the plane, |R e1| > sqrt(0.3) by a cube."""
    return Problem(dimension=3, floor=Floor('polygon', 6, math.sqrt(0.3)))


def retrieval3d() -> Scenario:
    """Return the retrieval in space: a rope swinging about (6, 3, 4), forecast and caught."""
    model = model_of(retrieval3d_problem())
    return Scenario(
        model=model,
        start=launched(model, np.zeros(3), np.eye(3)),
        rope=Rope(
            np.array([6.0, 3.0, 4.0]),
            np.array([0.5, 0.5, 0.25]),
            0.18,
            np.array([2.0, 9.0, 4.0]) * np.pi / 6.0,
        ),
        capture_radius=0.15,
        max_ticks=60,
    )


def dubins_problem(floor: str = 'polygon') -> Problem:
    """Return the paper's Dubins car: the shortest way in 20 steps; a floor of det R = 1/2."""
    return Problem(
        horizon=20,
        weights=Weights(position=0.0, input=0.05, length=1.0, terminal=0.0),
        terminal='constraint',
        floor=Floor(floor, 4, math.sqrt(0.5)),
    )


def dubins() -> Scenario:
    """Return the paper's Dubins car: from the origin along x to (5, 10) at t = 20 s."""
    model = model_of(dubins_problem())
    start = launched(model, np.zeros(2), np.eye(2))
    return Scenario(
        model=model,
        start=start,
        rope=fixed(np.array([5.0, 10.0])),
        capture_radius=0.2,
        max_ticks=20,
        finish='arrival',
        arrival_radius=1e-3,
    )


def spacecraft_problem() -> Problem:
    """Return the paper's spacecraft: second order in space, at the goal and at rest at t = 20 s."""
    return Problem(
        dimension=3,
        rotation_order=2,
        translation_order=2,
        horizon=20,
        weights=Weights(position=0.0, input=1.0, length=0.1, terminal=0.0),
        terminal='constraint',
    )


def spacecraft() -> Scenario:
    """Return the paper's spacecraft: from rest, its thrust along -x, to (5, 10, 25), at rest."""
    model = model_of(spacecraft_problem())
    away = np.diag([-1.0, -1.0, 1.0])
    return Scenario(
        model=model,
        start=launched(model, np.zeros(3), away, fraction=0.0),
        rope=fixed(np.array([5.0, 10.0, 25.0])),
        capture_radius=0.2,
        max_ticks=20,
        finish='arrival',
        arrival_radius=0.05,
        arrival_speed=0.05,
    )
