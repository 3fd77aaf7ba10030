# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A test for changes of course: whether the latest sightings are better told as a new motion."""

from __future__ import annotations

import numpy as np

from orbimpc_ros.loop.goals.families import PLACE, SPEED, THRUST
from orbimpc_ros.loop.goals.fits import Noise, data_evidence
from orbimpc_ros.mpc.arrays import Array

# Sightings of a new motion: even, for of older sightings every other one was weighed.
LENGTHS = np.array([2, 4, 6, 8, 10, 12, 16, 20, 26, 34, 42, 50])
TIE = 4.0  # lengths whose evidence is that close are as likely; the longest tells most
RARE = -5.0  # logarithm of the prior odds that the goal changes its course at a sighting
WIDTHS = np.array([PLACE, SPEED, THRUST])  # prior standard deviations of a new motion
ODDS = np.array([0.0, 0.0, -3.0])  # logarithms: still, straight, bent


class Changes:
    """Compares one motion from the beginning with another, still, straight or bent, since lately.

    Args:
        n: dimension.
    """

    def __init__(self, n: int) -> None:
        self._n = n
        self._times = np.zeros(LENGTHS[-1] + 1)
        self._seen = np.zeros((LENGTHS[-1] + 1, n))
        self._evidence = np.full(LENGTHS[-1] + 1, -np.inf)
        self._noise = np.ones((LENGTHS[-1] + 1, 2))
        self._count = 0

    def note(self, time: float, position: Array) -> None:
        """Note a sighting."""
        self._count += 1
        new = self._count % len(self._times)
        self._times[new], self._seen[new] = time, position

    def weigh(self, evidence: float, noise: Noise) -> None:
        """Note the evidence of one motion through all sightings so far, and what noise it has."""
        now = self._count % len(self._evidence)
        self._evidence[now], self._noise[now] = evidence, noise

    def noise(self, new: int) -> Noise:
        """Return what was known of the noise before the ``new`` latest sightings."""
        return Noise(*map(float, self._noise[(self._count - new) % len(self._noise)]))

    def found(self) -> int:
        """Return how many sightings a new motion has, if one is likely; otherwise 0."""
        usable = int(np.searchsorted(LENGTHS, self._count - 1, side='right'))
        if not usable:
            return 0
        now, size = self._count, len(self._evidence)
        before = (now - LENGTHS[:usable]) % size
        gain = self._evidence[before] + self._anew(before)
        if gain.max() + RARE <= self._evidence[now % size]:
            return 0
        return int(LENGTHS[np.flatnonzero(gain > gain.max() - TIE)[-1]])

    def _anew(self, before: np.ndarray) -> Array:
        """Return the evidence of a still, straight or bent motion after each of ``before``.

        One factor holds the fits of all three, for the columns of each are the first of the next.
        """
        n, lengths = self._n, LENGTHS[: len(before)]
        share, scale = self._noise[before].T
        variance = scale / share
        latest = (self._count - np.arange(lengths[-1])) % len(self._times)
        rows = (self._times[latest] - self._times[latest[0]])[:, None] ** np.arange(3.0)
        seen = self._seen[latest] - self._seen[latest[0]]
        gram = np.cumsum(rows[:, :, None] * rows[:, None, :], axis=0)[lengths - 1]
        moments = np.cumsum(rows[:, :, None] * seen[:, None, :], axis=0)[lengths - 1]
        square = np.cumsum(np.sum(seen * seen, axis=1))[lengths - 1]
        prior = variance[:, None] / WIDTHS**2
        gram[:, range(1, 3), range(1, 3)] += prior[:, 1:]
        factor = np.linalg.cholesky(gram)
        white = np.linalg.solve(factor, moments)
        explained = np.cumsum(np.sum(white * white, axis=2), axis=1)
        spread = np.log(prior) - 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2))
        found = data_evidence(
            np.maximum(square[:, None] - explained, 0.0),
            float(n) * lengths[:, None],
            share[:, None],
            scale[:, None],
        )
        found += 0.5 * n * np.cumsum(spread, axis=1) + ODDS
        return np.asarray(np.logaddexp.reduce(found, axis=1))
