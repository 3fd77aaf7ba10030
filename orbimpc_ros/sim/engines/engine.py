# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The interface of an engine: how it starts, the motions that it returns, and their check."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from orbimpc_ros.sim.engines import EngineFailure

Array = NDArray[np.floating]


class Start(NamedTuple):
    """How a vehicle and its goal begin, in as many dimensions n as the vehicle is flown in.

    Attributes:
        position: shape (n,) [m].
        velocity: shape (n,) [m/s].
        attitude: body to world, shape (n, n).
        body_rate: in the body frame, shape (1,) or (3,) [rad/s].
        push: speed through the air [m/s], or acceleration by thrust [m/s^2].
        wind: that is steady, shape (n,) [m/s], or an acceleration [m/s^2] of what takes thrusts.
        gust: standard deviation of the air's velocity along each axis, on top [m/s].
        seed: of the gusts, or of what else an engine draws.
        rest: where the goal is when it is at rest, shape (n,) [m].
        goal: where it is at the start, shape (n,) [m].
    """

    position: Array
    velocity: Array
    attitude: Array
    body_rate: Array
    push: float
    wind: Array
    gust: float
    seed: int
    rest: Array
    goal: Array


class Motion(NamedTuple):
    """A vehicle in an engine at one moment; axes are ENU, and x forward, y left, z up in the body.

    Attributes:
        time: since the engine was made [s].
        position: shape (3,) [m].
        velocity: over ground, shape (3,) [m/s].
        attitude: body to world, shape (3, 3).
        body_rate: shape (3,) [rad/s].
        air: velocity of the air around it, shape (3,) [m/s].
        push: speed through the air [m/s], or acceleration by thrust [m/s^2].
        facts: what else the engine reports of its vehicle, by name.
        goal: where the goal is, shape (3,) [m], if the engine moves it, too.
        caught: whether the goal has been caught, where the engine decides that.
        lost: whether it cannot be caught any more.
    """

    time: float
    position: Array
    velocity: Array
    attitude: Array
    body_rate: Array
    air: Array
    push: float
    facts: Mapping[str, float]
    goal: Array | None = None
    caught: bool | None = None
    lost: bool = False

    @property
    def airspeed(self) -> float:
        """Return how fast it moves through the air [m/s]."""
        return float(np.linalg.norm(self.velocity - self.air))

    @property
    def finite(self) -> bool:
        """Return whether all its numbers are finite."""
        numbers = np.concatenate([np.ravel(part) for part in self[:7]])
        if self.goal is not None:
            numbers = np.append(numbers, self.goal)
        return bool(np.isfinite(numbers).all()) and all(map(math.isfinite, self.facts.values()))


class Engine(Protocol):
    """A vehicle in an engine.

    Attributes:
        name: of the library.
        tick: the step of its integration, to which it rounds times [s].
    """

    name: str
    tick: float

    def motion(self) -> Motion:
        """Return how the vehicle moves now."""

    def run(self, span: float, push: float, rate: Array) -> list[Motion]:
        """Fly for a time and return the motions on the way, the last one at its end.

        Args:
            span: how long [s].
            push: commanded, along the axis that pushes [m/s or m/s^2].
            rate: commanded, in the body frame: to the left, shape (1,), or shape (3,) [rad/s].
        """


@runtime_checkable
class Guided(Protocol):
    """An engine whose vehicle has a guidance of its own."""

    def steer_to(self, point: Array) -> None:
        """Have it fly to a waypoint, shape (n,) [m], from now on."""


def checked(engine: Engine, before: float, motions: list[Motion], span: float) -> list[Motion]:
    """Return motions that follow on a time ``before`` [s] and last a span [s].

    Raises:
        EngineFailure: they do not, or have numbers that are not finite.
    """
    time = before
    for motion in motions:
        if not motion.finite:
            raise EngineFailure(
                f'{engine.name}: numbers that are not finite, after t = {time:.3f} s'
            )
        if motion.time <= time:
            raise EngineFailure(f'{engine.name}: went from t = {time:.3f} s to {motion.time:.3f} s')
        time = motion.time
    if not math.isclose(time, before + span, abs_tol=engine.tick):
        raise EngineFailure(
            f'{engine.name}: its clock is at {time:.3f} s, and not at {before + span:.3f} s'
        )
    return motions
