# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""A forecast that fits the goal at hand: a bank of motions, each as likely as its evidence.

Every family of motion is linear in some of the columns

.. math:: 1,\ t,\ t^2,\ C = e^{-\delta t}\cos\omega t,\ S = e^{-\delta t}\sin\omega t,\ tC,\ tS,

whose last two are the directions in which :math:`\omega` and :math:`\delta` move coefficients.
Given these two a fit is a Bayesian regression in closed form; they take Gauss-Newton steps on what
it leaves (variable projection), from the best of a grid. The noise has a gamma prior on its
precision and is integrated out. The goal has changed its course where its last sightings are much
likelier as a motion of their own.

Mathematics: docs/mathematics.md, 7.4.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from orbimpc_ros.loop.goal.motion import GoalObservation
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import skew

COLUMNS, FREE = 7, 5  # the first of which have coefficients of their own
ONE, LINEAR, SQUARE, COSINE, SINE, T_COSINE, T_SINE = range(COLUMNS)
NAMES = ('still', 'velocity', 'acceleration', 'swing', 'carrier', 'damped', 'turn')
STILL, VELOCITY, ACCELERATION, SWING, CARRIER, DAMPED, TURN = range(len(NAMES))
EVERY = np.arange(len(NAMES))
OSCILLATING = EVERY >= SWING  # with a frequency to be found
DIAGONAL = np.arange(FREE)
BASIS = np.zeros((len(NAMES), FREE), dtype=bool)
BASIS[:, ONE] = True
BASIS[[VELOCITY, ACCELERATION, CARRIER], LINEAR] = True
BASIS[ACCELERATION, SQUARE] = True
BASIS[SWING:TURN, COSINE:] = True
ODDS = np.array([-5.0, 0.0, -5.0, -6.0, -7.0, -7.0, -3.0])  # logarithms, before any sighting
PLACE, SPEED, THRUST = 3.0, 5.0, 1.0  # prior deviations [m], [m/s], half an acceleration [m/s^2]
SIZE, PUSH = 5.0, 5.0  # of a swing: its size [m], its acceleration [m/s^2]
PULSE = 1.0  # of angular frequency and damping [1/s]
TINY = 1e-12  # [1/m^2] precision of a place that may be anywhere
SLOWEST, FASTEST, MOST_DAMPED = 0.02, 4.0 * math.pi, 2.0  # [rad/s], [rad/s], [1/s]
SLOW = 2.0 * math.pi * np.geomspace(0.01, 0.15, 16)  # [rad/s] tried, then evenly as resolved
APART = 2.0  # [rad] that neighbours on the grid come apart in the time of a search
NYQUIST = 0.45  # cycles a sighting that still count as resolved

MEMORY, KEPT = 768, 512  # sightings: as many as are remembered, and as survive when they are full
LONG = 20.0  # [s] that the grid is fine enough for
LOOKED_AT = 128  # sightings that a search over the grid takes at most
BENT_FROM, SWINGS_FROM = 5, 6  # sightings
BELIEVED = 3  # sightings off the forecast, one after another, that are a new motion
GATE = 6.0  # standard deviations beyond which a sighting is off the forecast
AGILE = 5.0  # [m/s^2] acceleration that no motion foretells, yet a goal may have
SELDOM, YOUNG = 0.4, 16  # [s], sightings: later and sooner every other one waits for the next
LOST = 60.0  # [s] unseen for longer, a goal may do anything
FAR = 1e7  # [m] what is farther away than that is another goal
LIKELY, NEGLIGIBLE = 1e-2, 1e-4  # shares
BETTER, WORSE = 0.9, 1.02  # ratios of misfits at which a frequency is sought elsewhere
STEPS = 4  # of Gauss-Newton on a closer look
SPEED_OVER = 0.5  # [s]
LENGTHS = np.array([2, 4, 6, 8, 10, 12, 16, 20, 26, 34, 42, 50])  # sightings of a new motion
TIE = 1.0  # lengths whose evidence is that close are as likely; the longest tells most
RARE = -5.0  # logarithm of the prior odds that the goal changes its course at a sighting
NEW_ODDS = np.array([0.0, 0.0, -3.0])  # logarithms: still, straight, bent
_log_gamma = np.frompyfunc(math.lgamma, 1, 1)


class Noise(NamedTuple):
    """What is known of the noise of sightings: a gamma distribution of its precision."""

    share: float | Array  # half as many numbers as hold as much information
    scale: float | Array  # half the sum of their squares [m^2]


UNKNOWN = Noise(1.0, 2e-4)  # 1.4 cm, or ten times less or more
LEAST = 1e-5  # [m^2] variance that is recalled at least
RECALLED = 8.0  # most that an earlier motion's noise counts for


class Fits(NamedTuple):
    """B fits: the leading axis of all."""

    coefficients: Array  # with the step, shape (B, 7, n)
    step: Array  # of angular frequency and damping first, shape (B, K) [1/s]
    misfit: Array  # sum of squares left, with what the priors add, shape (B,) [m^2]
    noise: Array  # variance that sightings seem to have, shape (B,) [m^2]
    evidence: Array  # logarithm, shape (B,)
    inverse: Array  # of the normal equations, shape (B, 5, 5)
    directions: Array  # of what is not linear, beside what is, shape (B, K, 7, n)
    covariance: Array  # of the step, shape (B, K, K)

    def spread(self, rows: Array) -> Array:
        """Return the sum of squares of the spread at ``rows``, (B, 7), per unit of noise, (B,)."""
        n = self.coefficients.shape[2]
        linear = n * np.einsum('bi,bij,bj->b', rows[:, :FREE], self.inverse, rows[:, :FREE])
        moved = np.einsum('bi,bkin->bkn', rows, self.directions)
        return np.asarray(linear + np.einsum('bkn,bkl,bln->b', moved, self.covariance, moved))


def columns(times: Array, rates: Array | float, dampings: Array | float) -> Array:
    """Return the seven columns at ``times``, with a last axis of 7; the arguments broadcast."""
    phase = rates * times
    fading = np.exp(-dampings * times)
    x = np.empty((*phase.shape, COLUMNS))
    x[..., ONE] = 1.0
    x[..., LINEAR] = times
    x[..., SQUARE] = times * times
    x[..., COSINE] = fading * np.cos(phase)
    x[..., SINE] = fading * np.sin(phase)
    x[..., T_COSINE] = times * x[..., COSINE]
    x[..., T_SINE] = times * x[..., SINE]
    return x


class Sums(NamedTuple):
    """What B fits need of their sightings: the leading axis of all."""

    gram: Array  # products of the columns, shape (B, 7, 7)
    moments: Array  # their products with the positions, shape (B, 7, n)
    square: Array  # of the positions, shape (B,) [m^2]
    sightings: Array  # how many, shape (B,)


def summed(rates: Array, dampings: Array, times: Array, seen: Array) -> Sums:
    """Return the sums over sightings at ``times``, shape (M,) [s], ``seen`` at (M, n) [m]."""
    x = columns(times[None], rates[:, None], dampings[:, None])
    turned, every = np.swapaxes(x, 1, 2), np.ones(len(rates))
    return Sums(turned @ x, turned @ seen, np.sum(seen * seen) * every, len(times) * every)


def fitted(family: np.ndarray, rates: Array, sums: Sums, noise: Noise, circle: Array) -> Fits:
    """Fit families, shape (B,), at angular frequencies, shape (B,) [rad/s].

    ``circle`` has the coefficients of cosine and sine about which turns are fitted, shape (2, n).
    """
    gram, moments, square, count = sums
    n, used, turns = moments.shape[2], BASIS[family], family == TURN
    base = np.zeros_like(moments)
    base[turns, COSINE : SINE + 1] = circle
    share, scale = noise
    known = np.broadcast_to(scale / share, family.shape)[:, None]
    width = np.empty(used.shape)
    width[:, ONE], width[:, LINEAR], width[:, SQUARE] = PLACE, SPEED, THRUST
    rates = np.maximum(rates, SLOWEST)
    size = 1.0 / SIZE**2 + (rates / SPEED) ** 2 + (rates**2 / PUSH) ** 2
    width[:, COSINE:] = size[:, None] ** -0.5
    precision = np.where(used, known / width**2, 1.0)
    normal = gram[:, :FREE, :FREE] * (used[:, :, None] & used[:, None, :])
    normal[:, DIAGONAL, DIAGONAL] += precision
    normal[:, ONE, ONE] = gram[:, ONE, ONE] + TINY * known[:, 0]
    inverse = np.linalg.inv(normal)
    left = moments - gram @ base
    square = square - np.sum(base * (moments + left), axis=(1, 2))
    theta = np.zeros_like(moments)
    theta[:, :FREE] = inverse @ (left[:, :FREE] * used[:, :, None])
    square = square - np.sum(theta * left, axis=(1, 2))
    theta += base
    toward, price = _directions(family, theta, known, rates)
    pushed = gram[:, None] @ toward
    toward[:, :, :FREE] -= inverse[:, None] @ (pushed[:, :, :FREE] * used[:, None, :, None])
    flat = toward.reshape(*toward.shape[:2], -1)
    covariance = np.linalg.inv(
        flat @ np.swapaxes(pushed.reshape(flat.shape), 1, 2) + price[:, None] * np.eye(len(price.T))
    )
    slope = flat @ (moments - gram @ theta).reshape(len(family), -1, 1)
    step = (covariance @ slope)[:, :, 0]
    misfit = np.maximum(square - np.sum(step * slope[:, :, 0], axis=1), 0.0)
    spread = n * (np.log(precision).sum(axis=1) + np.linalg.slogdet(inverse)[1])
    spread += np.log(price).sum(axis=1) + np.linalg.slogdet(covariance)[1]
    evidence = 0.5 * spread + _data_evidence(misfit, 0.5 * n * count, noise)
    noises = (scale + 0.5 * misfit) / (share + 0.5 * n * count)
    theta += (step[:, None] @ flat)[:, 0].reshape(theta.shape)
    return Fits(theta, step, misfit, noises, evidence, inverse, toward, covariance)


def _directions(
    family: np.ndarray, theta: Array, known: Array, rates: Array
) -> tuple[Array, Array]:
    """Return where coefficients move that are not free, (B, K, 7, n), and prior precisions, (B, K).

    By angular frequency and damping; of a turn also by its size and its attitude, in metres of the
    rim, so that a circle of no size does not pass for a still goal.
    """
    n = theta.shape[2]
    kinds = np.zeros((len(family), 3 + n * (n - 1) // 2), dtype=bool)
    kinds[:, 0], kinds[:, 1] = OSCILLATING[family], family == DAMPED
    kinds[:, 2:] = (family == TURN)[:, None]
    price = np.where(kinds, known / PULSE**2, 1.0)
    price[:, 2:] = np.where(kinds[:, 2:], known * (rates[:, None] / SPEED) ** 2, 1.0)
    toward = np.zeros((*kinds.shape, COLUMNS, n))
    a, b = theta[:, COSINE], theta[:, SINE]
    toward[:, 0, T_COSINE], toward[:, 0, T_SINE] = b, -a
    toward[:, 1, T_COSINE], toward[:, 1, T_SINE] = -a, -b
    pair = theta[:, COSINE : SINE + 1]
    pair = pair / np.maximum(np.linalg.norm(a, axis=1), TINY)[:, None, None]
    toward[:, 2, COSINE : SINE + 1] = pair
    for i, axis in enumerate(np.eye(kinds.shape[1] - 3)):
        toward[:, 3 + i, COSINE : SINE + 1] = pair @ skew(axis).T
    return toward * kinds[:, :, None, None], price


def circle_of(pair: Array) -> Array:
    """Return the circle nearest to an ellipse's coefficients of cosine and sine, shape (2, n)."""
    u, sizes, v = np.linalg.svd(pair, full_matrices=False)
    return np.asarray(sizes.mean() * u @ v)


def _data_evidence(misfit: Array, half: Array, noise: Noise) -> Array:
    """Return the part of the evidence that the misfit of twice ``half`` as many numbers decides."""
    share, scale = noise
    constant = np.asarray(_log_gamma(share + half) - _log_gamma(share), dtype=float)
    constant += share * np.log(scale) - half * math.log(2.0 * math.pi)
    return np.asarray(constant - (share + half) * np.log(scale + 0.5 * misfit))


class Bank:
    """Predicts a goal from its sightings by all families of motion at once."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget every sighting."""
        self._last: float | None = None
        self._n = 0
        self._apart: list[tuple[float, Array]] = []  # sightings off the forecast so far
        self._lately: list[tuple[float, Array]] = []
        self._fastest = 0.0  # speed seen [m/s]

    @property
    def model(self) -> str:
        """Return the likeliest motion; empty before the first sighting."""
        return '' if self._last is None else NAMES[int(np.argmax(self._shares))]

    def observe(self, sighting: GoalObservation) -> None:
        """Take in a sighting; one that is not finite, or not newer than the last, says nothing."""
        time, position = float(sighting.time), np.asarray(sighting.position, dtype=float)
        if not (math.isfinite(time) and np.isfinite(position).all()):
            return
        if self._last is not None and time <= self._last:
            return
        if self._last is None or len(position) != self._n or time - self._last > LOST:
            self._begin(np.array([time]), position[None], UNKNOWN)
        elif self._expected(time, position):
            self._apart = []
            if self._append(time, position, time - self._last) and self._changed():
                self._reconsider()
            if len(self._times) == MEMORY:
                self._shorten()
        else:
            self._apart.append((time, position))
            if len(self._apart) == BELIEVED:
                times, seen = zip(*self._apart, strict=True)
                self._begin(np.array(times), np.array(seen), self._learnt())
        self._last = time

    def at(self, times: Array) -> Array:
        """Return where the goal will be at ``times``, shape (N,) [s], as shape (N, n) [m].

        The mean of the families' mixture.
        """
        used = np.flatnonzero(self._shares > NEGLIGIBLE)
        shares = self._shares[used] / self._shares[used].sum()
        assert self._last is not None
        every = np.append(self._last, times) - self._epoch
        x = columns(every[None], self._rates[used, None], self._dampings[used, None])
        places = x @ self._fits.coefficients[used]
        # No farther from the present places than the fastest speed seen leads.
        now, moved = places[:, :1], places[:, 1:] - places[:, :1]
        reach = self._fastest * np.maximum(times - self._last, 0.0)
        size = np.linalg.norm(moved, axis=2)
        share = np.where(size > reach, reach / np.maximum(size, TINY), 1.0)
        share[:, times <= self._last] = 1.0
        return np.asarray(
            np.einsum('b,btn->tn', shares, now + share[..., None] * moved) + self._origin
        )

    # --- taking in

    def _begin(self, times: Array, seen: Array, noise: Noise) -> None:
        """Start afresh with the first sightings of a motion: times, (M,), and positions, (M, n)."""
        with np.errstate(over='ignore'):
            together = np.abs(seen - seen[-1]).max(axis=1) <= FAR
        times, seen = times[together], seen[together]
        self._n, self._noise = seen.shape[1], noise
        self._epoch, self._origin = float(times[0]), seen[0].copy()
        self._times, self._seen = np.zeros(0), np.zeros((0, self._n))
        self._rates, self._dampings = np.zeros((2, len(NAMES)))
        self._circle: Array = np.zeros((2, self._n))  # about which a turn is fitted
        self._history: dict[int, tuple[float, Noise]] = {}  # evidence and noise, by sightings
        self._searched, self._apart = 0, []
        for time, position in zip(times, seen, strict=True):
            self._append(float(time), position)

    def _append(self, time: float, position: Array, waited: float = math.inf) -> bool:
        """Add a sighting after a wait [s]; return whether all families were fitted anew.

        Of many sightings soon one after another every other one waits for the next.
        """
        self._note_speed(time, position)
        self._times = np.append(self._times, time - self._epoch)
        self._seen = np.vstack([self._seen, position - self._origin])
        if waited < SELDOM and len(self._times) > YOUNG and len(self._times) % 2:
            return False
        self._move()
        self._fit()
        if len(self._times) >= self._searched + max(1, self._searched // 8):
            self._search()
        self._conclude()
        return True

    def _note_speed(self, time: float, position: Array) -> None:
        """Note how fast the goal has moved lately, over half a second or the last two sightings."""
        self._lately.append((time, position))
        while len(self._lately) > 2 and time - self._lately[1][0] >= SPEED_OVER:
            self._lately.pop(0)
        begun, place = self._lately[0]
        if time > begun:
            speed = math.dist(position, place) / (time - begun)
            self._fastest = max(self._fastest, min(speed, FAR))

    def _expected(self, time: float, position: Array) -> bool:
        """Return whether any motion that is likely at all has the goal near there."""
        with np.errstate(over='ignore'):
            if np.abs(position - self._origin).max() > FAR:
                return False
        assert self._last is not None
        since = np.full(len(NAMES), time - self._epoch)
        rows = columns(since, self._rates, self._dampings)
        off = np.einsum('bi,bin->bn', rows, self._fits.coefficients) - (position - self._origin)
        spread = self._fits.noise * (1.0 + self._fits.spread(rows))
        allowed = GATE**2 * (spread + (0.5 * AGILE * (time - self._last) ** 2) ** 2)
        return bool(np.any((np.sum(off * off, axis=1) <= allowed) & (self._shares > LIKELY)))

    def _shorten(self) -> None:
        """Drop the oldest sightings; frequencies are kept."""
        by, offset = self._times[-KEPT], self._seen[-KEPT]
        self._times, self._seen = self._times[-KEPT:] - by, self._seen[-KEPT:] - offset
        self._epoch, self._origin = self._epoch + float(by), self._origin + offset
        self._history, self._searched = {}, MEMORY
        self._fit()
        self._search()
        self._conclude()

    # --- fits

    def _fit(self) -> None:
        """Fit all families to all sightings, at their frequencies."""
        sums = summed(self._rates, self._dampings, self._times, self._seen)
        self._fits = fitted(EVERY, self._rates, sums, self._noise, self._circle)

    def _conclude(self) -> None:
        """Weigh the families."""
        evidence = ODDS + self._fits.evidence
        evidence[OSCILLATING & (self._rates == 0.0)] = -np.inf
        if len(self._times) < BENT_FROM:
            evidence[ACCELERATION] = -np.inf
        best = evidence.max()
        shares = np.exp(evidence - best)
        self._shares = shares / shares.sum()
        count = len(self._times)
        self._history[count] = best + math.log(shares.sum()), self._learnt()
        self._history.pop(count - int(LENGTHS[-1]) - 1, None)
        self._history.pop(count - int(LENGTHS[-1]) - 2, None)

    def _move(self) -> None:
        """Take a Gauss-Newton step of each frequency, shortened to where linearity ends."""
        if len(self._times) < SWINGS_FROM:
            return
        step = self._fits.step[:, :2]
        step = step / np.maximum(1.0, self._times[-1] * np.abs(step).max(axis=1, keepdims=True))
        moved = np.clip(self._rates + step[:, 0], SLOWEST, FASTEST)
        self._rates = np.where(self._rates > 0.0, moved, 0.0)
        self._dampings = np.clip(self._dampings + step[:, 1], 0.0, MOST_DAMPED)
        self._circle = circle_of(self._fits.coefficients[TURN, COSINE : SINE + 1])

    def _search(self) -> None:
        """Look for better frequencies on the grid."""
        count = len(self._times)
        if count < SWINGS_FROM:
            return
        self._searched, every = count, -(-count // LOOKED_AT)
        times, seen = self._times[::every], self._seen[::every]
        span = float(times[-1])
        resolved = min(FASTEST, 2.0 * math.pi * NYQUIST * len(times) / span)
        even = np.arange(SLOW[-1], resolved, APART / min(span, LONG))
        grid = np.concatenate([SLOW[resolved > SLOW], even[1:]]) if len(even) else SLOW[:1]
        sums = summed(grid, np.zeros_like(grid), times, seen)
        for family in (SWING, CARRIER):
            tried = fitted(np.full(len(grid), family), grid, sums, self._noise, self._circle)
            best = int(np.argmin(tried.misfit))
            ours = self._fits.misfit[family] * len(times) / count
            if not self._rates[family] or tried.misfit[best] < BETTER * ours:
                self._rates[family] = grid[best]
        self._fit()
        misfit, swing = self._fits.misfit, self._fits.coefficients[SWING, COSINE : SINE + 1]
        worse = (self._rates == 0.0) | (misfit > WORSE * misfit[SWING])
        worse &= (EVERY >= DAMPED) & swing.any()  # a circle of no size is no turn
        self._rates[worse], self._dampings[worse] = self._rates[SWING], 0.0
        if worse[TURN]:
            self._circle = circle_of(swing)
        self._fit()

    def _learnt(self) -> Noise:
        """Return what the likeliest family has taught of the noise, to be recalled later.

        As many numbers as its parameters take are fitted exactly, and teach nothing.
        """
        best = int(np.argmax(self._shares))
        taken = self._n * BASIS[best].sum() + OSCILLATING[best] + (best == DAMPED)
        taken += (1 + self._n * (self._n - 1) // 2) * (best == TURN)
        left = 0.5 * float(len(self._times) * self._n - taken)
        if left <= 0.0:
            return self._noise
        share = self._noise.share + left
        scale = self._noise.scale + 0.5 * float(self._fits.misfit[best])
        kept = min(share, RECALLED)
        return Noise(kept, kept * max(scale / share, LEAST))

    # --- changes of course

    def _changed(self) -> int:
        """Return how many sightings a new motion has, if one is likely; otherwise 0."""
        count = len(self._times)
        lengths = np.array([each for each in LENGTHS if count - each in self._history])
        if not len(lengths):
            return 0
        before = [self._history[count - length] for length in lengths]
        anew = self._anew(lengths, Noise(*np.array([noise for _, noise in before]).T))
        gain = np.array([evidence for evidence, _ in before]) + anew
        if gain.max() + RARE <= self._history[count][0]:
            return 0
        return int(lengths[np.flatnonzero(gain > gain.max() - TIE)[-1]])

    def _anew(self, lengths: np.ndarray, noise: Noise) -> Array:
        """Return the evidence of a still, straight or bent motion through the latest sightings."""
        most = int(lengths[-1])
        times, seen = self._times[: -most - 1 : -1], self._seen[: -most - 1 : -1]
        x, y = columns(times - times[0], 0.0, 0.0), seen - seen[0]
        products = x[:, :, None] * x[:, None], x[:, :, None] * y[:, None], np.sum(y * y, axis=1)
        each = (np.cumsum(product, axis=0)[lengths - 1] for product in products)
        sums = Sums(*(np.repeat(one, 3, axis=0) for one in (*each, lengths)))
        family, noise = (
            np.tile(EVERY[:3], len(lengths)),
            Noise(*np.repeat(np.array(noise), 3, axis=1)),
        )
        found = fitted(family, np.zeros(len(family)), sums, noise, self._circle).evidence
        return np.asarray(np.logaddexp.reduce(found.reshape(-1, 3) + NEW_ODDS, axis=1))

    def _reconsider(self) -> None:
        """Start afresh with a new motion, unless an oscillation explains it on a closer look."""
        self._search()
        for _ in range(STEPS):
            self._move()
            self._fit()
        self._conclude()
        if new := self._changed():
            times, seen = self._times[-new:] + self._epoch, self._seen[-new:] + self._origin
            self._begin(times, seen, self._history[len(self._times) - new][1])
