"""A test for changes of course: whether the latest sightings are better told as a new motion."""

from __future__ import annotations

import math

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.loop.goals.families import NOISE, PLACE, SPEED
from orbimpc_ros.mpc.loop.goals.fits import data_evidence

LENGTHS = np.array([3, 4, 5, 6, 8, 10, 13, 17, 22, 29, 38, 50])  # sightings of a new motion
RARE = -8.0  # logarithm of the prior odds that the goal changes its course at a sighting


class Changes:
    """Compares one motion from the beginning with another one, still or straight, since lately.

    Args:
        n: dimension.
    """

    def __init__(self, n: int) -> None:
        self._n = n
        self._sums = np.zeros((LENGTHS[-1] + 1, 4 + 2 * n))  # up to and with each sighting
        self._evidence = np.full(LENGTHS[-1] + 1, -np.inf)
        self._count = 0

    def note(self, time: float, position: Array, evidence: float) -> None:
        """Note a sighting, and the evidence of one motion through all sightings with it."""
        n, last = self._n, self._count % len(self._sums)
        self._count += 1
        new = self._count % len(self._sums)
        sums = self._sums[new]
        sums[0], sums[1], sums[2], sums[3] = 1.0, time, time * time, float(position @ position)
        sums[4 : 4 + n], sums[4 + n :] = position, time * position
        sums += self._sums[last]
        self._evidence[new] = evidence

    def found(self) -> int:
        """Return how many sightings a new motion has, if one is likely; otherwise 0."""
        lengths = LENGTHS[self._count - 3 >= LENGTHS]
        if not len(lengths):
            return 0
        now, size = self._count, len(self._sums)
        before = (now - lengths) % size
        gain = self._evidence[before] + self._straight(before) + RARE - self._evidence[now % size]
        best = int(np.argmax(gain))
        return int(lengths[best]) if gain[best] > 0.0 else 0

    def _straight(self, before: Array) -> Array:
        """Return the evidence of a still or straight motion after each of ``before``."""
        n = self._n
        sums = self._sums[self._count % len(self._sums)] - self._sums[before]
        count, time, square = sums[:, 0], sums[:, 1], sums[:, 3]
        place, moment = sums[:, 4 : 4 + n], sums[:, 4 + n :]
        still = np.maximum(square - np.sum(place * place, axis=1) / count, 0.0)
        lever = np.maximum(sums[:, 2] - time * time / count, 0.0) + (NOISE / SPEED) ** 2
        slope = moment - time[:, None] * place / count[:, None]
        straight = np.maximum(still - np.sum(slope * slope, axis=1) / lever, 0.0)
        base = -0.5 * n * np.log(count) + n * math.log(NOISE / PLACE)
        turn = -0.5 * n * np.log(lever) + n * math.log(NOISE / SPEED)
        numbers = n * count
        return base + np.logaddexp(
            data_evidence(still, numbers), turn + data_evidence(straight, numbers)
        )
