# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Cells: the half-spaces that a search chooses from, and how a round floor is cut ever finer.

Mathematics: docs/mathematics.md, 3.5.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.geometry.faces import normals

TOUCH = 1e-4  # [rad]
FINEST = 1e-6  # [rad] a patch this narrow allows less below its floor than rounding does
STEEPEST_CAP = 1.0  # [rad]: patches that share a corner are too long for a wider one
QUARTERS = 4  # of a circle: arcs, or triangles about +z, to begin with


@dataclass(frozen=True, eq=False)
class Cell:
    """A half-space normal . v >= offset.

    Attributes:
        normal: unit vector, shape (n,).
        offset: smallest value of normal . v.
    """

    normal: Array
    offset: float

    def parts(self) -> tuple[Cell, ...]:
        """Return smaller cells that together allow all that this one is there to allow."""
        return ()


@dataclass(frozen=True, eq=False)
class Patch(Cell):
    """The half-space beyond the chord of a patch of the sphere of radius ``floor``.

    It contains every v with |v| >= floor whose direction lies in the cone of the corners, and
    little else: what it allows below the floor vanishes with the square of the patch's size.

    Attributes:
        corners: directions, shape (n, n), one per row; two span an arc, three a triangle.
        floor: radius of the sphere.
    """

    corners: Array
    floor: float

    @classmethod
    def over(cls, corners: Array, floor: float) -> Patch:
        """Return the patch over the cone of corners, shape (n, n)."""
        # The direction that is equally near to all corners: M c = 1 for unit corners in M's rows.
        units = corners / np.linalg.norm(corners, axis=1, keepdims=True)
        centre = np.linalg.solve(units, np.ones(len(units)))
        centre /= np.linalg.norm(centre)
        return cls(sealed(centre), floor * float((units @ centre).min()), corners, floor)

    def parts(self) -> tuple[Patch, ...]:
        """Return the halves of an arc, or the four triangles between a triangle's midpoints.

        There are none of what is as fine as can be.
        """
        if np.ptp(self.corners, axis=0).max() < FINEST:
            return ()
        middles = 0.5 * (self.corners + np.roll(self.corners, -1, axis=0))
        if len(self.corners) == 2:
            a, b = self.corners
            middles /= np.linalg.norm(middles[0])  # halves of angles, not of chords
            pieces = [[a, middles[0]], [middles[0], b]]
        else:
            a, b, c = self.corners
            ab, bc, ca = middles
            pieces = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        return tuple(Patch.over(sealed(np.array(piece)), self.floor) for piece in pieces)


class Table(NamedTuple):
    """The cells of a planar floor as machine code takes them.

    Attributes:
        normals: unit vectors n of half-spaces n . v >= bound, shape (M, 2).
        bounds: shape (M,).
    """

    normals: Array
    bounds: Array


@lru_cache(maxsize=16)
def faces(count: int, bound: float) -> Table:
    """Return the faces of a regular polygon at a distance from the origin; none without faces."""
    return Table(normals(2, count), sealed(np.full(count, bound)))


@lru_cache(maxsize=16)
def round_cells(dimension: int, floor: float) -> tuple[Cell, ...]:
    """Return patches that together cover the sphere: four arcs, or the icosahedron's faces."""
    if dimension == 2:
        around = normals(2, 4)
        corners = [np.array([around[i], around[(i + 1) % 4]]) for i in range(4)]
    else:
        corners = list(icosahedron())
    return tuple(Patch.over(sealed(c), floor) for c in corners)


@lru_cache(maxsize=16)
def cap_cells(tilt: float, floor: float) -> tuple[Cell, ...]:
    """Return patches that together cover the sphere as far as an angle [rad] from +z."""
    return tuple(Patch.over(sealed(corners), floor) for corners in cap(tilt))


def cap(tilt: float) -> Array:
    """Return the corners of four triangles that cover a cap of the sphere, shape (4, 3, 3).

    They share the corner +z. Their outer sides touch the circle at an angle ``tilt`` from it [rad];
    they are a little wider, for rounding.
    """
    wide = math.atan(math.tan(tilt + TOUCH) / math.cos(math.pi / QUARTERS))
    around = 2.0 * np.pi * np.arange(QUARTERS + 1) / QUARTERS
    height = np.full(len(around), math.cos(wide))
    outer = np.column_stack(
        [math.sin(wide) * np.cos(around), math.sin(wide) * np.sin(around), height]
    )
    up = np.array([0.0, 0.0, 1.0])
    return np.array([[up, outer[i], outer[i + 1]] for i in range(QUARTERS)])


@lru_cache(maxsize=1)
def icosahedron() -> Array:
    """Return the corners of the icosahedron's faces, shape (20, 3, 3)."""
    vertices = normals(3, 12)  # the dodecahedron's normals are the icosahedron's vertices
    # Its faces are told by their vertices: ``normals(3, 20)`` belong to one turned against it.
    adjacent = vertices @ vertices.T > 0.0
    triples = itertools.combinations(range(len(vertices)), 3)
    faces = [
        vertices[[i, j, k]]
        for i, j, k in triples
        if adjacent[i, j] and adjacent[j, k] and adjacent[i, k]
    ]
    return sealed(np.array(faces))
