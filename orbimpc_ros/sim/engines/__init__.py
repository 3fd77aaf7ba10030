# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Vehicles, and engines: physics libraries that fly one on the commands of a real one.

An engine is an independent library, such as JSBSim, with its published vehicle and inner loop. The
modules here configure it, pass on commands and read the motion. They import nothing from the rest
of the package: engine and planner share no code.
"""

from __future__ import annotations

import math
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

os.environ.setdefault('MUJOCO_GL', 'disable')  # read when MuJoCo is imported; nothing is rendered


class EngineFailure(Exception):
    """An engine cannot start as requested, has stopped, or returned non-finite numbers."""


@dataclass(frozen=True)
class Vehicle:
    """State of a simulated vehicle; an engine can continue only from its latest state.

    Axes are ENU in the world and forward-left-up in the body; n is the dimension of the flight.
    """

    time: float  # since the start of the flight [s]
    position: Array  # s, shape (n,) [m]
    velocity: Array  # p, in the world frame, shape (n,) [m/s]; a dependent variable at order 1
    attitude: Array  # Q, body to world, shape (n, n)
    body_rate: Array  # omega, in the body frame, shape (1,) or (3,) [rad/s]
    fraction: float  # sigma, applied share of full speed or thrust, in [0, 1]
    wind: Array  # shape (n,) [m/s]
    height: float = 0.0  # above the plane of flight [m]; 0 in space
    climb: float = 0.0  # upward airspeed, normal to that plane [m/s]
    facts: Mapping[str, float] = field(default_factory=dict)  # further quantities, by name
    goal: Array | None = None  # shape (n,) [m]; None if the scenario sets it
    caught: bool | None = None  # whether the goal has been caught; None if distance decides
    lost: bool = False  # whether a catch has become impossible
    engine: Engine | None = None  # moves the vehicle

    @property
    def airspeed(self) -> float:
        """Return the airspeed [m/s]."""
        return float(np.linalg.norm(np.append(self.velocity - self.wind, self.climb)))

    def level(self) -> Vehicle:
        """Return a state in space as one in the plane of flight, turning at its fact ``turn``."""
        yaw, height = math.atan2(*self.attitude[1::-1, 0]), float(self.position[2])
        return replace(
            self,
            position=self.position[:2],
            velocity=self.velocity[:2],
            attitude=about(2, yaw)[:2, :2],
            body_rate=np.array([self.facts['turn']]),
            wind=self.wind[:2],
            height=height,
            climb=float((self.velocity - self.wind)[2]),
            facts={'height': height, **self.facts},
            goal=None if self.goal is None else self.goal[:2],
        )


class Engine(ABC):
    """A vehicle in an engine; one with its own guidance may also ``steer_to`` a waypoint.

    Args:
        start: initial state, in the air of a steady ``wind``; a wind with thrust commands is an
            acceleration [m/s^2]. The goal is at its initial position.
        forward: full speed through the air [m/s], or full acceleration by thrust [m/s^2].
        gust: standard deviation of the turbulence along each axis [m/s].
        seed: of the turbulence and the engine's other random draws.
        rest: rest position of the goal, shape (n,) [m].
    """

    name: str  # name of the library
    tick: float  # command period, to which times are rounded [s]
    every: int = 1  # ticks between returned states

    @abstractmethod
    def state(self) -> Vehicle:
        """Return the present state; its time counts from the creation of the engine."""

    @abstractmethod
    def fly(self, fraction: float, rate: Array) -> None:
        """Fly for one tick on a command; see :meth:`run`."""

    def run(self, span: float, fraction: float, rate: Array) -> tuple[Vehicle, ...]:
        """Fly for a time and return the states on the way, the last one at the end.

        Args:
            span: duration [s].
            fraction: commanded share of full speed or thrust, clipped to [0, 1].
            rate: commanded body rate, shape (1,), positive to the left, or shape (3,) [rad/s].

        Raises:
            EngineFailure: the engine has stopped, or its numbers are not finite.
        """
        states, count = tuple[Vehicle, ...](), max(1, round(span / self.tick))
        fraction = min(max(float(fraction), 0.0), 1.0)
        for k in range(1, count + 1):
            self.fly(fraction, rate)
            if k % self.every == 0 or k == count:
                now = replace(self.state(), engine=self)
                values = *vars(now).values(), *now.facts.values()
                numbers = (each for each in values if isinstance(each, (float, np.ndarray)))
                if not all(np.isfinite(each).all() for each in numbers):
                    wrong = f'numbers that are not finite at t = {now.time:.3f} s'
                    raise EngineFailure(f'{self.name}: {wrong}')
                states += (now,)
        return states


def about(axis: int, angle: float) -> Array:
    """Return the rotation about an axis by an angle [rad]."""
    cos, sin = math.cos(angle), math.sin(angle)
    rotation = np.eye(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation[first, first] = rotation[second, second] = cos
    rotation[first, second], rotation[second, first] = -sin, sin
    return rotation
