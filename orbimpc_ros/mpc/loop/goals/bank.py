"""A forecast that fits the goal at hand: a bank of motions, each as likely as its evidence.

Mathematics: docs/mathematics.md, 7.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.loop.goals import families
from orbimpc_ros.mpc.loop.goals.changes import Changes
from orbimpc_ros.mpc.loop.goals.families import CARRIER, DAMPED, NAMES, OSCILLATING, SWING, TURN
from orbimpc_ros.mpc.loop.goals.fits import UNKNOWN, Fits, Noise
from orbimpc_ros.mpc.loop.goals.spectrum import DRIFTING, FIXED, Spectrum
from orbimpc_ros.mpc.loop.observation import Sighting

MEMORY, KEPT = 768, 512  # sightings: as many as are remembered, and as survive when they are full
BELIEVED = 3  # sightings off the forecast, one after another, that are a new motion
GATE = 6.0  # standard deviations beyond which a sighting is off the forecast
AGILE = 5.0  # [m/s^2] acceleration that no motion foretells, yet a goal may have
SWINGS_FROM = 6  # sightings
LIKELY, NEGLIGIBLE = 1e-2, 1e-4  # shares
PATIENCE, MOST_TASKS = 0.35, 6  # [s] of waiting that one more task may be done for, and how many
STEPS = 4  # of Gauss-Newton on a closer look
WORTHWHILE = 0.01  # units of the noise that a move should gain


@dataclass(frozen=True)
class Prediction:
    """Where a goal will be, and how well that is known.

    Attributes:
        positions: shape (N, n) [m].
        covariances: shape (N, n, n) [m^2].
        model: the likeliest motion, one of ``families.NAMES``.
    """

    positions: Array
    covariances: Array
    model: str

    def __post_init__(self) -> None:
        sealed(self.positions)
        sealed(self.covariances)


class Bank:
    """Predicts a goal from its sightings by all families of motion at once."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget every sighting."""
        self._last: float | None = None
        self._apart: list[Sighting] = []
        self._count = 0

    def observe(self, sighting: Sighting) -> None:
        """Take in a sighting; one that is not finite, or not newer than the last, says nothing."""
        time, position = sighting.time, sighting.position
        if not (np.isfinite(time) and np.isfinite(position).all()):
            return
        if self._last is None or len(position) != self._n:
            self._begin([sighting])
        elif time > self._last:
            self._learn(sighting)
        else:
            return
        self._last = time

    def _learn(self, sighting: Sighting) -> None:
        rows = self._fits.rows(sighting.time - self._epoch)
        waited = sighting.time - self._last
        if not self._expected(sighting.position, rows, waited):
            self._apart.append(sighting)
            if len(self._apart) == BELIEVED:
                self._begin(self._apart, self._fits.noise())
            return
        self._apart = []
        self._append(sighting, rows)
        for _ in range(1 + min(int(waited / PATIENCE), MOST_TASKS)):
            self._refine()
        self._conclude()
        if self._count % 2 and self._changes.found():
            self._reconsider()
        if self._count == MEMORY:
            self._shorten()

    def _reconsider(self) -> None:
        """Start afresh with a new motion, unless an oscillation explains it on a closer look."""
        if self._count >= SWINGS_FROM and self._spectrum is not None:
            self._look_closely()
        new = self._changes.found()
        if new:
            self._begin(self._latest(new), self._changes.noise(new))

    def _look_closely(self) -> None:
        """Do at once what is otherwise done over many sightings."""
        self._read()
        self._seek_swing()
        self._seek_carrier()
        for _ in range(STEPS):
            self._conclude()
            for family in OSCILLATING:
                if self._fits.gain[family] > WORTHWHILE:
                    self._fits.move(family, self._past())
            self._seek_shapes()
        self._conclude()

    def _latest(self, count: int) -> list[Sighting]:
        times, seen = (each[-count:] for each in self._past())
        return [
            Sighting(float(time) + self._epoch, place + self._origin)
            for time, place in zip(times, seen, strict=True)
        ]

    def _begin(self, sightings: list[Sighting], noise: Noise = UNKNOWN) -> None:
        """Start afresh with the first sightings of a motion."""
        first = sightings[0]
        self._n = n = len(first.position)
        self._epoch, self._origin = first.time, np.array(first.position)
        self._times, self._seen = np.zeros(MEMORY), np.zeros((MEMORY, n))
        self._fits, self._changes = Fits(n, noise), Changes(n)
        self._spectrum: Spectrum | None = Spectrum(n)
        self._count, self._tasks, self._apart = 0, 0, []
        for each in sightings:
            self._append(each, self._fits.rows(each.time - self._epoch))
            self._conclude()

    def _append(self, sighting: Sighting, rows: Array) -> None:
        position = sighting.position - self._origin
        self._times[self._count], self._seen[self._count] = sighting.time - self._epoch, position
        self._count += 1
        self._fits.add(rows, position)
        self._changes.note(sighting.time - self._epoch, position)

    def _conclude(self) -> None:
        """Fit, and weigh the families."""
        self._fits.solve()
        best = self._fits.evidence.max()
        shares = np.exp(self._fits.evidence - best)
        total = shares.sum()
        self._shares = shares / total
        self._changes.weigh(best + math.log(total), self._fits.noise())
        self._fitted: Array = self._fits.fitted
        self._covariances: Array | None = None

    def _past(self) -> tuple[Array, Array]:
        return self._times[: self._count], self._seen[: self._count]

    def _expected(self, position: Array, rows: Array, waited: float) -> bool:
        """Return whether any motion that is likely at all has the goal near there.

        Args:
            position: seen [m].
            rows: columns of every family then, shape (K, 7).
            waited: since the last sighting [s].
        """
        off = (rows[:, None, :] @ self._fitted)[:, 0] - (position - self._origin)
        spread = self._fits.noises * (1.0 + self._fits.spread(rows))
        allowed = GATE**2 * (spread + (0.5 * AGILE * waited * waited) ** 2)
        near = np.sum(off * off, axis=1) <= allowed
        return bool(np.any(near & (self._shares > LIKELY)))

    def _refine(self) -> None:
        """Improve one oscillation, or look for others: one task a sighting, to bound its cost."""
        if self._count < SWINGS_FROM:
            return
        self._tasks += 1
        if self._tasks % 2 and self._spectrum is not None:
            (self._read, self._seek_swing, self._seek_carrier, self._seek_shapes)[
                self._tasks // 2 % 4
            ]()
        else:
            self._move()

    def _move(self) -> None:
        """Move the next oscillation whose fit would gain by it."""
        turn, fits = self._tasks // 2 % len(OSCILLATING), self._fits
        raw = [family for family in OSCILLATING if fits.known[family] > fits.weighed[family]]
        for family in (*raw, *OSCILLATING[turn:], *OSCILLATING[:turn]):
            if fits.gain[family] > WORTHWHILE:
                fits.move(family, self._past())
                return

    def _read(self) -> None:
        times, seen = self._past()
        begun = self._spectrum.count
        self._spectrum.add(times[begun:], seen[begun:])

    def _seek_swing(self) -> None:
        self._seek(SWING, FIXED)

    def _seek_carrier(self) -> None:
        self._seek(CARRIER, DRIFTING)

    def _seek(self, family: int, middle: int) -> None:
        rate, misfit = self._spectrum.best(middle)
        fits = self._fits
        if not fits.known[family] or misfit < 0.9 * fits.misfit[family]:
            fits.place(family, rate, 0.0, np.zeros_like(fits.coefficients[family]), self._past())

    def _seek_shapes(self) -> None:
        """Start what is a swing of another shape from the swing, where that fits better."""
        fits = self._fits
        swing = fits.coefficients[SWING]
        if not swing.any():
            return
        for family, start in ((DAMPED, swing), (TURN, families.circle(swing))):
            if not fits.known[family] or fits.misfit[family] > 1.02 * fits.misfit[SWING]:
                fits.place(family, fits.rates[SWING], 0.0, start, self._past())

    def _shorten(self) -> None:
        """Drop the oldest sightings; by now it is known what there is, and not searched for."""
        times, seen = (each[-KEPT:] for each in self._past())
        by = float(times[0])
        self._times[:KEPT], self._seen[:KEPT] = times - by, seen
        self._count, self._epoch, self._spectrum = KEPT, self._epoch + by, None
        self._changes = Changes(self._n)
        self._fits.begin_later(by, self._past())
        self._conclude()

    def at(self, times: Array) -> Array:
        """Return where the goal will be at ``times``, shape (N,) [s], as shape (N, n) [m]."""
        return self.predicted(times).positions

    def predicted(self, times: Array) -> Prediction:
        """Return where the goal will be at ``times``, shape (N,) [s], with covariances."""
        if self._covariances is None:
            self._used = np.flatnonzero(self._shares > NEGLIGIBLE)
            self._covariances = self._fits.covariances(self._used)
        used = self._used
        shares = self._shares[used] / self._shares[used].sum()
        x = families.columns(
            (times - self._epoch)[None],
            self._fits.rates[used, None],
            self._fits.dampings[used, None],
        )
        places = x @ self._fitted[used]
        pairs = (x[..., :, None] * x[..., None, :]).reshape(*x.shape[:2], -1)
        mean = np.tensordot(shares, places, axes=1)
        off = places - mean
        between = (shares[:, None, None, None] * off[..., :, None] * off[..., None, :]).sum(axis=0)
        within = np.tensordot(shares, pairs @ self._covariances, axes=1)
        return Prediction(
            mean + self._origin,
            within.reshape(between.shape) + between,
            NAMES[int(np.argmax(self._shares))],
        )
