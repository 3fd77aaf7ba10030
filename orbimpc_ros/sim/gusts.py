# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Gusts: what changes with time in the wind that a vehicle flies through, from a seed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed, within

SAMPLE = 0.02  # [s] between samples; straight lines between them
BLOCK = 1024  # samples drawn at a time
USE = 2  # what of a seed is used; world.faults uses 0 and 1
GUST_RANGES: dict[str, tuple[float, float]] = {  # by attribute
    'deviation': (0.0, 1e3),
    'memory': (0.1, 1e3),
    'seed': (0, 2**31 - 1),
}


@dataclass(frozen=True)
class Gusts:
    """A first-order Gauss-Markov process along each axis, the same everywhere.

    Its correlation after t is exp(-t/memory). It depends on the time since the start alone: a seed
    brings the same gusts to whatever flies.

    Attributes:
        deviation: standard deviation along each axis [m/s], or [m/s^2] at translation order 2.
        memory: correlation time [s].
        seed: of all chances.
    """

    deviation: float = 0.0
    memory: float = 3.0
    seed: int = 0

    def __post_init__(self) -> None:
        within(self, GUST_RANGES, 'gusts.')

    def at(self, elapsed: float, dimension: int) -> Array:
        """Return the gust, shape (n,), at a time since the start [s]."""
        index = elapsed / SAMPLE
        before = math.floor(index)
        share = index - before
        earlier, later = (self._sample(k, dimension) for k in (before, before + 1))
        gust: Array = self.deviation * ((1.0 - share) * earlier + share * later)
        return gust

    def _sample(self, index: int, dimension: int) -> Array:
        number, place = divmod(index, BLOCK)
        sample: Array = _block(self.seed, dimension, self.memory, number)[place]
        return sample


@lru_cache(maxsize=64)
def _block(seed: int, dimension: int, memory: float, number: int) -> Array:
    """Return gusts of unit deviation, shape (BLOCK, n), that go on from the block before."""
    rng = np.random.default_rng((seed, USE, number))
    kept = math.exp(-SAMPLE / memory)
    fresh = math.sqrt(1.0 - kept * kept)
    samples = rng.normal(size=(BLOCK, dimension))  # the very first is a stationary one
    if number:
        before = _block(seed, dimension, memory, number - 1)[-1]
        samples[0] = kept * before + fresh * samples[0]
    for k in range(1, BLOCK):
        samples[k] = kept * samples[k - 1] + fresh * samples[k]
    return sealed(samples)
