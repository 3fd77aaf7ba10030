# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Forecasts of a moving goal from its observations: the targets g_1..g_N of a plan.

The forecast ``auto`` fits a bank of motions to the goal and weights them by evidence. Work is
distributed to bound the cost of each sighting: of two, the first is gated and added to the sums,
and pays for two tasks that improve oscillations; with the second, all families are refitted, and
the goal is tested for a change of course.

Mathematics: docs/mathematics.md, 7.4.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import partial

import numpy as np

from orbimpc_ros.loop.goal.fits import (
    ACCELERATION,
    CARRIER,
    COSINE,
    DAMPED,
    DRIFTING,
    FIXED,
    LINEAR,
    MEMORY,
    NAMES,
    ONE,
    OSCILLATING,
    SINE,
    SWING,
    TINY,
    TURN,
    UNKNOWN,
    Fits,
    Noise,
    Past,
    Placement,
    arc,
    best_swing,
    circle,
    columns,
    evidence_anew,
)
from orbimpc_ros.loop.goal.motion import Forecast, GoalObservation, slope
from orbimpc_ros.mpc.arrays import Array

# Sightings of a new motion: even, because only every other older one was weighed.
LENGTHS = np.array([2, 4, 6, 8, 10, 12, 16, 20, 26, 34, 42, 50])
TIE = 4.0  # lengths with evidence this close count as equal; the longest is chosen
RARE = -5.0  # logarithm of the prior odds of a change of course at a sighting
KEPT = 512  # sightings, when the memory is full
BELIEVED = 3  # consecutive outliers that start a new motion
GATE = 6.0  # standard deviations beyond which a sighting is an outlier
AGILE = 5.0  # [m/s^2] unpredicted acceleration that a goal may have
LOST = 60.0  # [s] gap between sightings after which a motion starts anew
SWINGS_FROM = 6  # sightings
YOUNG = 16  # sightings up to which each is fully processed, later every other one
LIKELY, NEGLIGIBLE = 1e-2, 1e-4  # shares
BENDING = [ONE, LINEAR, COSINE, SINE]  # columns of oscillations
BETTER, WORSE = 0.9, 1.02  # ratios of misfits at which a family is restarted from another
PATIENCE, MOST_TASKS = 0.4, 6  # [s] of waiting per additional task, and their largest number
STEPS = 4  # Gauss-Newton steps of a closer analysis
SPEED_OVER = 0.5  # [s]
WORTHWHILE = 0.01  # least gain of a step, in units of the noise


class Bank:
    """Predicts a goal from its sightings by all families of motion at once."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._apart: list[tuple[float, Array]] = []  # consecutive outliers so far
        self._lately: list[tuple[float, Array]] = []
        self._fastest = 0.0  # highest observed speed [m/s]

    def observe(self, sighting: GoalObservation) -> None:
        """Take in a sighting; ignore it unless it is newer than the last."""
        time, position, last = sighting.time, sighting.position, self._last
        if last is not None and time <= last:
            return
        if last is None or time - last > LOST:
            self._begin(np.array([time]), position[None])
        else:
            self._learn(time, position, time - last)
        self._last = time

    @property
    def model(self) -> str:
        """Return the name of the likeliest motion; empty before the first sighting."""
        return '' if self._last is None else NAMES[int(np.argmax(self._shares))]

    def at(self, times: Array) -> Array:
        """Return the predicted positions at ``times``, shape (N,) [s], as shape (N, n) [m].

        They are the mean of the families weighted by their shares. The distance of each from its
        own position at the last sighting is limited by the highest speed observed.
        """
        assert self._last is not None
        used, fits = np.flatnonzero(self._shares > NEGLIGIBLE), self._fits
        shares, fitted = self._shares[used] / self._shares[used].sum(), self._fitted[used]
        now = fits.rows(np.array([self._last - self._epoch]))[used] @ fitted
        places = fits.rows(times - self._epoch)[used] @ fitted
        moved, reach = places - now, self._fastest * np.maximum(times - self._last, 0.0)
        size = np.linalg.norm(moved, axis=2)
        share = np.where(size > reach, reach / np.maximum(size, TINY), 1.0)
        share[:, times <= self._last] = 1.0
        mean = shares @ (now + share[..., None] * moved).reshape(len(shares), -1)
        return np.asarray(mean.reshape(len(times), -1) + self._origin)

    def _note_speed(self, time: float, position: Array) -> None:
        """Record the goal's recent speed, over half a second or the last two sightings."""
        self._lately.append((time, position))
        while len(self._lately) > 2 and time - self._lately[1][0] >= SPEED_OVER:
            self._lately.pop(0)
        begun, place = self._lately[0]
        if time > begun:
            self._fastest = max(self._fastest, math.dist(position, place) / (time - begun))

    # --- taking in

    def _learn(self, time: float, position: Array, waited: float) -> None:
        if not self._expected(time, position, waited):
            self._doubt(time, position)
            return
        self._apart = []
        self._add(time, position)
        self._work(waited)
        if self._fits.count == MEMORY:
            self._shorten()

    def _add(self, time: float, position: Array) -> None:
        self._note_speed(time, position)
        self._fits.add(np.array([time - self._epoch]), position[None] - self._origin)

    def _doubt(self, time: float, position: Array) -> None:
        """Set an outlier aside; with some more it starts a new motion."""
        self._apart.append((time, position))
        if len(self._apart) == BELIEVED:
            times, seen = zip(*self._apart, strict=True)
            self._begin(np.array(times), np.array(seen), self._fits.noise())

    def _work(self, waited: float) -> None:
        """Do the work of a sighting: one of two tasks, or both after a wait [s]."""
        at_leisure, odd = self._fits.count < YOUNG or waited > PATIENCE, self._fits.count % 2
        if at_leisure or not odd:
            for _ in range(min(int(waited / PATIENCE), MOST_TASKS) + (1 if at_leisure else 2)):
                self._refine()
        if at_leisure or odd:
            self._conclude()
            if self._changed():
                self._reconsider()

    def _expected(self, time: float, position: Array, waited: float) -> bool:
        """Return True if any motion with a considerable share predicts the goal near there."""
        rows = self._fits.rows(np.array([time - self._epoch]))[:, 0]
        off = (rows[:, None, :] @ self._fitted)[:, 0] - (position - self._origin)
        spread = self._fits.noises * (1.0 + self._fits.spread(rows))
        allowed = GATE**2 * (spread + (0.5 * AGILE * waited * waited) ** 2)
        near = np.sum(off * off, axis=1) <= allowed
        return bool(np.any(near & (self._shares > LIKELY)))

    def _begin(self, times: Array, seen: Array, noise: Noise = UNKNOWN) -> None:
        """Start anew with the first sightings of a motion: times, (M,), and positions, (M, n)."""
        self._start_from(float(times[0]), seen[0].copy(), noise)
        for time, position in zip(times.tolist(), seen, strict=True):
            self._add(time, position)
            self._conclude()

    def _start_from(self, epoch: float, origin: Array, noise: Noise) -> None:
        """Forget all sightings; later ones are relative to a time [s] and a position, (n,)."""
        self._epoch, self._origin = epoch, origin
        # Of one motion through all sightings up to each, and its noise.
        self._evidence, self._noises = np.full(MEMORY + 1, -np.inf), np.ones((MEMORY + 1, 2))
        self._fits = Fits(len(origin), noise)
        self._tasks, self._searched, self._apart = 0, 0, []

    def _conclude(self) -> None:
        """Fit the families and compute their shares."""
        self._fits.solve()
        best = self._fits.evidence.max()
        shares = np.exp(self._fits.evidence - best)
        total = shares.sum()
        self._shares = shares / total
        self._evidence[self._fits.count] = best + math.log(total)
        self._noises[self._fits.count] = self._fits.noise()
        self._fitted: Array = self._fits.fitted

    def _changed(self) -> int:
        """Return the number of sightings of a new motion, if one is likely; otherwise 0."""
        count = self._fits.count
        lengths = LENGTHS[count > LENGTHS]
        if not len(lengths):
            return 0
        before = count - lengths
        gain = self._evidence[before]
        gain = gain + evidence_anew(self._fits.past, lengths, self._noises[before])
        if gain.max() + RARE <= self._evidence[count]:
            return 0
        return int(lengths[np.flatnonzero(gain > gain.max() - TIE)[-1]])

    def _reconsider(self) -> None:
        """Start anew with a new motion, unless an oscillation explains it on closer analysis."""
        fits = self._fits
        if fits.count >= SWINGS_FROM:
            self._look_closely()
        new = self._changed()
        if new:
            times, seen = fits.past
            begun = times[-new:] + self._epoch, seen[-new:] + self._origin
            self._begin(*begun, Noise(*map(float, self._noises[fits.count - new])))

    def _shorten(self) -> None:
        """Drop the oldest sightings, but keep the present estimates."""
        before = self._fits
        times, seen = (each[-KEPT:] for each in before.past)
        ways = before.rows(times) @ self._fitted
        self._start_from(self._epoch + times[0], self._origin + seen[0], before.prior)
        self._fits.add(times - times[0], seen - seen[0])
        for family in np.flatnonzero(before.rates).tolist():
            rate, damping = before.rates[family], before.dampings[family]
            x = columns(times - times[0], rate, damping)[:, BENDING]
            coefficients = np.zeros_like(before.coefficients[family])
            coefficients[BENDING] = np.linalg.lstsq(x, ways[family] - seen[0], rcond=None)[0]
            moved = bool(before.weighed[family])
            self._fits.place(Placement(family, rate, damping, coefficients, moved))
        self._conclude()

    # --- tasks

    def _refine(self) -> None:
        """Improve one oscillation, or search for others: one task at a time, to bound the cost."""
        if self._fits.count < SWINGS_FROM:
            return
        self._tasks += 1
        swing, carrier = partial(self._seek, SWING, FIXED), partial(self._seek, CARRIER, DRIFTING)
        search = self._begin_search, swing, carrier, self._seek_damped, self._seek_turn
        if self._tasks % 2:
            search[self._tasks // 2 % len(search)]()
        else:
            self._move()

    def _look_closely(self) -> None:
        """Do all tasks at once that are otherwise spread over many sightings."""
        fits = self._fits
        self._begin_search()
        self._seek(SWING, FIXED)
        self._seek(CARRIER, DRIFTING)
        for _ in range(STEPS):
            self._conclude()
            for family in OSCILLATING:
                if fits.gain[family] > WORTHWHILE:
                    fits.place(fits.moved(family))
            self._seek_damped()
            self._seek_turn()
        self._conclude()

    def _move(self) -> None:
        """Step the next oscillation whose fit would gain by it, new placements first."""
        turn, fits = self._tasks // 2 % len(OSCILLATING), self._fits
        raw = [each for each in OSCILLATING if fits.rates[each] and not fits.weighed[each]]
        for family in (*raw, *OSCILLATING[turn:], *OSCILLATING[:turn]):
            if fits.gain[family] > WORTHWHILE:
                fits.waiting.append(fits.moved(family))
                return

    def _begin_search(self) -> None:
        """Choose the sightings in which swings are sought: all so far."""
        self._searched = self._fits.count

    def _seek(self, family: int, middle: int) -> None:
        """Place a family at the frequency of the best swing, if that fits better."""
        if self._searched < SWINGS_FROM:
            return
        fits = self._fits
        times, seen = (each[: self._searched] for each in fits.past)
        rate, misfit = best_swing((times, seen), middle)
        if not fits.rates[family] or misfit < BETTER * fits.misfit[family]:
            still = np.zeros_like(fits.coefficients[family])
            fits.waiting.append(Placement(family, rate, 0.0, still))

    def _seek_damped(self) -> None:
        """Restart the damped swing from the swing, if that fits better."""
        fits = self._fits
        self._restart(DAMPED, SWING, fits.rates[SWING], fits.coefficients[SWING])

    def _seek_turn(self) -> None:
        """Restart the turn from the acceleration, or later from the swing, if that fits better."""
        fits = self._fits
        middle = 0.5 * fits.past[0][-1]
        bend = arc(self._fitted[ACCELERATION], middle)
        if bend and middle * bend[0] < 1.0:
            self._restart(TURN, ACCELERATION, *bend)
        else:
            self._restart(TURN, SWING, fits.rates[SWING], circle(fits.coefficients[SWING]))

    def _restart(self, family: int, other: int, rate: float, coefficients: Array) -> None:
        """Place a family where another one is found to oscillate, if that fits better."""
        fits = self._fits
        worse = not fits.rates[family] or fits.misfit[family] > WORSE * fits.misfit[other]
        if worse and coefficients[COSINE].any():
            fits.waiting.append(Placement(family, rate, 0.0, coefficients))


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
