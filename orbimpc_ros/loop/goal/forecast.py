# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Forecasts of a moving goal from its observations: the targets g_1..g_N of a plan.

Mathematics: docs/mathematics.md, 7.4.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from orbimpc_ros.loop.goal.bank import COSINE, ONE, SINE, Bank, Past, columns
from orbimpc_ros.loop.goal.motion import Forecast, GoalObservation, slope
from orbimpc_ros.mpc.arrays import Array

LOWEST, HIGHEST = 0.01, 2.0  # frequencies considered [Hz], the highest subject to Nyquist
COARSE, FINE, ZOOMS = 40, 8, 3  # frequencies on the first grid, on a refinement, refinements
NOISES = (1e-3, 1e-2, 3e-2, 1e-1)  # standard deviations considered [m]
SWINGS = (0.3, 1.0)  # prior standard deviations of a and b considered [m]
SWUNG = [ONE, COSINE, SINE]  # columns
DRIFT = 10.0  # prior standard deviation of c about the last sighting [m]


class Velocity:
    """Extrapolates the goal along the straight line fitted to its latest sightings."""

    LATEST = 3  # sightings

    def __init__(self) -> None:
        self._latest: deque[GoalObservation] = deque(maxlen=self.LATEST)

    def observe(self, sighting: GoalObservation) -> None:
        """Take in a sighting."""
        self._latest.append(sighting)

    def _past(self) -> Past:
        stamps, seen = zip(*((each.time, each.position) for each in self._latest), strict=True)
        return np.array(stamps), np.array(seen)

    def at(self, times: Array) -> Array:
        """Return the line at ``times`` [s], shape (N, n) [m]; the position if there is only one."""
        stamps, seen = self._past()
        if stamps[-1] == stamps[0]:
            return np.tile(seen[-1], (len(times), 1))
        return seen.mean(axis=0) + np.outer(times - stamps.mean(), slope(stamps, seen))


class Hold(Velocity):
    """The paper's forecast: the goal stays at its last observed position."""

    LATEST = 1


class Harmonic(Velocity):
    r"""The goal swings: a harmonic oscillation with unknown parameters.

    The model is :math:`g(t) = c + a \cos\omega t + b \sin\omega t + \varepsilon`, one frequency for
    all axes, with Gaussian priors on c, a and b. For a given frequency, noise and size of swing it
    is linear, so evidence and prediction have closed forms; the forecast is the average of the
    predictions over a grid of those three, weighted by evidence. The grid of frequencies is refined
    around its best point: the longer the observation, the more precise the frequency.

    Before that it degrades gracefully: it holds the goal after one sighting, and extrapolates its
    motion after a few, the more cautiously the more noise there is.
    """

    LATEST = 64

    def at(self, times: Array) -> Array:
        """Return the predicted positions at ``times``, shape (N,) [s], as shape (N, n) [m].

        Predictions are averaged by evidence over log(frequency).
        """
        stamps, places = self._past()
        now, last = stamps[-1], places[-1]
        past, seen = stamps - now, places - last
        grid = _first_grid(past)
        evidence, predicted = _fit(grid, past, seen, times - now)
        for _ in range(ZOOMS):
            best = int(np.argmax(evidence))
            low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
            finer = np.geomspace(low, high, FINE + 2)[1:-1]
            more = _fit(finer, past, seen, times - now)
            order = np.argsort(np.concatenate([grid, finer]))
            grid = np.concatenate([grid, finer])[order]
            evidence = np.concatenate([evidence, more[0]])[order]
            predicted = np.concatenate([predicted, more[1]])[order]
        weights = np.exp(evidence - evidence.max()) * np.gradient(np.log(grid))
        return np.asarray(last + np.tensordot(weights / weights.sum(), predicted, axes=1))


def _first_grid(past: Array) -> Array:
    """Return frequencies from the lowest to the highest resolved by the sightings."""
    gaps = np.diff(past)
    spacing = float(np.median(gaps[gaps > 0.0])) if np.any(gaps > 0.0) else 1.0
    return np.geomspace(LOWEST, min(HIGHEST, max(0.45 / spacing, 2 * LOWEST)), COARSE)


def _fit(frequencies: Array, past: Array, seen: Array, ahead: Array) -> tuple[Array, Array]:
    """Fit the model at each frequency to positions ``seen``, shape (M, n), at times ``past``.

    Returns logarithms of the evidence, shape (F,), and positions ``ahead``, shape (F, N, n) [m],
    averaged over noises and sizes of swing.

    Bayesian linear regression with known noise: with the Gram matrix G, the prior precisions
    relative to the noise L and S = G + L, the coefficients are S^-1 X'y and, up to a constant,
    -2 log evidence = M n log s^2 + n (log det S - log det L) + (y'y - y'X S^-1 X'y) / s^2.
    """
    count, n = seen.shape
    rates = 2.0 * np.pi * frequencies[:, None]
    x, x_ahead = (columns(each, rates, 0.0)[..., SWUNG] for each in (past, ahead))
    gram, moments = np.swapaxes(x, 1, 2) @ x, np.swapaxes(x, 1, 2) @ seen
    noise, swing = (grid.ravel() for grid in np.meshgrid(NOISES, SWINGS))
    prior = noise[:, None] ** 2 / np.column_stack([np.full_like(swing, DRIFT), swing, swing]) ** 2
    precision = gram[:, None] + prior[:, :, None] * np.eye(3)
    coefficients = np.linalg.solve(precision, np.repeat(moments[:, None], len(noise), axis=1))
    explained = np.sum(moments[:, None] * coefficients, axis=(2, 3))
    spread = np.linalg.slogdet(precision)[1] - np.log(prior).sum(axis=1)
    misfit = (np.sum(seen**2) - explained) / noise**2
    evidence = -0.5 * (2 * count * n * np.log(noise) + n * spread + misfit)
    share = np.exp(evidence - evidence.max(axis=1, keepdims=True))
    total = share.sum(axis=1)
    average = np.einsum('fk,fkcn->fcn', share / total[:, None], coefficients)
    return evidence.max(axis=1) + np.log(total), x_ahead @ average


FORECASTS: dict[str, Callable[[], Forecast]] = {
    'hold': Hold,
    'velocity': Velocity,
    'harmonic': Harmonic,
    'auto': Bank,
}
