# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A test for changes of course: whether the latest sightings are better told as a new motion."""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.loop.goals.families import PLACE, SPEED
from orbimpc_ros.mpc.loop.goals.fits import Noise, data_evidence

# Sightings of a new motion: even, for of older sightings every other one was weighed.
LENGTHS = np.array([4, 6, 8, 10, 12, 16, 20, 26, 34, 42, 50])
TIE = 4.0  # lengths whose evidence is that close are as likely; the longest tells most
RARE = -5.0  # logarithm of the prior odds that the goal changes its course at a sighting


class Changes:
    """Compares one motion from the beginning with another one, still or straight, since lately.

    Args:
        n: dimension.
    """

    def __init__(self, n: int) -> None:
        self._n = n
        self._sums = np.zeros((LENGTHS[-1] + 1, 3 + 2 * n))  # up to and with each sighting
        self._evidence = np.full(LENGTHS[-1] + 1, -np.inf)
        self._noise = np.ones((LENGTHS[-1] + 1, 2))
        self._count = 0

    def note(self, time: float, position: Array) -> None:
        """Note a sighting."""
        n, last = self._n, self._count % len(self._sums)
        self._count += 1
        new = self._count % len(self._sums)
        sums = self._sums[new]
        sums[0], sums[1], sums[2] = time, time * time, float(position @ position)
        sums[3 : 3 + n], sums[3 + n :] = position, time * position
        sums += self._sums[last]

    def weigh(self, evidence: float, noise: Noise) -> None:
        """Note the evidence of one motion through all sightings so far, and what noise it has."""
        now = self._count % len(self._evidence)
        self._evidence[now], self._noise[now] = evidence, noise

    def noise(self, new: int) -> Noise:
        """Return what was known of the noise before the ``new`` latest sightings."""
        return Noise(*map(float, self._noise[(self._count - new) % len(self._noise)]))

    def found(self) -> int:
        """Return how many sightings a new motion has, if one is likely; otherwise 0."""
        usable = int(np.searchsorted(LENGTHS, self._count - LENGTHS[0], side='right'))
        if not usable:
            return 0
        now, size = self._count, len(self._sums)
        before = (now - LENGTHS[:usable]) % size
        gain = self._evidence[before] + self._straight(before)
        if gain.max() + RARE <= self._evidence[now % size]:
            return 0
        return int(LENGTHS[np.flatnonzero(gain > gain.max() - TIE)[-1]])

    def _straight(self, before: np.ndarray) -> Array:
        """Return the evidence of a still or straight motion after each of ``before``."""
        n, count = self._n, LENGTHS[: len(before)].astype(float)
        share, scale = self._noise[before].T
        variance = scale / share
        sums = (self._sums[self._count % len(self._sums)] - self._sums[before]).T
        time, lever, square = sums[:3]
        place, moment = sums[3 : 3 + n], sums[3 + n :]
        lever = np.maximum(lever - time * time / count, 0.0) + variance / SPEED**2
        slope = moment - time * place / count
        misfit = np.empty((2, len(before)))
        misfit[0] = square - (place * place).sum(axis=0) / count
        misfit[1] = misfit[0] - (slope * slope).sum(axis=0) / lever
        found = data_evidence(np.maximum(misfit, 0.0), float(n) * count, share, scale)
        found += 0.5 * n * np.log(variance / (PLACE**2 * count))
        found[1] += 0.5 * n * np.log(variance / (SPEED**2 * lever))
        return np.asarray(np.logaddexp(found[0], found[1]))
