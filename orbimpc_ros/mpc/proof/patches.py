# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Patches of a sphere: triangles, and the four that each is split into at the middles of its edges.

Mathematics: docs/mathematics.md, 3.5, and docs/proofs.md.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import compiled

FINEST = 26  # splits of a triangle; what is as fine is a point


@compiled
def _set_middle(a, b, middle):
    """Set the direction in the middle of two."""
    square = 0.0
    for c in range(3):
        middle[c] = a[c] + b[c]
        square += middle[c] * middle[c]
    for c in range(3):
        middle[c] /= np.sqrt(square)


@compiled
def set_corners(patches, level, side, corners):
    """Set the corners of a patch.

    Args:
        patches: corners of those that were not split, shape (M, 3, 3).
        level: how often they were split.
        side: which of the parts it is then: those of part i are 4 i to 4 i + 3, that at each corner
            and the one in the middle.
        corners: to be set, shape (3, 3).
    """
    middles = np.empty((3, 3))  # between each corner and the next
    corners[:] = patches[side >> (2 * level)]
    for at in range(level - 1, -1, -1):
        part = (side >> (2 * at)) & 3
        for i in range(3):
            _set_middle(corners[i], corners[(i + 1) % 3], middles[i])
        if part == 3:
            corners[:] = middles
            continue
        for i in range(3):
            if i == (part + 1) % 3:
                corners[i] = middles[part]
            elif i != part:
                corners[i] = middles[i]


@compiled
def set_patch(patches, level, side, normal):
    """Set the direction as far from each corner of a patch; return the cosine of how far.

    No direction of the patch is farther from it than that.
    """
    corners, square = np.empty((3, 3)), 0.0
    set_corners(patches, level, side, corners)
    a, b, c = corners
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        normal[i] = (b[j] - a[j]) * (c[k] - a[k]) - (b[k] - a[k]) * (c[j] - a[j])
        square += normal[i] * normal[i]
    along = normal[0] * a[0] + normal[1] * a[1] + normal[2] * a[2]
    for i in range(3):
        normal[i] /= np.sqrt(square) if along > 0.0 else -np.sqrt(square)
    nearest = 1.0
    for corner in corners:
        along = corner[0] * normal[0] + corner[1] * normal[1] + corner[2] * normal[2]
        nearest = min(nearest, along)
    return nearest
