# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Faces of floors (polygons in the disk, Platonic solids in the ball) and their outlines.

Also patches of the sphere, into which branching divides directions.

Mathematics: docs/mathematics.md, 3.3 and 3.5.
"""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed

_GOLDEN = (1.0 + 5.0**0.5) / 2.0
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
    points = {6: _axes, 12: _icosahedron_vertices, 20: _dodecahedron_vertices}[faces]()
    return sealed(points / np.linalg.norm(points, axis=1, keepdims=True))


def _axes() -> Array:
    return np.concatenate([np.eye(3), -np.eye(3)])


def _icosahedron_vertices() -> Array:
    """Return the 12 vertices, which are the face normals of the dual dodecahedron."""
    plane = [(0.0, a, b * _GOLDEN) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
    return np.array([np.roll(p, shift) for shift in range(3) for p in plane])


def _dodecahedron_vertices() -> Array:
    """Return the 20 vertices, which are the face normals of the dual icosahedron."""
    signs = (-1.0, 1.0)
    cube = [(a, b, c) for a in signs for b in signs for c in signs]
    plane = [(0.0, a / _GOLDEN, b * _GOLDEN) for a in signs for b in signs]
    return np.array(cube + [tuple(np.roll(p, shift)) for shift in range(3) for p in plane])


@lru_cache(maxsize=1)
def icosahedron() -> Array:
    """Return the corners of the icosahedron's faces, shape (20, 3, 3)."""
    vertices = normals(3, 12)  # the dodecahedron's normals are the icosahedron's vertices
    # Faces are found by adjacency: ``normals(3, 20)`` belong to an icosahedron in another attitude.
    adjacent = vertices @ vertices.T > 0.0
    triples = itertools.combinations(range(len(vertices)), 3)
    faces = [
        vertices[[i, j, k]]
        for i, j, k in triples
        if adjacent[i, j] and adjacent[j, k] and adjacent[i, k]
    ]
    return sealed(np.array(faces))


# --- outlines, as lines to draw


def sphere(dimension: int, radius: float) -> Lines:
    """Return a closed circle (n = 2), or three around a ball (n = 3)."""
    angles = np.linspace(0.0, 2.0 * np.pi, ROUND + 1)
    circle = radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    return tuple(sealed(np.roll(circle, shift, axis=1)) for shift in range(2 * dimension - 3))


def edges(outward: Array, distances: Array) -> Lines:
    """Return the edges, shape (2, 3) each, of a polygon or solid.

    Args:
        outward: unit normals of its faces, shape (m, n).
        distances: of the faces from the origin, shape (m,).
    """
    dimension = outward.shape[1]
    corners = _corners(outward, distances)
    on = np.abs(corners @ outward.T - distances) < CLOSE
    padded = np.pad(corners, ((0, 0), (0, 3 - dimension)))
    return tuple(
        sealed(padded[[a, b]])
        for a, b in itertools.combinations(range(len(corners)), 2)
        if (on[a] & on[b]).sum() >= dimension - 1
    )


def _corners(outward: Array, distances: Array) -> Array:
    """Return the vertices: points where n faces meet, inside of all others, once each, (K, n)."""
    count, dimension = outward.shape
    chosen = np.array(list(itertools.combinations(range(count), dimension)), dtype=int)
    chosen = chosen.reshape(-1, dimension)
    chosen = chosen[np.abs(np.linalg.det(outward[chosen])) > CLOSE]
    points = np.linalg.solve(outward[chosen], distances[chosen][:, :, None])[:, :, 0]
    points = points[(points @ outward.T <= distances + CLOSE).all(axis=1)]
    _, first = np.unique(points.round(6), axis=0, return_index=True)
    return points[first]
