"""Shapes that a viewer draws: the hull and the floor around R e1, and a vehicle."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.spatial import HalfspaceIntersection

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.floors.faces import normals
from orbimpc_ros.mpc.problem import Floor

ROUND = 96  # corners of what is drawn for a circle
# A paper dart: nose, wing tips, and the keel that tells up from down.
NOSE, LEFT, RIGHT, TAIL, KEEL = (
    (0.6, 0.0, 0.0),
    (-0.4, 0.32, 0.08),
    (-0.4, -0.32, 0.08),
    (-0.3, 0.0, 0.08),
    (-0.4, 0.0, -0.16),
)
DART = np.array([NOSE, LEFT, TAIL, NOSE, TAIL, RIGHT, NOSE, TAIL, KEEL])  # three triangles
SHADES = np.array([[70, 140, 190], [0, 90, 150], [40, 60, 80]], dtype=np.uint8)  # one for each
DART_COLORS = np.repeat(SHADES, 3, axis=0)


def ring(radius: float) -> Array:
    """Return a closed circle in the plane z = 0, shape (97, 3)."""
    angles = np.linspace(0.0, 2.0 * np.pi, ROUND + 1)
    return radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])


def hull(dimension: int) -> list[Array]:
    """Return lines along the boundary of all R e1: the unit circle, or three of the ball's."""
    return [ring(1.0)] if dimension == 2 else globe(1.0)


def floor(dimension: int, limit: Floor) -> list[Array]:
    """Return lines, each of shape (K, 3), along the boundary of what a floor forbids."""
    if limit.shape == 'none':
        return []
    if limit.shape == 'circle':
        return [ring(limit.fraction)] if dimension == 2 else globe(limit.fraction)
    return edges(normals(dimension, limit.faces), limit.fraction)


def globe(radius: float) -> list[Array]:
    """Return three circles of a ball, one about each axis."""
    flat = ring(radius)
    return [np.roll(flat, shift, axis=1) for shift in range(3)]


def edges(outward: Array, distance: float) -> list[Array]:
    """Return the edges, shape (2, 3) each, of a polygon or solid.

    Args:
        outward: unit normals of its faces, shape (m, n).
        distance: of every face from the origin.
    """
    count, dimension = outward.shape
    faces = np.column_stack([outward, np.full(count, -distance)])
    corners = HalfspaceIntersection(faces, np.zeros(dimension)).intersections
    corners = np.unique(corners.round(9), axis=0)
    on = np.abs(corners @ outward.T - distance) < 1e-6
    padded = np.pad(corners, ((0, 0), (0, 3 - dimension)))
    return [
        padded[[a, b]]
        for a, b in itertools.combinations(range(len(corners)), 2)
        if (on[a] & on[b]).sum() >= dimension - 1
    ]
