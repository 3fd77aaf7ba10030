# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Forecasts of a moving goal from its sightings: the targets g_1..g_N of a plan.

A bank fits several families of motion and weighs them by evidence. Each is a combination of the
seven columns of (7.4a), whose last two are the directions in which frequency and damping move
coefficients, and is defined by its Jacobian B, the derivatives of the coefficients by its
parameters.

A fit is Bayesian and linear about the present coefficients: with the columns X, the residuals E and
prior precisions \Gamma relative to the noise, A = B'(X'X)B + \Gamma and the step is A^-1 B'X'E.
The precision of the noise has a gamma prior, so that the evidence has a closed form.

At each sighting oscillations take a step, all families are refitted, and the goal is tested for a
change of course. Swings are sought at every fifth sighting.

Mathematics: docs/mathematics.md, 7.4.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from orbimpc_ros.loop.goal.motion import GoalObservation, slope
from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.geometry.rotations import skew

NAMES = ('still', 'velocity', 'acceleration', 'turn', 'swing', 'carrier', 'damped')
STILL, VELOCITY, ACCELERATION, TURN, SWING, CARRIER, DAMPED = range(len(NAMES))
OSCILLATING = (TURN, SWING, CARRIER, DAMPED)  # with a frequency to be estimated
ODDS = np.array([-5.0, 0.0, -5.0, -3.0, -5.0, -6.0, -6.0])  # logarithms, before any sighting
COLUMNS = 7
ONE, LINEAR, SQUARE, COSINE, SINE, T_COSINE, T_SINE = range(COLUMNS)

SLOWEST, FASTEST = 0.02, 4.0 * math.pi  # angular frequencies considered [rad/s]
PLACE = 3.0  # prior standard deviations: of the place [m]
SPEED = 5.0  # [m/s]
THRUST = 1.0  # half an acceleration [m/s^2]
SIZE, PUSH = 3.0, 5.0  # of a swing: its size [m], its acceleration [m/s^2]
PULSE = 1.0  # angular frequency and damping [1/s]
TINY = 1e-12  # [1/m^2] precision of the place, so that no matrix is singular


@lru_cache(maxsize=2)
def layout(n: int) -> tuple[Array, Array, Array]:
    """Return the structure and priors of the families for n dimensions.

    The P rows of a Jacobian are: place (n), velocity (n), then two coefficients of n (t^2, or
    cosine and sine; for a circle its relative size and its attitude), angular frequency, damping.

    Returns:
        Rows used by each family, shape (K, P); prior precisions, shape (K, P), 1 in unused rows;
        and the constant part of the Jacobian, shape (K, P, 7, n).
    """
    first, second, rate = 2 * n, 3 * n, 4 * n
    constant = np.zeros((len(NAMES), 4 * n + 2, COLUMNS, n))
    for i in range(n):
        constant[:, i, ONE, i] = 1.0
        constant[[VELOCITY, ACCELERATION, CARRIER], n + i, LINEAR, i] = 1.0
        constant[ACCELERATION, first + i, SQUARE, i] = 1.0
        constant[[SWING, CARRIER, DAMPED], first + i, COSINE, i] = 1.0
        constant[[SWING, CARRIER, DAMPED], second + i, SINE, i] = 1.0
    used = np.zeros(constant.shape[:2], dtype=bool)
    used[constant.any(axis=(2, 3))] = True
    used[TURN, first : first + 1 + n * (n - 1) // 2] = True
    used[list(OSCILLATING), rate] = True
    used[DAMPED, rate + 1] = True
    width = np.full(used.shape, PULSE)
    width[:, :n], width[:, n:first], width[:, first:rate] = PLACE, SPEED, SIZE
    width[ACCELERATION, first:second] = THRUST
    precision = np.where(used, 1.0 / width**2, 1.0)
    return sealed(used), sealed(precision), sealed(constant)


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


def jacobians(coefficients: Array) -> Array:
    """Return the derivatives of coefficients, (K, 7, n), by parameters, shape (K, P, 7, n)."""
    n, turning = coefficients.shape[2], list(OSCILLATING)
    rows, rate = layout(n)[2].copy(), 4 * n
    a, b = coefficients[:, COSINE], coefficients[:, SINE]
    rows[turning, rate, T_COSINE], rows[turning, rate, T_SINE] = b[turning], -a[turning]
    rows[DAMPED, rate + 1, T_COSINE], rows[DAMPED, rate + 1, T_SINE] = -a[DAMPED], -b[DAMPED]
    # In metres at the rim, so that a circle of radius zero does not pass for a still goal.
    a, b, radius = a[TURN], b[TURN], max(float(np.linalg.norm(a[TURN])), TINY)
    rows[TURN, 2 * n, COSINE], rows[TURN, 2 * n, SINE] = a / radius, b / radius
    for row, axis in enumerate(np.eye(n * (n - 1) // 2) / radius, start=2 * n + 1):
        rows[TURN, row, COSINE], rows[TURN, row, SINE] = skew(axis) @ a, skew(axis) @ b
    return rows


def circle(coefficients: Array) -> Array:
    """Return the circle nearest to an ellipse, as coefficients, shape (7, n)."""
    u, sizes, v = np.linalg.svd(coefficients[COSINE : SINE + 1], full_matrices=False)
    nearest = coefficients.copy()
    nearest[COSINE : SINE + 1] = sizes.mean() * u @ v
    return nearest


Past = tuple[Array, Array]  # times, shape (M,) [s], and positions, shape (M, n) [m]
# [rad/s]; geometric below; above, spaced by what twenty seconds of data resolve
GRID = 2.0 * math.pi * np.concatenate([np.geomspace(0.01, 0.15, 24), np.arange(0.165, 2.0, 0.016)])
SOUGHT_IN = 192  # largest number of sightings in which a swing is sought
NYQUIST = 0.45  # cycles per sighting, the highest resolved frequency
ASSUMED = 0.01  # [m] noise, for the prior of a swing's size
FIXED, DRIFTING = 1, 2  # columns of the line followed by the centre of a swing


def best_swing(past: Past, middle: int) -> tuple[float, float]:
    """Return the angular frequency [rad/s] of the swing that fits best, and its misfit [m^2].

    The centre of the swing (``middle``) is ``FIXED`` or ``DRIFTING``; its size has a prior.
    """
    thinned = slice(None, None, math.ceil(len(past[0]) / SOUGHT_IN))  # to bound the cost
    times, seen = past[0][thinned], past[1][thinned]
    x = np.empty((len(GRID), middle + 2, len(times)))
    x[:, :middle] = np.vander(times, middle, increasing=True).T
    x[:, -2], x[:, -1] = np.cos(GRID[:, None] * times), np.sin(GRID[:, None] * times)
    moments = x @ seen
    gram = x @ x.transpose(0, 2, 1) + np.diag([0.0] * middle + 2 * [(ASSUMED / SIZE) ** 2])
    explained = np.sum(moments * np.linalg.solve(gram, moments), axis=(1, 2))
    span = math.sqrt(3.0 * float(np.mean(times * times)))  # for times spread evenly from 0
    explained[GRID * span > 2.0 * math.pi * NYQUIST * len(times)] = -np.inf
    best = int(np.argmax(explained))
    misfit = float(np.sum(seen * seen) - explained[best])
    return float(GRID[best]), misfit * len(past[0]) / len(times)


MEMORY, KEPT = 768, 512  # sightings; those kept when the memory is full
MOST_DAMPED = 2.0  # [1/s]
SWINGS_FROM = 4  # sightings
BETTER, WORSE = 0.9, 1.02  # ratios of misfits at which a family is restarted from another
STEPS = 5  # Gauss-Newton steps of a closer analysis
WORTHWHILE = 0.01  # least gain of a step, in units of the noise
BENT_FROM = 5  # sightings: any three fit an acceleration
# For a few numbers at a time: importing SciPy's takes longer than a flight's calls.
log_gamma = np.vectorize(math.lgamma, otypes=[float])


class Noise(NamedTuple):
    """Gamma distribution of the precision of the noise of sightings."""

    share: float  # half the equivalent number of values
    scale: float  # half the sum of their squares [m^2]

    @property
    def variance(self) -> float:
        """Return the most likely variance [m^2]."""
        return self.scale / self.share


UNKNOWN = Noise(1.0, 2e-4)  # 1.4 cm, within a factor of ten
LEAST = 1e-5  # [m^2] least variance that is recalled
RECALLED = 8.0  # largest share recalled from an earlier motion's noise


class Fits:
    """The families fitted to the sightings of one motion.

    Times and positions within are relative to ``epoch`` [s] and ``origin``, shape (n,) [m].

    Attributes:
        count: number of sightings.
        shares: of the families in the evidence, shape (K,).
        evidence: logarithm for all families together, by the number of sightings so far.
        noise: estimated with each number of sightings, see :meth:`_noise`.
    """

    def __init__(self, epoch: float, origin: Array, noise: Noise = UNKNOWN) -> None:
        self.epoch, self.origin, self._prior = epoch, origin, noise
        self._n = n = len(origin)
        self._used, self._precision, _ = layout(n)
        size = len(NAMES)
        self._rounds = self._searched = 0
        self._searches = (
            self._begin_search,
            partial(self._seek, SWING, FIXED),
            partial(self._seek, CARRIER, DRIFTING),
            partial(self._restart, DAMPED),
            partial(self._restart, TURN),
        )
        # Whether a family has no frequency, or has moved since it was placed: evidence covers it.
        self._weighed = ~np.isin(np.arange(size), OSCILLATING)
        self._rates = np.zeros(size)  # angular frequencies [rad/s]; 0 if there is none yet
        self._dampings = np.zeros(size)  # [1/s]
        self._coefficients = np.zeros((size, COLUMNS, n))  # linearisation points
        self._times, self._seen, self.count = np.zeros(MEMORY), np.zeros((MEMORY, n)), 0
        self.evidence, self.noise = np.full(MEMORY + 1, -np.inf), [noise] * (MEMORY + 1)

    def rows(self, times: Array) -> Array:
        """Return the columns of every family at times, shape (M,) [s], as shape (K, M, 7)."""
        return columns(times, self._rates[:, None], self._dampings[:, None])

    @property
    def past(self) -> Past:
        """Return all sightings so far."""
        return self._times[: self.count], self._seen[: self.count]

    def first(self, count: int) -> Past:
        """Return the first sightings: times, shape (M,) [s], and positions, shape (M, n) [m]."""
        return self._times[:count] + self.epoch, self._seen[:count] + self.origin

    def add(self, times: Array, seen: Array) -> None:
        """Add sightings: times, shape (M,) [s], and positions, shape (M, n) [m]."""
        latest = slice(self.count, self.count + len(times))
        self._times[latest], self._seen[latest] = times - self.epoch, seen - self.origin
        self.count += len(times)

    def at(self, times: Array) -> Array:
        """Return the positions that each family predicts at times, (M,) [s], shape (K, M, n)."""
        return self.rows(times - self.epoch) @ self._fitted + self.origin

    def place(
        self,
        family: int,
        rate: float,
        coefficients: Array,
        damping: float = 0.0,
        weighed: bool = False,
    ) -> None:
        """Linearise a family anew, at a rate and a damping [1/s]; ``solve`` must follow."""
        self._rates[family], self._dampings[family] = rate, damping
        self._coefficients[family], self._weighed[family] = coefficients, weighed

    def _moves(self, *families: int) -> list[tuple[int, float, Array, float, bool]]:
        """Return where to ``place`` those of the families that gain by a Gauss-Newton step."""
        return [self._moved(each) for each in families if self._gain[each] > WORTHWHILE]

    def _moved(self, family: int) -> tuple[int, float, Array, float, bool]:
        """Return where a step places a family, shortened to where linearity holds."""
        n, step, times = self._n, self._step[family], self.past[0]
        span = float(times[-1] - times[0]) or 1.0
        rim = np.abs(step[2 * n : 3 * n + 1]).max() if family == TURN else 0.0
        radius = float(np.linalg.norm(self._coefficients[family, COSINE]))
        step = step / max(1.0, span * np.abs(step[4 * n :]).max(), 2.0 * rim / max(radius, TINY))
        rate = min(max(self._rates[family] + step[4 * n], SLOWEST), FASTEST)
        damping = min(max(self._dampings[family] + step[4 * n + 1], 0.0), MOST_DAMPED)
        change = np.tensordot(step[: 4 * n], self._jacobian[family, : 4 * n], 1)
        coefficients = self._coefficients[family] + change
        if family == TURN:
            coefficients = circle(coefficients)
        return family, rate, coefficients, damping, True

    @property
    def _transposed(self) -> Array:
        """Return the Jacobians, parameters last, shape (K, 7, nP)."""
        return self._jacobian.transpose(0, 2, 3, 1).reshape(len(NAMES), COLUMNS, -1)

    def _precisions(self) -> Array:
        """Return the prior precisions relative to the noise, shape (K, P); 1 if unused.

        The prior limits the size of a circle by its speed, that of a swing by its acceleration.
        """
        shape, rates = slice(2 * self._n, 4 * self._n), self._rates[:, None]
        sizes = 1.0 / SIZE**2 + (rates * rates / PUSH) ** 2
        sizes[TURN] = (rates[TURN] / SPEED) ** 2
        precisions = self._precision.copy()
        precisions[:, shape] = np.where(rates > 0.0, sizes, precisions[:, shape])
        return np.where(self._used, self._prior.variance * precisions, 1.0)

    def solve(self) -> None:
        """Fit every family to all sightings so far."""
        times, seen = self.past
        n, (size, rows), (share, scale) = self._n, self._used.shape, self._prior
        priors = self._precisions()
        free, pull = priors.copy(), np.zeros((size, rows))
        free[:, :n] = TINY * self._prior.variance  # the place is unconstrained
        pull[:, n : 2 * n] = self._coefficients[:, LINEAR]
        pull[:, 2 * n : 4 * n] = self._coefficients[:, COSINE : SINE + 1].reshape(size, -1)
        pull[TURN] = 0.0
        self._jacobian = jacobians(self._coefficients)
        flat, x = self._jacobian.reshape(size, rows, -1), self.rows(times)
        turned, off = x.transpose(0, 2, 1), seen - x @ self._coefficients
        normal = flat @ (turned @ x @ self._transposed).reshape(size, -1, rows)
        normal[:, range(rows), range(rows)] += free
        slope = (flat @ (turned @ off).reshape(size, -1, 1))[:, :, 0] - free * pull
        factor = np.linalg.cholesky(normal)
        self._root = np.linalg.inv(factor)
        white = (self._root @ slope[:, :, None])[:, :, 0]
        self._step = (white[:, None, :] @ self._root)[:, 0]
        step = (self._step[:, None, :] @ flat).reshape(self._coefficients.shape)
        self._fitted: Array = self._coefficients + step
        explained = np.sum(white * white, axis=1)
        misfit = np.sum(off * off, axis=(1, 2)) + np.sum(free * pull * pull, axis=1) - explained
        self._misfit = np.maximum(misfit, 0.0)
        self._noises = (scale + 0.5 * self._misfit) / (share + 0.5 * self.count * n)
        spread = np.log(priors).sum(axis=1) - 2.0 * np.log(np.diagonal(factor, 0, 1, 2)).sum(axis=1)
        data = data_evidence(self._misfit, self.count * n, share, scale)
        evidence = np.where(self._weighed, ODDS + 0.5 * spread + data, -np.inf)
        if self.count < BENT_FROM:
            evidence[ACCELERATION] = -np.inf
        total = float(np.logaddexp.reduce(evidence))
        self.evidence[self.count], self.shares = total, np.exp(evidence - total)
        self.noise[self.count] = self._noise()
        self._gain = np.where(self._rates > 0.0, explained / self._noises, 0.0)

    def _noise(self) -> Noise:
        """Return the noise estimated by the likeliest family, as a prior for later motions.

        As many numbers as it has parameters are fitted exactly, and carry no information on noise.
        """
        best = int(np.argmax(self.shares))
        left = 0.5 * (self.count * self._n - int(self._used[best].sum()))
        if left <= 0.0:
            return self._prior
        share, scale = self._prior.share + left, self._prior.scale + 0.5 * float(self._misfit[best])
        kept = min(share, RECALLED)
        return Noise(kept, kept * max(scale / share, LEAST))

    def variance(self, time: float) -> Array:
        """Return the total variance of a sighting at a time [s] by each family, (K,) [m^2]."""
        rows = self.rows(np.array([time - self.epoch]))[:, 0]
        size, count = self._used.shape
        moved = (rows[:, None, :] @ self._transposed).reshape(size, self._n, count)
        white = moved @ self._root.transpose(0, 2, 1)
        return np.asarray(self._noises * (1.0 + np.sum(white * white, axis=(1, 2))))

    # --- oscillations

    def improve(self) -> None:
        """Step one oscillation, and search for a better one, each at its turn."""
        turn = (self._rounds + 1) % len(OSCILLATING)
        raw = [each for each in OSCILLATING if self._rates[each] and not self._weighed[each]]
        moves = self._moves(*raw, *OSCILLATING[turn:], *OSCILLATING[:turn])
        self._searches[self._rounds % len(self._searches)]()
        for move in moves[:1]:
            self.place(*move)
        self._rounds += 1

    def look_closely(self) -> None:
        """Do at once all that is otherwise spread over many sightings."""
        for search in self._searches[:3]:
            search()
        for _ in range(STEPS):
            self.solve()
            for move in self._moves(*OSCILLATING):
                self.place(*move)
            for search in self._searches[3:]:
                search()
        self.solve()

    def _begin_search(self) -> None:
        """Choose the sightings in which swings are sought: all so far."""
        self._searched = self.count

    def _seek(self, family: int, middle: int) -> None:
        """Place a family at the frequency of the best swing, if that fits better."""
        times, seen = (each[: self._searched] for each in self.past)
        rate, misfit = best_swing((times, seen), middle)
        if not self._rates[family] or misfit < BETTER * self._misfit[family]:
            self.place(family, rate, np.zeros_like(self._coefficients[family]))

    def _restart(self, family: int) -> None:
        """Restart a family from the swing, if that fits better."""
        swing, rate = self._coefficients[SWING], self._rates[SWING]
        worse = not self._rates[family] or self._misfit[family] > WORSE * self._misfit[SWING]
        if worse and swing[COSINE].any():
            self.place(family, rate, circle(swing) if family == TURN else swing)


def fitted_closely(noise: Noise, times: Array, positions: Array) -> Fits:
    """Return the families fitted to sightings, shapes (M,) [s] and (M, n) [m], at once."""
    fits = Fits(float(times[0]), positions[0], noise)
    fits.add(times, positions)
    fits.look_closely()
    return fits


def data_evidence(
    misfit: Array, numbers: Array | float, share: Array | float, scale: Array | float
) -> Array:
    """Return the part of the evidence due to the misfit [m^2] of a number of values.

    The noise, with a prior of ``share`` and ``scale`` [m^2], is integrated out.
    """
    shape = share + 0.5 * numbers
    prior = share * np.log(scale) - log_gamma(share) - 0.5 * numbers * math.log(2.0 * math.pi)
    return prior + log_gamma(shape) - shape * np.log(scale + 0.5 * misfit)


WIDTHS = np.array([PLACE, SPEED, THRUST])  # prior standard deviations of a new motion
ODDS_ANEW = np.array([0.0, 0.0, -3.0])  # logarithms: still, straight, bent


def evidence_anew(past: Past, lengths: np.ndarray, noises: Array) -> Array:
    """Return the evidence of a still, straight or bent motion over the latest sightings.

    It is given for each of the ``lengths``, increasing numbers of sightings, shape (L,), with the
    share and scale of the noise known before, shape (L, 2). One Cholesky factor serves all three
    motions, because the columns of each are the first of the next.
    """
    latest = slice(-1, -1 - lengths[-1], -1)
    times, places = past[0][latest], past[1][latest]
    (share, scale), n = noises.T[:, :, None], places.shape[1]
    rows = (times - times[0])[:, None] ** np.arange(3.0)
    seen = places - places[0]
    gram = np.cumsum(rows[:, :, None] * rows[:, None, :], axis=0)[lengths - 1]
    moments = np.cumsum(rows[:, :, None] * seen[:, None, :], axis=0)[lengths - 1]
    square = np.cumsum(np.sum(seen * seen, axis=1))[lengths - 1]
    prior = scale / share / WIDTHS**2
    gram[:, range(1, 3), range(1, 3)] += prior[:, 1:]
    factor = np.linalg.cholesky(gram)
    white = np.linalg.solve(factor, moments)
    explained = np.cumsum(np.sum(white * white, axis=2), axis=1)
    spread = np.log(prior) - 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2))
    misfit = np.maximum(square[:, None] - explained, 0.0)
    evidence = data_evidence(misfit, float(n) * lengths[:, None], share, scale)
    evidence += 0.5 * n * np.cumsum(spread, axis=1) + ODDS_ANEW
    return np.asarray(np.logaddexp.reduce(evidence, axis=1))


# Sightings of a new motion.
LENGTHS = np.array([2, 4, 6, 8, 10, 12, 16, 20, 26, 34, 42, 50])
TIE = 4.0  # lengths with evidence this close count as equal; the longest is chosen
RARE = -5.0  # logarithm of the prior odds of a change of course at a sighting
BELIEVED = 3  # consecutive outliers that start a new motion
GATE = 6.0  # standard deviations beyond which a sighting is an outlier
AGILE = 5.0  # [m/s^2] unpredicted acceleration that a goal may have
LOST = 60.0  # [s] gap between sightings after which a motion starts anew
PATIENCE, MOST_ROUNDS = 0.5, 3  # [s] of waiting per round of work, and their largest number
LIKELY, NEGLIGIBLE = 1e-2, 1e-4  # shares
SPEED_OVER = 0.5  # [s]


class Bank:
    """Predicts a goal from its sightings by all families of motion at once.

    Attributes:
        model: name of the likeliest motion; empty before the first sighting.
    """

    def __init__(self) -> None:
        self.model = ''
        self._last = -math.inf  # stamp of the last sighting [s]
        self._fits: Fits  # of the present motion, from the first sighting on
        self._earlier: list[tuple[Fits, int]] = []  # of motions before; numbers of their sightings
        self._apart: list[GoalObservation] = []  # consecutive outliers so far
        self._lately: list[GoalObservation] = []
        self._fastest = 0.0  # highest observed speed [m/s]

    def observe(self, sighting: GoalObservation) -> None:
        """Take in a sighting; ignore it unless it is newer than the last.

        An outlier is set aside; with some more it starts a new motion.
        """
        waited = sighting.time - self._last
        if waited <= 0.0:
            return
        if waited > LOST:
            self._begin([sighting])
        elif self._expected(sighting, waited):
            self._learn(sighting, waited)
        else:
            self._apart.append(sighting)
            if len(self._apart) == BELIEVED:
                self._begin(self._apart, self._fits.count)
        self._last, self.model = sighting.time, NAMES[int(np.argmax(self._fits.shares))]

    def at(self, times: Array) -> Array:
        """Return the predicted positions at ``times``, shape (N,) [s], as shape (N, n) [m].

        They are the mean of the families weighted by their shares. The distance of each from its
        own position at the last sighting is limited by the highest speed observed.
        """
        fits, last = self._fits, self._last
        used = np.flatnonzero(fits.shares > NEGLIGIBLE)
        shares = fits.shares[used] / fits.shares[used].sum()
        places = fits.at(np.append(last, times))[used]
        moved, reach = places[:, 1:] - places[:, :1], self._fastest * (times - last)
        size = np.maximum(np.linalg.norm(moved, axis=2), TINY)
        share = np.where(times > last, np.minimum(1.0, reach / size), 1.0)
        mean = shares @ (places[:, :1] + share[..., None] * moved).reshape(len(shares), -1)
        return np.asarray(mean.reshape(len(times), -1))

    # --- taking in

    def _expected(self, sighting: GoalObservation, waited: float) -> bool:
        """Return True if any motion with a considerable share predicts the goal near there."""
        fits = self._fits
        off = fits.at(np.array([sighting.time]))[:, 0] - sighting.position
        allowed = GATE**2 * (fits.variance(sighting.time) + (0.5 * AGILE * waited * waited) ** 2)
        near = np.sum(off * off, axis=1) <= allowed
        return bool(np.any(near & (fits.shares > LIKELY)))

    def _learn(self, sighting: GoalObservation, waited: float) -> None:
        """Fit the present motion to another sighting, or start a new one."""
        self._apart, fits = [], self._fits
        self._add(sighting)
        if fits.count >= SWINGS_FROM:
            for _ in range(min(max(1, round(waited / PATIENCE)), MOST_ROUNDS)):
                fits.improve()
        fits.solve()
        if new := self._changed():
            times, positions = fits.first(fits.count)
            begun = list(map(GoalObservation, times[-new:].tolist(), positions[-new:]))
            self._begin(begun, fits.count - new)
            self._recall()
        if self._fits.count == MEMORY:
            latest = (each[-KEPT:] for each in self._fits.first(MEMORY))
            self._fits = fitted_closely(self._fits.noise[0], *latest)

    def _begin(self, sightings: Sequence[GoalObservation], before: int = 0) -> None:
        """Start anew with the first sightings of a motion, of which there are some ``before``."""
        first, noise = sightings[0], self._fits.noise[before] if before else UNKNOWN
        self._earlier = [*self._earlier, (self._fits, before)] if before else []
        self._fits, self._apart = Fits(first.time, first.position, noise), []
        for each in sightings:
            self._add(each)
            self._fits.solve()
        while sum(count for _, count in self._earlier) + self._fits.count > MEMORY:
            del self._earlier[0]

    def _recall(self) -> None:
        """Take the latest motions for a single one, an oscillation, if that is likelier."""
        parts = [*self._earlier, (self._fits, self._fits.count)]
        if sum(count for _, count in parts) < SWINGS_FROM:
            return
        times, positions = zip(*(fits.first(count) for fits, count in parts), strict=True)
        noise, sightings = parts[0][0].noise[0], (np.concatenate(times), np.concatenate(positions))
        one = fitted_closely(noise, *sightings)
        apart = sum(fits.evidence[count] for fits, count in parts) + RARE * len(self._earlier)
        if one.evidence[one.count] > apart:
            self._fits, self._earlier = one, []

    def _add(self, sighting: GoalObservation) -> None:
        """Add a sighting, and note the speed over half a second or the last two sightings."""
        time, lately = sighting.time, self._lately
        lately.append(sighting)
        while len(lately) > 2 and time - lately[1].time >= SPEED_OVER:
            lately.pop(0)
        if time > lately[0].time:
            distance = math.dist(sighting.position, lately[0].position)
            self._fastest = max(self._fastest, distance / (time - lately[0].time))
        self._fits.add(np.array([time]), sighting.position[None])

    def _changed(self) -> int:
        """Return the number of sightings of a new motion, if one is likely; otherwise 0."""
        fits = self._fits
        lengths = LENGTHS[fits.count > LENGTHS]
        if not len(lengths):
            return 0
        before = fits.count - lengths
        noises = np.array([fits.noise[each] for each in before])
        gain = fits.evidence[before] + evidence_anew(fits.past, lengths, noises)
        if gain.max() + RARE <= fits.evidence[fits.count]:
            return 0
        return int(lengths[np.flatnonzero(gain > gain.max() - TIE)[-1]])


LOWEST, HIGHEST = 0.01, 2.0  # frequencies considered [Hz], the highest subject to Nyquist
COARSE, FINE, ZOOMS = 40, 8, 3  # frequencies on the first grid, on a refinement, refinements
NOISES = (1e-3, 1e-2, 3e-2, 1e-1)  # standard deviations considered [m]
SWINGS = (0.3, 1.0)  # prior standard deviations of a and b considered [m]
SWUNG = [ONE, COSINE, SINE]  # columns
DRIFT = 10.0  # prior standard deviation of c about the last sighting [m]


class Velocity:
    """Extrapolates the goal along the straight line fitted to its latest sightings.

    With only the last one it stays there, as in the paper.
    """

    def __init__(self, latest: int) -> None:
        self._latest: deque[GoalObservation] = deque(maxlen=latest)

    def observe(self, sighting: GoalObservation) -> None:
        """Take in a sighting; sightings come in order of time."""
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

    def at(self, times: Array) -> Array:
        """Return the predicted positions at ``times``, shape (N,) [s], as shape (N, n) [m].

        Predictions are averaged by evidence over log(frequency).
        """
        stamps, places = self._past()
        last, data = places[-1], (stamps - stamps[-1], places - places[-1], times - stamps[-1])
        gaps = np.diff(stamps)
        spacing = float(np.median(gaps[gaps > 0.0])) if np.any(gaps > 0.0) else 1.0
        highest = min(HIGHEST, max(NYQUIST / spacing, 2 * LOWEST))
        rows = _fit(np.geomspace(LOWEST, highest, COARSE), *data)
        for _ in range(ZOOMS):
            best = int(np.argmax(rows[:, 1]))
            low, high = rows[max(best - 1, 0), 0], rows[min(best + 1, len(rows) - 1), 0]
            finer = _fit(np.geomspace(low, high, FINE + 2)[1:-1], *data)
            rows = np.concatenate([rows, finer])
            rows = rows[np.argsort(rows[:, 0])]
        grid, evidence, predicted = rows[:, 0], rows[:, 1], rows[:, 2:]
        weights = np.exp(evidence - evidence.max()) * np.gradient(np.log(grid))
        return np.asarray(last + (weights / weights.sum() @ predicted).reshape(len(times), -1))


def _fit(frequencies: Array, past: Array, seen: Array, ahead: Array) -> Array:
    """Fit the model at each frequency to positions ``seen``, shape (M, n), at times ``past``.

    Returns rows of frequency, logarithm of the evidence, and N positions ``ahead`` [m], averaged
    over noises and sizes of swing; shape (F, 2 + N n).

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
    predicted = (x_ahead @ average).reshape(len(frequencies), -1)
    return np.column_stack([frequencies, evidence.max(axis=1) + np.log(total), predicted])


FORECASTS: dict[str, Callable[[], Velocity | Bank]] = {
    'hold': partial(Velocity, latest=1),
    'velocity': partial(Velocity, latest=3),
    'harmonic': partial(Harmonic, latest=64),
    'auto': Bank,
}
