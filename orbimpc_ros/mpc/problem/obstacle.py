"""Obstacles: sets of positions to stay outside of.

Mathematics: docs/mathematics.md, 3.7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array, ByContent, frozen
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.cells import Cell


@dataclass(frozen=True, eq=False)
class Box(ByContent):
    """An axis-aligned obstacle that every s_k, k = 1..N, stays outside of.

    Attributes:
        minimum: lower corner, shape (n,) [m].
        maximum: upper corner, shape (n,) [m], above ``minimum`` in every axis.
    """

    minimum: Array
    maximum: Array

    def __post_init__(self) -> None:
        shape = np.shape(self.minimum)
        object.__setattr__(self, 'minimum', frozen(self.minimum, shape, 'obstacles.min'))
        object.__setattr__(self, 'maximum', frozen(self.maximum, shape, 'obstacles.max'))
        if not np.all(self.minimum < self.maximum):
            raise BadInput('obstacles.max', self.maximum.tolist(), f'above {self.minimum.tolist()}')

    @property
    def dimension(self) -> int:
        """Return n."""
        return len(self.minimum)

    def scaled(self, factor: float) -> Box:
        """Return the box in units in which lengths are ``factor`` times as large."""
        return Box(self.minimum * factor, self.maximum * factor)

    def cells(self) -> tuple[Cell, ...]:
        """Return the half-spaces beyond its faces: outside is in at least one of them."""
        axes = np.eye(self.dimension)
        below = (Cell(-axis, -low) for axis, low in zip(axes, self.minimum, strict=True))
        above = (Cell(axis, high) for axis, high in zip(axes, self.maximum, strict=True))
        return (*below, *above)

    def clearances(self, points: Array) -> Array:
        """Return how far points, shape (K, n), are beyond each face, shape (K, 2 n) [m]."""
        return np.concatenate([self.minimum - points, points - self.maximum], axis=1)

    def depth(self, points: Array) -> Array:
        """Return how deep points, shape (K, n), are inside [m]; <= 0 outside."""
        return -self.clearances(points).max(axis=1)
