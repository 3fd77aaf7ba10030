"""The frequencies that a stretch of sightings may hold, searched on a grid kept as sums."""

from __future__ import annotations

import math

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.loop.goals.families import NOISE, SIZE

# [rad/s]; below, by ratios; above, apart by what twenty seconds tell from one another
GRID = 2.0 * math.pi * np.concatenate([np.geomspace(0.01, 0.15, 24), np.arange(0.165, 2.0, 0.016)])
NYQUIST = 0.45  # cycles a sighting that still count as resolved


class Spectrum:
    """How well a swing of each frequency on the grid fits.

    Args:
        n: dimension.
    """

    def __init__(self, n: int) -> None:
        self._swings = np.zeros((len(GRID), 2, 2))
        self._cross = np.zeros((len(GRID), 2, 2))
        self._moments = np.zeros((len(GRID), 2, n))
        self._line, self._line_moments = np.zeros((2, 2)), np.zeros((2, n))
        self._square = 0.0

    def add(self, times: Array, positions: Array) -> None:
        """Add sightings at ``times``, shape (M,) [s], of ``positions``, shape (M, n) [m]."""
        phase = GRID[:, None] * times
        swing = np.stack([np.cos(phase), np.sin(phase)], axis=1)
        line = np.stack([np.ones_like(times), times], axis=1)
        self._swings += swing @ swing.transpose(0, 2, 1)
        self._cross += swing @ line
        self._moments += swing @ positions
        self._line += line.T @ line
        self._line_moments += line.T @ positions
        self._square += float(np.sum(positions * positions))

    def best(self, drifting: bool) -> tuple[float, float]:
        """Return the best angular frequency [rad/s] and its misfit [m^2].

        Args:
            drifting: whether the middle of the swing moves on.
        """
        size = 2 if drifting else 1
        base = np.linalg.inv(self._line[:size, :size] + 1e-9 * np.eye(size))
        cross, known = self._cross[:, :, :size], self._line_moments[:size]
        projected = cross @ base
        swings = self._swings - projected @ cross.transpose(0, 2, 1)
        moments = self._moments - projected @ known
        one, two = moments[:, 0], moments[:, 1]
        prior = (NOISE / SIZE) ** 2
        p, q, r = swings[:, 0, 0] + prior, swings[:, 1, 1] + prior, swings[:, 0, 1]
        explained = (
            q * np.sum(one * one, axis=1)
            + p * np.sum(two * two, axis=1)
            - 2.0 * r * np.sum(one * two, axis=1)
        ) / (p * q - r * r)
        count, span = self._line[0, 0], self._line[1, 1]
        duration = math.sqrt(3.0 * span / count)  # of evenly spread times from 0
        explained[GRID * duration > 2.0 * math.pi * NYQUIST * count] = -np.inf
        found = int(np.argmax(explained))
        rest = self._square - float(np.sum(known * (base @ known)))
        return float(GRID[found]), rest - float(explained[found])
