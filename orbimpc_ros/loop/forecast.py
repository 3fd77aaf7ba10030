# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Forecasts of a moving goal from its observations: the targets g_1..g_N of a plan.

Mathematics: docs/mathematics.md, 7.4.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from orbimpc_ros.loop.goals.bank import Bank
from orbimpc_ros.loop.harmonic import Harmonic
from orbimpc_ros.loop.observation import Sighting
from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.errors import BadInput

LATEST = 3  # sightings that a velocity is fitted to


class Forecast(Protocol):
    """Predicts a goal from its sightings."""

    def observe(self, sighting: Sighting) -> None:
        """Take in a sighting; sightings come in order of time."""

    def at(self, times: Array) -> Array:
        """Return where the goal will be at ``times``, shape (N,) [s], as shape (N, n) [m]."""

    def reset(self) -> None:
        """Forget every sighting."""


@dataclass
class Hold:
    """The paper's forecast: the goal stays where it was seen last."""

    last: Sighting | None = field(default=None, init=False)

    def observe(self, sighting: Sighting) -> None:
        """Take in a sighting."""
        self.last = sighting

    def at(self, times: Array) -> Array:
        """Return the last position seen, once for each of ``times`` [s], shape (N, n) [m]."""
        assert self.last is not None
        return np.tile(self.last.position, (len(times), 1))

    def reset(self) -> None:
        """Forget every sighting."""
        self.last = None


@dataclass
class Velocity:
    """The goal goes on in the straight line that fits its latest sightings best."""

    _latest: deque[Sighting] = field(default_factory=lambda: deque(maxlen=LATEST), init=False)

    def observe(self, sighting: Sighting) -> None:
        """Take in a sighting."""
        self._latest.append(sighting)

    def at(self, times: Array) -> Array:
        """Return points on the line at ``times`` [s], shape (N, n) [m]; the last if it is alone."""
        seen = np.array([s.position for s in self._latest])
        stamps = np.array([s.time for s in self._latest])
        if len(seen) < 2 or stamps[-1] == stamps[0]:
            return np.tile(seen[-1], (len(times), 1))
        past = stamps - stamps.mean()
        slope = past @ seen / (past @ past)
        return seen.mean(axis=0) + np.outer(times - stamps.mean(), slope)

    def reset(self) -> None:
        """Forget every sighting."""
        self._latest.clear()


FORECASTS: dict[str, type[Forecast]] = {
    'hold': Hold,
    'velocity': Velocity,
    'harmonic': Harmonic,
    'auto': Bank,
}


def forecast_named(kind: str) -> Forecast:
    """Return a fresh forecast of a kind.

    Raises:
        BadInput: no such kind.
    """
    if kind not in FORECASTS:
        raise BadInput.choice('goal_prediction', kind, FORECASTS)
    return FORECASTS[kind]()


@dataclass(frozen=True)
class Itinerary:
    """A forecast that somebody else made: stamped future positions, interpolated in between.

    Attributes:
        times: increasing stamps, shape (M,) [s].
        positions: shape (M, n) [m].
        attitude: of the goal at the last of them, shape (n, n); None where it has none.
    """

    times: Array
    positions: Array
    attitude: Array | None = None

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
