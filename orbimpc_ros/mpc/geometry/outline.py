"""The outline of a floor in the space of R e1, as lines to draw."""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.problem import Floor

ROUND = 96  # corners of what is drawn for a circle
CLOSE = 1e-9


@lru_cache(maxsize=64)
def outline(dimension: int, floor: Floor) -> tuple[Array, ...]:
    """Return lines, shape (K, 3) each, along the boundary of what a floor forbids.

    The edges of its polygon or solid; a circle; of a ball three circles. In the plane z is zero.
    """
    if floor.shape == 'none':
        return ()
    if floor.shape == 'circle':
        return sphere(dimension, floor.fraction)
    return _edges(normals(dimension, floor.faces), floor.fraction)


def sphere(dimension: int, radius: float) -> tuple[Array, ...]:
    """Return a closed circle (n = 2), or three around a ball (n = 3)."""
    angles = np.linspace(0.0, 2.0 * np.pi, ROUND + 1)
    circle = radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    return tuple(sealed(np.roll(circle, shift, axis=1)) for shift in range(2 * dimension - 3))


def _edges(outward: Array, distance: float) -> tuple[Array, ...]:
    """Return the edges, shape (2, 3) each, of a polygon or solid.

    Args:
        outward: unit normals of its faces, shape (m, n).
        distance: of every face from the origin.
    """
    dimension = outward.shape[1]
    corners = _corners(outward, distance)
    on = np.abs(corners @ outward.T - distance) < CLOSE
    padded = np.pad(corners, ((0, 0), (0, 3 - dimension)))
    return tuple(
        sealed(padded[[a, b]])
        for a, b in itertools.combinations(range(len(corners)), 2)
        if (on[a] & on[b]).sum() >= dimension - 1
    )


def _corners(outward: Array, distance: float) -> Array:
    """Return where n faces meet and none is passed, shape (K, n), each once."""
    count, dimension = outward.shape
    chosen = outward[list(itertools.combinations(range(count), dimension))]
    chosen = chosen[np.abs(np.linalg.det(chosen)) > CLOSE]
    points = np.linalg.solve(chosen, np.full((len(chosen), dimension, 1), distance))[:, :, 0]
    points = points[(points @ outward.T <= distance + CLOSE).all(axis=1)]
    _, first = np.unique(points.round(6), axis=0, return_index=True)
    return points[first]
