# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The goal: a rope that swings and drifts, or stands still where it does neither."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from orbimpc_ros.loop.goal.motion import GoalObservation
from orbimpc_ros.mpc.arrays import Array, frozen, number

FASTEST = 1e3  # [Hz]


@dataclass(frozen=True)
class Rope:
    """A rope at g(t) = center + velocity t + amplitude * sin(2 pi f t + phase), axis by axis.

    Attributes:
        center: shape (n,) [m].
        amplitude: shape (n,) [m].
        frequency: f [Hz].
        phase: shape (n,) [rad].
        velocity: of the middle of the swing, shape (n,) [m/s]; zero if empty.
    """

    center: Array
    amplitude: Array
    frequency: float
    phase: Array
    velocity: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(self.center))
        if not len(self.velocity):
            object.__setattr__(self, 'velocity', np.zeros(n))
        for name in ('center', 'amplitude', 'phase', 'velocity'):
            object.__setattr__(self, name, frozen(getattr(self, name), (n,), f'rope.{name}'))
        number(self.frequency, 'rope.frequency', 0.0, FASTEST)

    def at(self, time: float) -> Array:
        """Return g(t), shape (n,) [m]."""
        angle = 2.0 * np.pi * self.frequency * time + self.phase
        return self.center + self.velocity * time + self.amplitude * np.sin(angle)


def fixed(point: Array) -> Rope:
    """Return a goal that stays at a point, shape (n,) [m]."""
    still = np.zeros(len(point))
    return Rope(point, still, 0.0, still)


class TrueMotion:
    """The forecast that knows the rope: its true future.

    Args:
        rope: whose own time is that of the sightings.
    """

    def __init__(self, rope: Rope) -> None:
        self._rope = rope

    def observe(self, sighting: GoalObservation) -> None:
        """Learn nothing new."""

    def at(self, times: Array) -> Array:
        """Return where the goal will be at ``times``, shape (N,) [s], as shape (N, n) [m]."""
        return np.array([self._rope.at(time) for time in times])

    def reset(self) -> None:
        """Forget nothing."""
