# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Forecasts of a moving goal from its observations: the targets g_1..g_N of a plan.

Mathematics: docs/mathematics.md, 7.4.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from orbimpc_ros.loop.goal.bank import Bank
from orbimpc_ros.loop.goal.harmonic import Harmonic
from orbimpc_ros.loop.goal.motion import Forecast, GoalObservation
from orbimpc_ros.mpc.arrays import Array


class Velocity:
    """The goal goes on in the straight line that fits its latest sightings best."""

    LATEST = 3  # sightings

    def __init__(self) -> None:
        self._latest: deque[GoalObservation] = deque(maxlen=self.LATEST)

    def observe(self, sighting: GoalObservation) -> None:
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


class Hold(Velocity):
    """The paper's forecast: the goal stays where it was seen last."""

    LATEST = 1


FORECASTS: dict[str, Callable[[], Forecast]] = {
    'hold': Hold,
    'velocity': Velocity,
    'harmonic': Harmonic,
    'auto': Bank,
}
