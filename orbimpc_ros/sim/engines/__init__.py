# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Engines: physics libraries that fly a vehicle on the commands of a real one.

An engine is an independent library, such as JSBSim, with its published vehicle and inner loop. The
modules here configure it, pass on commands and read the motion. They import nothing from the rest
of the package: engine and planner share no code.
"""

from __future__ import annotations

import math
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

os.environ.setdefault('MUJOCO_GL', 'disable')  # read when MuJoCo is imported; nothing is rendered


class EngineFailure(Exception):
    """An engine cannot start as requested, has stopped, or returned non-finite numbers."""


class Start(NamedTuple):
    """Initial state of a vehicle and its goal; n is the dimension of the flight."""

    position: Array  # shape (n,) [m]
    velocity: Array  # shape (n,) [m/s]
    attitude: Array  # body to world, shape (n, n)
    body_rate: Array  # shape (1,) or (3,) [rad/s]
    push: float  # speed through the air [m/s], or acceleration by thrust [m/s^2]
    wind: Array  # steady, shape (n,) [m/s], or an acceleration [m/s^2] with thrust commands
    gust: float  # standard deviation of the turbulence along each axis [m/s]
    seed: int  # of the turbulence and the engine's other random draws
    rest: Array  # rest position of the goal, shape (n,) [m]
    goal: Array  # initial position of the goal, shape (n,) [m]


class Motion(NamedTuple):
    """State of a vehicle in an engine; axes are ENU in the world, forward-left-up in the body."""

    time: float  # since the engine was created [s]
    position: Array  # shape (3,) [m]
    velocity: Array  # over ground, shape (3,) [m/s]
    attitude: Array  # body to world, shape (3, 3)
    body_rate: Array  # shape (3,) [rad/s]
    air: Array  # velocity of the surrounding air, shape (3,) [m/s]
    push: float  # speed through the air [m/s], or acceleration by thrust [m/s^2]
    facts: Mapping[str, float]  # further quantities that the engine reports, by name
    goal: Array | None = None  # position of a goal moved by the engine, shape (3,) [m]
    caught: bool | None = None  # whether the goal has been caught; None if not judged by the engine
    lost: bool = False  # whether a catch has become impossible


class Engine(ABC):
    """A vehicle in an engine; one with its own guidance may also ``steer_to`` a waypoint."""

    name: str  # name of the library
    tick: float  # command period, to which times are rounded [s]
    every: int = 1  # ticks between returned motions

    @abstractmethod
    def motion(self) -> Motion:
        """Return the present state of motion."""

    @abstractmethod
    def fly(self, push: float, rate: Array) -> None:
        """Fly for one tick on a command; see :meth:`run`."""

    def run(self, span: float, push: float, rate: Array) -> list[Motion]:
        """Fly for a time and return the motions on the way, the last one at the end.

        Args:
            span: duration [s].
            push: command along the thrust axis, a speed [m/s] or an acceleration [m/s^2].
            rate: commanded body rate, shape (1,), positive to the left, or shape (3,) [rad/s].

        Raises:
            EngineFailure: the engine has stopped, or its numbers are not finite.
        """
        motions, count = [], max(1, round(span / self.tick))
        for k in range(1, count + 1):
            self.fly(push, rate)
            if k % self.every == 0 or k == count:
                motion = self.motion()
                goal = 0.0 if motion.goal is None else motion.goal
                numbers = *motion[:7], *motion.facts.values(), goal
                if not all(np.isfinite(each).all() for each in numbers):
                    wrong = f'numbers that are not finite at t = {motion.time:.3f} s'
                    raise EngineFailure(f'{self.name}: {wrong}')
                motions.append(motion)
        return motions


def about(axis: int, angle: float) -> Array:
    """Return the rotation about an axis by an angle [rad]."""
    cos, sin = math.cos(angle), math.sin(angle)
    rotation = np.eye(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation[first, first] = rotation[second, second] = cos
    rotation[first, second], rotation[second, first] = -sin, sin
    return rotation
