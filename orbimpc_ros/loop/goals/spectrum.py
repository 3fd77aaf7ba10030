# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The frequencies that a stretch of sightings may hold, searched on a grid kept as sums."""

from __future__ import annotations

import math

import numpy as np

from orbimpc_ros.loop.goals.families import SIZE
from orbimpc_ros.mpc.arrays import Array

# [rad/s]; below, by ratios; above, apart by what twenty seconds tell from one another
GRID = 2.0 * math.pi * np.concatenate([np.geomspace(0.01, 0.15, 24), np.arange(0.165, 2.0, 0.016)])
NYQUIST = 0.45  # cycles a sighting that still count as resolved
ASSUMED = 0.01  # [m] noise, for the prior of a swing's size
FIXED, DRIFTING = 1, 2  # columns of a line that the middle of a swing follows


class Spectrum:
    """How well a swing of each frequency on the grid fits.

    Args:
        n: dimension.

    Attributes:
        count: sightings that it has.
    """

    def __init__(self, n: int) -> None:
        # Of cosine and sine with 1, t and the positions, and with one another.
        self._cosines, self._sines = np.zeros((2, 2 + n, len(GRID)))
        self._squares, self._products = np.zeros((2, len(GRID)))
        self._line = np.zeros((2, 2 + n))  # of 1 and t with themselves, and with the positions
        self._square = 0.0
        self.count = 0

    def add(self, times: Array, positions: Array) -> None:
        """Add sightings at ``times``, shape (M,) [s], of ``positions``, shape (M, n) [m]."""
        phase = times[:, None] * GRID
        cosines, sines = np.cos(phase), np.sin(phase)
        rows = np.column_stack([np.ones_like(times), times, positions])
        self._cosines += rows.T @ cosines
        self._sines += rows.T @ sines
        self._squares += (cosines * cosines).sum(axis=0)
        self._products += (cosines * sines).sum(axis=0)
        self._line += rows[:, :2].T @ rows
        self._square += float(np.sum(positions * positions))
        self.count += len(times)

    def best(self, middle: int) -> tuple[float, float]:
        """Return the best angular frequency [rad/s] and its misfit [m^2].

        Args:
            middle: what the middle of the swing does, ``FIXED`` or ``DRIFTING``.
        """
        # Against orthonormal columns of the line, what it explains is a sum of squares.
        unit = np.linalg.inv(np.linalg.cholesky(self._line[:middle, :middle]))
        known = unit @ self._line[:middle, 2:]
        explained = self._explained(unit, known)
        span = math.sqrt(3.0 * self._line[1, 1] / self.count)  # of times evenly spread from 0
        explained[GRID * span > 2.0 * math.pi * NYQUIST * self.count] = -np.inf
        found = int(np.argmax(explained))
        return float(GRID[found]), self._square - float(np.sum(known**2) + explained[found])

    def _explained(self, unit: Array, known: Array) -> Array:
        """Return what a swing explains beyond a line, with a prior on its size, (F,) [m^2].

        Args:
            unit: from columns of the line to orthonormal ones, shape (middle, middle).
            known: their products with the positions, shape (middle, n).
        """
        prior, middle = (ASSUMED / SIZE) ** 2, len(unit)
        u, v = unit @ self._cosines[:middle], unit @ self._sines[:middle]
        one, two = self._cosines[2:] - known.T @ u, self._sines[2:] - known.T @ v
        p = self._squares + prior - (u * u).sum(axis=0)
        q = self.count - self._squares + prior - (v * v).sum(axis=0)
        r = self._products - (u * v).sum(axis=0)
        squares = q * (one * one).sum(axis=0) + p * (two * two).sum(axis=0)
        return np.asarray((squares - 2.0 * r * (one * two).sum(axis=0)) / (p * q - r * r))
