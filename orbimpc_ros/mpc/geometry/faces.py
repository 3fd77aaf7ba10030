# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The faces of the paper's floor: a polygon in the disk, a Platonic solid in the ball.

Mathematics: docs/mathematics.md, 3.3.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed

_GOLDEN = (1.0 + 5.0**0.5) / 2.0


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
