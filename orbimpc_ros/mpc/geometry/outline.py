# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Outlines of sets in the space of R e1, as lines to draw."""

from __future__ import annotations

import itertools

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed

ROUND = 96  # corners of what is drawn for a circle
CLOSE = 1e-9

Lines = tuple[Array, ...]


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
    """Return where n faces meet and none is passed, shape (K, n), each once."""
    count, dimension = outward.shape
    chosen = np.array(list(itertools.combinations(range(count), dimension)), dtype=int)
    chosen = chosen.reshape(-1, dimension)
    chosen = chosen[np.abs(np.linalg.det(outward[chosen])) > CLOSE]
    points = np.linalg.solve(outward[chosen], distances[chosen][:, :, None])[:, :, 0]
    points = points[(points @ outward.T <= distances + CLOSE).all(axis=1)]
    _, first = np.unique(points.round(6), axis=0, return_index=True)
    return points[first]
