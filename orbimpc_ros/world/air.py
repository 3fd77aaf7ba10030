"""The air that a vehicle flies through: a steady wind, and gusts from a seed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array, frozen, sealed, within

SAMPLE = 0.02  # [s] between samples of a gust; straight lines between them
BLOCK = 1024  # samples drawn at a time
GUSTS = 2  # of what a seed is used for; world.faults has 0 and 1
AIR_RANGES: dict[str, tuple[float, float]] = {  # by attribute
    'gust': (0.0, 1e3),
    'gust_time': (0.1, 1e3),
    'seed': (0, 2**31 - 1),
}


@dataclass(frozen=True)
class Air:
    """A wind, the same everywhere, that changes with time alone.

    A gust is a first-order Gauss-Markov process along each axis: its standard deviation is
    ``gust``, its correlation exp(-t/gust_time). It depends on the time since the start alone: the
    same seed brings the same gusts to whatever flies.

    Attributes:
        wind: steady, in the world frame, shape (n,): a velocity [m/s] at translation order 1, an
            acceleration [m/s^2] at order 2.
        gust: standard deviation of what comes on top, along each axis, in the same unit.
        gust_time: correlation time of the gusts [s].
        seed: of the gusts.
    """

    wind: Array
    gust: float = 0.0
    gust_time: float = 3.0
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, 'wind', frozen(self.wind, (len(self.wind),), 'wind'))
        within(self, AIR_RANGES)

    def at(self, elapsed: float) -> Array:
        """Return the wind, shape (n,), at a time since the start [s]."""
        if not self.gust:
            return self.wind
        index = elapsed / SAMPLE
        before = math.floor(index)
        share = index - before
        return self.wind + self.gust * (
            (1.0 - share) * self._sample(before) + share * self._sample(before + 1)
        )

    def _sample(self, index: int) -> Array:
        number, place = divmod(index, BLOCK)
        sample: Array = _block(self.seed, len(self.wind), self.gust_time, number)[place]
        return sample


def still(dimension: int) -> Air:
    """Return air that does not move, in the plane (2) or in space (3)."""
    return Air(np.zeros(dimension))


@lru_cache(maxsize=64)
def _block(seed: int, dimension: int, memory: float, number: int) -> Array:
    """Return gusts of unit deviation, shape (BLOCK, n), that go on from the block before."""
    rng = np.random.default_rng((seed, GUSTS, number))
    kept = math.exp(-SAMPLE / memory)
    fresh = math.sqrt(1.0 - kept * kept)
    samples = rng.normal(size=(BLOCK, dimension))  # the very first is a stationary one
    if number:
        before = _block(seed, dimension, memory, number - 1)[-1]
        samples[0] = kept * before + fresh * samples[0]
    for k in range(1, BLOCK):
        samples[k] = kept * samples[k - 1] + fresh * samples[k]
    return sealed(samples)
