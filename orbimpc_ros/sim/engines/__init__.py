# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Engines: physics libraries that fly a vehicle on the commands that a real one takes.

An engine is a library of its own, such as JSBSim, with a vehicle and an inner loop that it has
published. The modules here set it up, pass on the commands and read the motion. They import nothing
of the rest of the package: an engine and the planner share no code.
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

os.environ.setdefault('MUJOCO_GL', 'disable')  # read when MuJoCo is imported: nothing is drawn


class EngineFailure(Exception):
    """An engine cannot begin as it is asked to, stopped, or returned what is not finite."""


class Start(NamedTuple):
    """How a vehicle and its goal begin, in as many dimensions n as the vehicle is flown in."""

    position: Array  # shape (n,) [m]
    velocity: Array  # shape (n,) [m/s]
    attitude: Array  # body to world, shape (n, n)
    body_rate: Array  # shape (1,) or (3,) [rad/s]
    push: float  # speed through the air [m/s], or acceleration by thrust [m/s^2]
    wind: Array  # steady, shape (n,) [m/s], or an acceleration [m/s^2] of what takes thrusts
    gust: float  # standard deviation of the air's velocity along each axis, on top [m/s]
    seed: int  # of the gusts, or of what else an engine draws
    rest: Array  # where the goal is when it is at rest, shape (n,) [m]
    goal: Array  # where it is at the start, shape (n,) [m]


class Motion(NamedTuple):
    """A vehicle in an engine at one moment; axes are ENU, and forward, left, up in the body."""

    time: float  # since the engine was made [s]
    position: Array  # shape (3,) [m]
    velocity: Array  # over ground, shape (3,) [m/s]
    attitude: Array  # body to world, shape (3, 3)
    body_rate: Array  # shape (3,) [rad/s]
    air: Array  # velocity of the air around it, shape (3,) [m/s]
    push: float  # speed through the air [m/s], or acceleration by thrust [m/s^2]
    facts: Mapping[str, float]  # what else the engine reports of its vehicle, by name
    goal: Array | None = None  # where the goal is, shape (3,) [m], if the engine moves it, too
    caught: bool | None = None  # whether the goal has been caught, where the engine decides that
    lost: bool = False  # whether it cannot be caught any more

    @property
    def finite(self) -> bool:
        """Return whether all its numbers are finite."""
        numbers = np.concatenate([np.ravel(part) for part in self[:7]])
        if self.goal is not None:
            numbers = np.append(numbers, self.goal)
        return bool(np.isfinite(numbers).all()) and all(map(math.isfinite, self.facts.values()))


class Engine(ABC):
    """A vehicle in an engine; one with guidance of its own may also ``steer_to`` a waypoint."""

    name: str  # of the library
    tick: float  # from one command to the next, to which it rounds times [s]
    every: int = 1  # ticks between two motions that are returned

    @abstractmethod
    def motion(self) -> Motion:
        """Return how the vehicle moves now."""

    @abstractmethod
    def fly(self, push: float, rate: Array) -> None:
        """Fly for a tick on a command; see :meth:`run`."""

    def run(self, span: float, push: float, rate: Array) -> list[Motion]:
        """Fly for a time and return the motions on the way, the last one at its end.

        Args:
            span: how long [s].
            push: commanded, along the axis that pushes [m/s or m/s^2].
            rate: commanded, in the body frame: to the left, shape (1,), or shape (3,) [rad/s].

        Raises:
            EngineFailure: the engine has stopped, or its numbers are not finite.
        """
        motions, count = [], max(1, round(span / self.tick))
        for k in range(1, count + 1):
            self.fly(push, rate)
            if k % self.every == 0 or k == count:
                motion = self.motion()
                if not motion.finite:
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
