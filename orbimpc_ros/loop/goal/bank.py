# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Motions of a goal over one basis, fitted to its sightings and weighted by evidence.

Every family of motions is a combination of the seven columns of (7.4a), whose last two are the
directions in which frequency and damping move coefficients. A family is defined by its Jacobian B,
the derivatives of the coefficients by its parameters.

A fit is Bayesian and linear about the present coefficients: with the columns X, the residuals E and
prior precisions \Gamma relative to the noise, A = B'(X'X)B + \Gamma and the step is A^-1 B'X'E.
The precision of the noise has a gamma prior, so that the evidence has a closed form. Sums are
updated with each sighting; if a frequency moves, those of its family are computed anew.

Work is distributed to bound the cost of each sighting: of two, the first is gated and added to the
sums, and pays for two tasks that improve oscillations; with the second, all families are refitted,
and the goal is tested for a change of course.

Mathematics: docs/mathematics.md, 7.4.
"""

from __future__ import annotations

import math
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from orbimpc_ros.loop.goal.motion import GoalObservation
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


def shape_precision(family: int, rate: float) -> float:
    """Return the prior precision of an oscillation's shape at a frequency [rad/s], in 1/m^2.

    The prior limits the size of a circle by its speed, that of a swing by its acceleration.
    """
    if family == TURN:
        return (rate / SPEED) ** 2
    return 1.0 / SIZE**2 + (rate * rate / PUSH) ** 2


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


def jacobian(family: int, coefficients: Array) -> Array:
    """Return the Jacobian of an oscillation, coefficients by parameters, shape (P, 7, n)."""
    n = coefficients.shape[1]
    rows = layout(n)[2][family].copy()
    a, b, rate = coefficients[COSINE], coefficients[SINE], 4 * n
    rows[rate, T_COSINE], rows[rate, T_SINE] = b, -a
    if family == DAMPED:
        rows[rate + 1, T_COSINE], rows[rate + 1, T_SINE] = -a, -b
    if family == TURN:
        # In metres at the rim, so that a circle of radius zero does not pass for a still goal.
        radius = max(float(np.linalg.norm(a)), TINY)
        rows[2 * n, COSINE], rows[2 * n, SINE] = a / radius, b / radius
        for i, axis in enumerate(np.eye(n * (n - 1) // 2) / radius):
            rows[2 * n + 1 + i, COSINE], rows[2 * n + 1 + i, SINE] = skew(axis) @ a, skew(axis) @ b
    return rows


def circle(coefficients: Array) -> Array:
    """Return the circle nearest to an ellipse, as coefficients, shape (7, n)."""
    u, sizes, v = np.linalg.svd(coefficients[COSINE : SINE + 1], full_matrices=False)
    nearest = coefficients.copy()
    nearest[COSINE : SINE + 1] = sizes.mean() * u @ v
    return nearest


def arc(coefficients: Array, middle: float) -> tuple[float, Array] | None:
    """Return frequency and coefficients of the turn that fits an acceleration at ``middle`` [s].

    None if the motion is straight; ``coefficients`` are those of the family ``ACCELERATION``.
    """
    square = coefficients[SQUARE]
    velocity = coefficients[LINEAR] + 2.0 * middle * square
    speed = float(velocity @ velocity)
    across = 2.0 * (square - (square @ velocity) / max(speed, TINY) * velocity)
    rate = math.sqrt(float(across @ across) / max(speed, TINY))
    if not SLOWEST < rate < FASTEST:
        return None
    outward, along = -across / rate**2, velocity / rate
    c, s = math.cos(rate * middle), math.sin(rate * middle)
    place = coefficients[ONE] + middle * coefficients[LINEAR] + middle**2 * square
    turn = np.zeros_like(coefficients)
    turn[ONE] = place - outward
    turn[COSINE], turn[SINE] = c * outward - s * along, s * outward + c * along
    return rate, turn


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
    found = int(np.argmax(explained))
    misfit = float(np.sum(seen * seen) - explained[found])
    return float(GRID[found]), misfit * len(past[0]) / len(times)


MEMORY = 768  # sightings
MOST_DAMPED = 2.0  # [1/s]
BENT_FROM = 5  # sightings: any three fit an acceleration
# For a few numbers at a time: importing SciPy's takes longer than a flight's calls.
log_gamma = np.vectorize(math.lgamma, otypes=[float])


class Placement(NamedTuple):
    """A new linearisation point of a family; ``moved`` if a step led there (see Fits.weighed)."""

    family: int
    rate: float  # [rad/s]
    damping: float  # [1/s]
    coefficients: Array  # shape (7, n)
    moved: bool = False


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
    """The families fitted to a sequence of sightings in n dimensions.

    Attributes:
        prior: noise known before.
        waiting: placements requested, made by the next ``solve``.
        weighed: families without a frequency, or moved since they were placed, so that evidence
            covers the frequency, shape (K,).
        rates: angular frequencies, shape (K,) [rad/s]; 0 without one, or before it is placed.
        dampings: shape (K,) [1/s].
        coefficients: linearisation points, shape (K, 7, n).
        count: number of sightings.
        misfit: sums of squared residuals, including prior terms, shape (K,) [m^2].
        evidence: logarithms, shape (K,).
        noises: variance of sightings according to each family, shape (K,) [m^2].
        gain: reduction of the misfit by the latest step, in units of the noise, shape (K,).
    """

    def __init__(self, n: int, noise: Noise = UNKNOWN) -> None:
        self._n, self.prior = n, noise
        self._used, prior, constant = layout(n)
        size, rows = self._used.shape
        self.weighed = np.ones(size, dtype=bool)
        self.weighed[list(OSCILLATING)] = False
        self.rates, self.dampings = np.zeros(size), np.zeros(size)
        self.coefficients = np.zeros((size, COLUMNS, n))
        self._jacobian = constant.copy()
        self._pull = np.zeros((size, rows))  # parameters that the priors pull to zero
        self._gram = np.zeros((size, COLUMNS, COLUMNS))
        self._moments = np.zeros((size, COLUMNS, n))
        self._square, self.count, self.waiting = 0.0, 0, list[Placement]()
        self._times, self._seen = np.zeros(MEMORY), np.zeros((MEMORY, n))
        self.gain = np.zeros(size)
        self._step, self._root = np.zeros((size, rows)), np.zeros((size, rows, rows))
        self.misfit = self.noises = self.evidence = np.zeros(size)
        self._diagonal = np.arange(rows)
        precision = np.where(self._used, noise.variance * prior, 1.0)
        self._prior = ODDS + 0.5 * np.sum(np.log(precision), axis=1)
        self._free = precision  # with the place unconstrained
        self._free[:, :n] = TINY * noise.variance

    def rows(self, times: Array) -> Array:
        """Return the columns of every family at times, shape (M,) [s], as shape (K, M, 7)."""
        return columns(times, self.rates[:, None], self.dampings[:, None])

    @property
    def past(self) -> Past:
        """Return all sightings so far."""
        return self._times[: self.count], self._seen[: self.count]

    def add(self, times: Array, seen: Array) -> None:
        """Add sightings: times, shape (M,) [s], and positions, shape (M, n) [m]."""
        latest = slice(self.count, self.count + len(times))
        self._times[latest], self._seen[latest] = times, seen
        x = self.rows(times)
        turned = x.transpose(0, 2, 1)
        self._gram += turned @ x
        self._moments += turned @ seen
        self._square += float(np.sum(seen * seen))
        self.count += len(times)

    def place(self, to: Placement) -> None:
        """Linearise a family anew; ``solve`` must follow."""
        family, rate, damping, coefficients, weighed = to
        times, seen = self.past
        n, x = self._n, columns(times, rate, damping)
        self._gram[family], self._moments[family] = x.T @ x, x.T @ seen
        self.rates[family], self.dampings[family] = rate, damping
        self.coefficients[family] = coefficients
        self.weighed[family] = weighed
        self._jacobian[family] = jacobian(family, coefficients)
        shape = 2 * n + np.flatnonzero(self._used[family, 2 * n : 4 * n])
        size = self.prior.variance * shape_precision(family, rate)
        self._prior[family] += 0.5 * len(shape) * math.log(size / self._free[family, shape[0]])
        self._free[family, shape] = size
        if family != TURN:
            self._pull[family, n : 2 * n] = coefficients[LINEAR]
            self._pull[family, shape] = coefficients[COSINE : SINE + 1].ravel()

    def moved(self, family: int) -> Placement:
        """Return a family after a Gauss-Newton step, shortened to where linearity holds."""
        n, step, times = self._n, self._step[family], self.past[0]
        span = float(times[-1] - times[0]) or 1.0
        rim = np.abs(step[2 * n : 3 * n + 1]).max() if family == TURN else 0.0
        radius = float(np.linalg.norm(self.coefficients[family, COSINE]))
        step = step / max(1.0, span * np.abs(step[4 * n :]).max(), 2.0 * rim / max(radius, TINY))
        rate = min(max(self.rates[family] + step[4 * n], SLOWEST), FASTEST)
        damping = min(max(self.dampings[family] + step[4 * n + 1], 0.0), MOST_DAMPED)
        change = np.tensordot(step[: 4 * n], self._jacobian[family, : 4 * n], 1)
        coefficients = self.coefficients[family] + change
        if family == TURN:
            coefficients = circle(coefficients)
        return Placement(family, rate, damping, coefficients, moved=True)

    @property
    def _transposed(self) -> Array:
        """Return the Jacobians, parameters last, shape (K, 7, nP)."""
        return self._jacobian.transpose(0, 2, 3, 1).reshape(len(NAMES), COLUMNS, -1)

    def solve(self) -> None:
        """Fit every family to all sightings so far."""
        for each in self.waiting:
            self.place(each)
        self.waiting.clear()
        size, rows = self._step.shape
        flat = self._jacobian.reshape(size, rows, -1)
        residual = self._moments - self._gram @ self.coefficients
        normal = flat @ (self._gram @ self._transposed).reshape(size, -1, rows)
        normal[:, self._diagonal, self._diagonal] += self._free
        pulled = self._free * self._pull
        slope = (flat @ residual.reshape(size, -1, 1))[:, :, 0] - pulled
        factor = np.linalg.cholesky(normal)
        self._root = np.linalg.inv(factor)
        white = (self._root @ slope[:, :, None])[:, :, 0]
        self._step = (white[:, None, :] @ self._root)[:, 0]
        unexplained = self._square - np.sum(
            self.coefficients * (self._moments + residual), axis=(1, 2)
        )
        explained = np.sum(white * white, axis=1)
        misfit = unexplained + np.sum(pulled * self._pull, axis=1) - explained
        self.misfit = np.maximum(misfit, 0.0)
        share, scale = self.prior
        self.noises = (scale + 0.5 * self.misfit) / (share + 0.5 * self.count * self._n)
        spread = np.sum(np.log(factor[:, self._diagonal, self._diagonal]), axis=1)
        data = data_evidence(self.misfit, self.count * self._n, share, scale)
        self.evidence = self._prior - spread + data
        self.evidence[~self.weighed] = -np.inf
        if self.count < BENT_FROM:
            self.evidence[ACCELERATION] = -np.inf
        self.gain = np.where(self.rates > 0.0, explained / self.noises, 0.0)

    def noise(self) -> Noise:
        """Return the noise estimated by the likeliest family, as a prior for later motions.

        As many numbers as it has parameters are fitted exactly, and carry no information on noise.
        """
        best = int(np.argmax(self.evidence))
        left = 0.5 * (self.count * self._n - int(self._used[best].sum()))
        if left <= 0.0:
            return self.prior
        share, scale = self.prior.share + left, self.prior.scale + 0.5 * float(self.misfit[best])
        kept = min(share, RECALLED)
        return Noise(kept, kept * max(scale / share, LEAST))

    @property
    def fitted(self) -> Array:
        """Return the coefficients with the latest step applied, shape (K, 7, n)."""
        size, rows = self._step.shape
        step = (self._step[:, None, :] @ self._jacobian.reshape(size, rows, -1))[:, 0]
        return self.coefficients + step.reshape(self.coefficients.shape)

    def spread(self, rows: Array) -> Array:
        """Return the total variance of predictions at ``rows``, (K, 7), per unit of noise, (K,)."""
        size, count = self._step.shape
        moved = (rows[:, None, :] @ self._transposed).reshape(size, self._n, count)
        white = moved @ self._root.transpose(0, 2, 1)
        return np.sum(white * white, axis=(1, 2))


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
    share, scale = noises.T
    variance, n = scale / share, places.shape[1]
    rows = (times - times[0])[:, None] ** np.arange(3.0)
    seen = places - places[0]
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
    found += 0.5 * n * np.cumsum(spread, axis=1) + ODDS_ANEW
    return np.asarray(np.logaddexp.reduce(found, axis=1))


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
