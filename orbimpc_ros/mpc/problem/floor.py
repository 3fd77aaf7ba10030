# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Floors: the minimum speed of a vehicle, as the set of allowed thrust axes R e1.

A shape is a function that returns the normals of half-spaces whose union is allowed, registered
under the word that selects it; the round floor has none. Methods, the check, safe commands,
parameters and drawings use nothing else; methods that are faster for some shapes select them.

Mathematics: docs/mathematics.md, 3.3 and 3.4.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array, number, whole, word
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.faces import Lines, edges, normals, sphere
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED

SOLID_FACES = (6, 12, 20)  # cube, dodecahedron, icosahedron
MAX_FACES = 64

# Functions of dimension and number of faces that return unit normals, shape (m, n).
SHAPES: dict[str, Callable[[int, int], Array] | None] = {
    'none': None,
    'polygon': normals,
    'circle': None,
}
PARAMETERS = {'none': (), 'polygon': ('faces', 'fraction')}  # other shapes: the fraction only


@dataclass(frozen=True)
class Floor:
    """Minimum speed: the set of allowed thrust axes v = R_k e1, k = 1..N.

    Attributes:
        shape: ``none``; ``polygon``, the paper's: v beyond one of the faces of a regular polygon (n
            = 2) or solid (n = 3); ``circle``, the true floor |v| >= fraction; or another word
            registered in ``SHAPES``: normal . v >= fraction for at least one of its normals.
        faces: number of faces of the polygon (>= 3) or of the solid (6, 12 or 20).
        fraction: of full speed, in (0, 1]. The paper's det R > 0.3 is sqrt(0.3) for n = 2.
    """

    shape: str = 'none'
    faces: int = 4
    fraction: float = math.sqrt(0.3)

    def __post_init__(self) -> None:
        word(self.shape, 'floor.shape', SHAPES)
        whole(self.faces, 'floor.faces', 3, MAX_FACES)
        number(self.fraction, 'floor.fraction', 0.0, 1.0, above=True)

    def validate(self, dimension: int) -> None:
        """Refuse polygons: solids that do not exist, and faces that leave gaps.

        Raises:
            BadInput: naming the parameter at fault.
        """
        if dimension == 3 and self.faces not in SOLID_FACES:
            raise BadInput('floor.faces', self.faces, '6, 12 or 20 when dimension is 3')
        limit = largest_fraction(dimension, self.faces)
        if self.fraction > limit:
            allowed = f'at most {limit:.6g} with floor.faces {self.faces}'
            raise BadInput('floor.fraction', self.fraction, allowed)

    @cached_property
    def exists(self) -> bool:
        """Return True if there is a minimum speed."""
        return self.shape != 'none'

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the fields that the shape uses."""
        return PARAMETERS.get(self.shape, ('fraction',))

    @property
    def radius(self) -> float:
        """Return the radius of a round floor; 0 for other shapes and without a floor."""
        return self.fraction if self.shape == 'circle' else 0.0

    def normals(self, dimension: int) -> Array | None:
        """Return the unit normals of the half-spaces, shape (m, n); None for a round floor."""
        made = SHAPES[self.shape]
        return made(dimension, self.faces) if made else None

    def tangent(self, headings: Array) -> Array:
        """Return the unit normals of the half-spaces that headings, shape (..., n), violate least.

        They are bounded by one of the faces, or touch a round floor.
        """
        outward = self.normals(headings.shape[-1])
        if outward is None:
            sizes = np.linalg.norm(headings, axis=-1, keepdims=True)
            return np.asarray(headings / np.maximum(sizes, HEADING_UNDEFINED))
        return np.asarray(outward[(headings @ outward.T).argmax(axis=-1)])

    def margin(self, axes: Array) -> Array:
        """Return the margins of axes, shape (..., n), above the floor, shape (...,); < 0 below."""
        if not self.exists:
            return np.full(axes.shape[:-1], np.inf)
        return self._along(axes) - self.fraction

    def least(self, axes: Array) -> Array:
        """Return the least speed fraction allowed along unit vectors, shape (..., n): shape (...).

        It is 1, full speed, along directions in which no speed is allowed.
        """
        if not self.exists or self.radius:
            return np.full(axes.shape[:-1], self.radius)[()]
        slopes = self._along(axes)
        return np.divide(self.fraction, slopes, out=np.ones_like(slopes), where=slopes > 0.0)[()]

    def _along(self, axes: Array) -> Array:
        """Return |v| or the largest normal . v of axes v, bounded by the floor, shape (...,)."""
        outward = self.normals(axes.shape[-1])
        return np.linalg.norm(axes, axis=-1) if outward is None else (axes @ outward.T).max(axis=-1)

    def circling(self, dimension: int) -> float:
        """Return a speed fraction that is allowed in every direction: the least one, or full speed.

        For a polygon it is the distance of its corners, half-way between two faces.
        """
        if self.shape == 'polygon':
            return min(1.0, self.fraction / largest_fraction(dimension, self.faces))
        return self.radius or 1.0

    def outline(self, dimension: int) -> Lines:
        """Return polylines, shape (K, 3) each, along the boundary of the forbidden region."""
        return _outline(self, dimension)

    def __str__(self) -> str:
        return f'polygon of {self.faces} faces' if self.shape == 'polygon' else self.shape


@lru_cache(maxsize=64)
def _outline(floor: Floor, dimension: int) -> Lines:
    if floor.radius:
        return sphere(dimension, floor.radius)
    outward = floor.normals(dimension)
    return () if outward is None else edges(outward, np.full(len(outward), floor.fraction))


def largest_fraction(dimension: int, faces: int) -> float:
    """Return the largest fraction whose polygon or solid still lies inside the unit ball.

    It is the ratio of inscribed to circumscribed sphere: cos(pi/m) for a polygon of m faces. Above
    it the faces leave gaps and the union of half-spaces no longer surrounds the forbidden region.
    """
    if dimension == 2:
        return math.cos(math.pi / faces)
    return 1.0 / math.sqrt(3.0) if faces == 6 else math.sqrt((5.0 + 2.0 * math.sqrt(5.0)) / 15.0)
