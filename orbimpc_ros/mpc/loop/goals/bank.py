"""A forecast that fits the goal at hand: a bank of motions, each as likely as its evidence.

Mathematics: docs/mathematics.md, 7.4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.loop.goals import families
from orbimpc_ros.mpc.loop.goals.changes import Changes
from orbimpc_ros.mpc.loop.goals.families import CARRIER, DAMPED, NAMES, OSCILLATING, SWING, TURN
from orbimpc_ros.mpc.loop.goals.fits import Fits
from orbimpc_ros.mpc.loop.goals.spectrum import Spectrum
from orbimpc_ros.mpc.loop.observation import Sighting

MEMORY, KEPT = 768, 512  # sightings: as many as are remembered, and as survive when they are full
BELIEVED = 3  # sightings off the forecast, one after another, that are a new motion
GATE = 6.0  # standard deviations beyond which a sighting is off the forecast
AGILE = 5.0  # [m/s^2] acceleration that no motion foretells, yet a goal may have
SWINGS_FROM = 6  # sightings
NEGLIGIBLE = 1e-4  # share


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
        if not self._expected(sighting):
            self._apart.append(sighting)
            if len(self._apart) == BELIEVED:
                self._begin(self._apart)
            return
        self._apart = []
        self._append(sighting)
        self._refine()
        self._conclude()
        new = self._changes.found()
        if new:
            times, seen = self._times[self._count - new : self._count], self._seen[self._count - new : self._count]
            self._begin([Sighting(t + self._epoch, p + self._origin) for t, p in zip(times, seen)])
        elif self._count == MEMORY:
            self._shorten()

    def _begin(self, sightings: list[Sighting]) -> None:
        """Start afresh with the first sightings of a motion."""
        first = sightings[0]
        self._n = n = len(first.position)
        self._epoch, self._origin = first.time, np.array(first.position)
        self._times, self._seen = np.zeros(MEMORY), np.zeros((MEMORY, n))
        self._fits, self._spectrum, self._changes = Fits(n), Spectrum(n), Changes(n)
        self._count, self._turn, self._apart = 0, 0, []
        for each in sightings:
            self._append(each)
            self._conclude()

    def _append(self, sighting: Sighting) -> None:
        time, position = sighting.time - self._epoch, sighting.position - self._origin
        self._times[self._count], self._seen[self._count] = time, position
        self._count += 1
        self._fits.add(self._fits.rows(time), position)
        self._spectrum.add(np.array([time]), position[None])

    def _conclude(self) -> None:
        """Fit, and weigh the families."""
        self._fits.solve()
        best = self._fits.evidence.max()
        shares = np.exp(self._fits.evidence - best)
        total = shares.sum()
        self._shares = shares / total
        last = self._count - 1
        self._changes.note(self._times[last], self._seen[last], best + np.log(total))
        self._fitted: Array = self._fits.fitted
        self._covariances: Array | None = None

    def _past(self) -> tuple[Array, Array]:
        return self._times[: self._count], self._seen[: self._count]

    def _expected(self, sighting: Sighting) -> bool:
        """Return whether any motion that is likely at all has the goal near there."""
        time = sighting.time - self._epoch
        rows = self._fits.rows(time)
        off = (rows[:, None, :] @ self._fitted)[:, 0] - (sighting.position - self._origin)
        waited = sighting.time - self._last
        spread = self._fits.noises * (1.0 + self._fits.spread(rows))
        allowed = GATE**2 * (spread + (0.5 * AGILE * waited**2) ** 2)
        near = np.sum(off * off, axis=1) <= allowed
        return bool(np.any(near & (self._shares > 1e-2)))

    def _refine(self) -> None:
        """Improve one oscillation, or look for others: one a sighting, to bound its cost."""
        if self._count < SWINGS_FROM:
            return
        self._turn = (self._turn + 1) % (len(OSCILLATING) + 1)
        if self._turn == len(OSCILLATING) or not self._fits.known[SWING]:
            self._search()
        elif self._fits.known[OSCILLATING[self._turn]]:
            self._fits.move(OSCILLATING[self._turn], self._past())

    def _search(self) -> None:
        fits, past = self._fits, self._past()
        for family in (SWING, CARRIER):
            rate, misfit = self._spectrum.best(family == CARRIER)
            if not fits.known[family] or misfit < 0.9 * fits.misfit[family]:
                fits.place(family, rate, 0.0, np.zeros_like(fits.coefficients[family]), past)
        swing = self._fitted[SWING]
        if not swing.any():
            return
        for family in (DAMPED, TURN):
            if not fits.known[family] or fits.misfit[family] > 1.02 * fits.misfit[SWING]:
                start = families.circle(fits.coefficients[SWING]) if family == TURN else fits.coefficients[SWING]
                fits.place(family, fits.rates[SWING], 0.0, start, past)

    def _shorten(self) -> None:
        pass

    def at(self, times: Array) -> Array:
        """Return where the goal will be at ``times``, shape (N,) [s], as shape (N, n) [m]."""
        return self.predicted(times).positions

    def predicted(self, times: Array) -> Prediction:
        """Return where the goal will be at ``times``, shape (N,) [s], with covariances."""
        if self._covariances is None:
            self._covariances = self._fits.noises[:, None, None] * self._fits.covariances()
        used = np.flatnonzero(self._shares > NEGLIGIBLE)
        shares = self._shares[used] / self._shares[used].sum()
        x = families.columns(
            (times - self._epoch)[None],
            self._fits.rates[used, None],
            self._fits.dampings[used, None],
        )
        places = x @ self._fitted[used]
        pairs = (x[..., :, None] * x[..., None, :]).reshape(*x.shape[:2], -1)
        within = pairs @ self._covariances[used]
        mean = np.tensordot(shares, places, axes=1)
        off = places - mean
        between = np.einsum('k,kti,ktj->tij', shares, off, off)
        n = self._n
        covariances = np.tensordot(shares, within, axes=1).reshape(-1, n, n) + between
        model = NAMES[int(np.argmax(self._shares))]
        return Prediction(mean + self._origin, covariances, model)
