# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Cells: half-spaces that a floor is made of, and the patches that directions are cut into.

Mathematics: docs/mathematics.md, 3.5.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.geometry.faces import normals

TOUCH = 1e-4  # [rad]
STEEPEST_CAP = 1.0  # [rad]: patches that share a corner are too long for a wider one
QUARTERS = 4  # triangles about +z, to begin with


@dataclass(frozen=True, eq=False)
class Cell:
    """A half-space normal . v >= offset.

    Attributes:
        normal: unit vector, shape (n,).
        offset: smallest value of normal . v.
    """

    normal: Array
    offset: float


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
