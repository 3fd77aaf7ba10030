"""Scenarios by name: what flies from where, what it is after, and the problem its planner solves.

The numbers of ``retrieval`` that the paper does not give were chosen; how is told in
``config/retrieval.yaml``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import number, whole
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Floor, Problem
from orbimpc_ros.world.rope import Rope
from orbimpc_ros.world.vehicle import Model, Vehicle, launched, model_of

MAX_TICKS = 1_000_000


@dataclass(frozen=True)
class Scenario:
    """A vehicle, its start and its goal.

    Attributes:
        model: how the vehicle answers to commands.
        start: where it is at the start; its time is the start's.
        rope: the goal, swinging or fixed.
        capture_radius: the goal counts as caught within it [m].
        max_ticks: steps after which the flight ends without capture.
    """

    model: Model
    start: Vehicle
    rope: Rope
    capture_radius: float
    max_ticks: int

    def __post_init__(self) -> None:
        n = self.model.dimension
        if len(self.start.position) != n:
            raise BadInput('start.position', self.start.position.tolist(), f'{n} numbers')
        if len(self.rope.center) != n:
            raise BadInput('rope.center', self.rope.center.tolist(), f'{n} numbers')
        number(self.capture_radius, 'capture_radius', 0.0, 1e6, above=True)
        whole(self.max_ticks, 'max_ticks', 1, MAX_TICKS)


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
