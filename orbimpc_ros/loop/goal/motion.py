# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Where a goal was seen, and where it will be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.errors import BadInput


@dataclass(frozen=True)
class GoalObservation:
    """Where the goal was seen."""

    time: float  # stamp [s]
    position: Array  # in the world frame, shape (n,) [m]
    attitude: Array | None = None  # shape (n, n); None where it has none in the plane

    def __post_init__(self) -> None:
        self.position.setflags(write=False)


class GoalMotion(Protocol):
    """Where a goal will be: a forecast, or the trajectory that somebody else has published."""

    def at(self, times: Array) -> Array:
        """Return the positions at ``times``, shape (N,) [s], as shape (N, n) [m]."""


class Forecast(GoalMotion, Protocol):
    """Predicts a goal from its sightings."""

    def observe(self, sighting: GoalObservation) -> None:
        """Take in a sighting; sightings come in order of time."""

    def reset(self) -> None:
        """Forget every sighting."""


@dataclass(frozen=True)
class GoalTrajectory:
    """A forecast that somebody else made: stamped future positions, interpolated in between."""

    times: Array  # increasing stamps, shape (M,) [s]
    positions: Array  # shape (M, n) [m]
    attitude: Array | None = None  # at the last of them, shape (n, n); None where it has none

    def __post_init__(self) -> None:
        if len(self.times) == 0 or np.any(np.diff(self.times) <= 0.0):
            raise BadInput('goal_path stamps', self.times.tolist(), 'one or more, increasing')
        sealed(self.times)
        sealed(self.positions)

    def at(self, times: Array) -> Array:
        """Return the positions at ``times``, shape (N, n); the ends are held beyond the ends."""
        return np.column_stack(
            [np.interp(times, self.times, column) for column in self.positions.T]
        )
