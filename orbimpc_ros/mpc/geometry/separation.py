# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The half-space farthest from the origin that contains points, separating their hull from it.

Mathematics: docs/mathematics.md, 3.7.
"""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array

DEGENERATE = 1e-9  # distances from the origin that count as zero, relative to an edge's length


def separation(points: Array) -> tuple[Array, Array]:
    """Return for each set of points the unit normal n that maximises min_i n . P_i, and that value.

    If the origin is outside of the hull of the points, n is the direction to the nearest point of
    the hull, and the value its distance. That point is on an edge or, in space, on a face of the
    hull of two to four points: each of them proposes a normal. Points have the shape (..., m, n),
    m <= 4; normals (..., n), values (...).
    """
    proposed = _proposed(points)
    least = np.einsum('...cn,...mn->...cm', proposed, points).min(axis=-1)
    best = np.asarray(least.argmax(axis=-1))
    normals = np.take_along_axis(proposed, best[..., None, None], axis=-2)[..., 0, :]
    return normals, np.take_along_axis(least, best[..., None], axis=-1)[..., 0]


def _proposed(points: Array) -> Array:
    """Return a unit normal for every feature of the hulls, shape (..., C, n)."""
    if points.shape[-2] == 1:
        return _units(points, np.zeros_like(points))
    first, second = _corners(points.shape[-2], 2)
    begin, way = points[..., first, :], points[..., second, :] - points[..., first, :]
    squared = np.maximum(np.einsum('...n,...n->...', way, way), np.finfo(float).tiny)
    share = np.clip(-np.einsum('...n,...n->...', begin, way) / squared, 0.0, 1.0)
    on_edges = _units(begin + share[..., None] * way, way)
    if points.shape[-1] == 2 or points.shape[-2] < 3:
        return on_edges
    a, b, c = (points[..., each, :] for each in _corners(points.shape[-2], 3))
    across = _units(np.cross(b - a, c - a), a)
    return np.concatenate([on_edges, across, -across], axis=-2)


def _units(vectors: Array, references: Array) -> Array:
    """Return unit vectors, or vectors orthogonal to ``references`` in place of vanishing ones."""
    sizes = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unclear = sizes <= DEGENERATE * np.linalg.norm(references, axis=-1, keepdims=True)
    if unclear.any():
        vectors = np.where(unclear, _across(references), vectors)
        sizes = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(sizes, np.finfo(float).tiny))


def _across(vectors: Array) -> Array:
    """Return vectors orthogonal to others, shape (..., n)."""
    if vectors.shape[-1] == 2:
        return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)
    axis = np.eye(3)[np.abs(vectors).argmin(axis=-1)]
    return np.cross(vectors, axis)


@lru_cache(maxsize=8)
def _corners(count: int, size: int) -> list[list[int]]:
    """Return the first, second, ... corners of all edges (``size`` 2) or faces (3) of a hull."""
    return [list(each) for each in zip(*itertools.combinations(range(count), size), strict=True)]
