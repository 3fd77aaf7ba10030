# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Faces of floors (polygons in the disk, Platonic solids in the ball) and their outlines.

Also patches of the sphere, into which branching divides directions.

Mathematics: docs/mathematics.md, 3.3 and 3.5.
"""

from __future__ import annotations

import itertools
import math
from functools import lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed

GOLDEN = (1.0 + 5.0**0.5) / 2.0
# Face normals of cube, dodecahedron and icosahedron, up to signs, cyclic shifts and their size.
SOLIDS = {6: [(0.0, 0.0, 1.0)], 12: [(0.0, 1.0, GOLDEN)],
          20: [(1.0, 1.0, 1.0), (0.0, 1.0 / GOLDEN, GOLDEN)]}  # fmt: skip
TOUCH = 1e-4  # [rad]
STEEPEST_CAP = 1.0  # [rad]: for a wider cap, patches that share a corner would be too long
QUARTERS = 4  # initial triangles about +z
ROUND = 96  # corners of the polygon that is drawn for a circle
CLOSE = 1e-9

Lines = tuple[Array, ...]


@lru_cache(maxsize=64)
def normals(dimension: int, faces: int) -> Array:
    """Return the unit outward normals of the faces, shape (faces, dimension).

    n = 2: at angles 2 pi i / m. n = 3: of the cube (6), the dodecahedron (12) or the
    icosahedron (20).
    """
    if dimension == 2:
        angles = 2.0 * np.pi * np.arange(faces) / faces
        return sealed(np.column_stack([np.cos(angles), np.sin(angles)]))
    signs = np.array([*itertools.product((-1.0, 1.0), repeat=3)])
    points = [np.roll(signs * p, k, axis=1) for p in SOLIDS[faces] for k in range(3)]
    once = dict.fromkeys(map(tuple, np.vstack(points).tolist()))  # -0.0 is the same key as 0.0
    vectors = np.array([*once]) + 0.0
    return sealed(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


@lru_cache(maxsize=8)
def cap(tilt: float) -> Array:
    """Return the corners of four triangles that cover a cap of the sphere, shape (4, 3, 3).

    They share the corner +z. Their outer sides touch the circle at an angle ``tilt`` from it [rad],
    enlarged by a margin for rounding.
    """
    wide = math.atan(math.tan(tilt + TOUCH) / math.cos(math.pi / QUARTERS))
    around = 2.0 * np.pi * np.arange(QUARTERS + 1) / QUARTERS
    height = np.full(len(around), math.cos(wide))
    outer = np.column_stack(
        [math.sin(wide) * np.cos(around), math.sin(wide) * np.sin(around), height]
    )
    up = np.array([0.0, 0.0, 1.0])
    return sealed(np.array([[up, outer[i], outer[i + 1]] for i in range(QUARTERS)]))


@lru_cache(maxsize=1)
def icosahedron() -> Array:
    """Return the corners of the icosahedron's faces, shape (20, 3, 3)."""
    # The dodecahedron's normals are the icosahedron's vertices: three meet in a corner of the one,
    # and span a face of the other. ``normals(3, 20)`` are of an icosahedron in another attitude.
    vertices = normals(3, 12)
    return sealed(vertices[_meeting(vertices, np.ones(len(vertices)))[0]])


# --- outlines, as lines to draw


def sphere(dimension: int, radius: float) -> Lines:
    """Return a closed circle (n = 2), or three around a ball (n = 3)."""
    angles = np.linspace(0.0, 2.0 * np.pi, ROUND + 1)
    circle = radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    return tuple(sealed(np.roll(circle, shift, axis=1)) for shift in range(2 * dimension - 3))


def edges(outward: Array, distances: Array) -> Lines:
    """Return the edges, shape (2, 3), of a polygon or solid, given its faces' unit normals, (m, n).

    The distances of the faces are from the origin, shape (m,).
    """
    dimension = outward.shape[1]
    points = _meeting(outward, distances)[1]
    _, first = np.unique(points.round(6), axis=0, return_index=True)
    corners = points[first]
    on = np.abs(corners @ outward.T - distances) < CLOSE
    padded = np.pad(corners, ((0, 0), (0, 3 - dimension)))
    return tuple(
        sealed(padded[[a, b]])
        for a, b in itertools.combinations(range(len(corners)), 2)
        if (on[a] & on[b]).sum() >= dimension - 1
    )


def _meeting(outward: Array, distances: Array) -> tuple[np.ndarray, Array]:
    """Return which n faces meet inside of all others, shape (K, n), and where, shape (K, n)."""
    count, dimension = outward.shape
    chosen = np.array(list(itertools.combinations(range(count), dimension)), dtype=int)
    chosen = chosen.reshape(-1, dimension)
    chosen = chosen[np.abs(np.linalg.det(outward[chosen])) > CLOSE]
    points = np.linalg.solve(outward[chosen], distances[chosen][:, :, None])[:, :, 0]
    inside = (points @ outward.T <= distances + CLOSE).all(axis=1)
    return chosen[inside], points[inside]
