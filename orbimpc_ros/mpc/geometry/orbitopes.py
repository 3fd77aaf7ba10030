# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""The orbitopes conv SO(2) and conv SO(3): coordinates and membership.

A matrix R of conv SO(n) is held in the coordinates the programs optimise over:

- n = 2: :math:`R = [[a, -b], [b, a]]`, coordinates :math:`(a, b)`, :math:`\|R\|_F^2 = 2(a^2+b^2)`;
- n = 3: the nine entries column by column.

Either way the first n coordinates are the thrust axis :math:`R e_1`.

Mathematics: docs/mathematics.md, 2.1 to 2.3.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed

MEMBERSHIP_TOLERANCE = 1e-6  # how far outside conv SO(n) a rotation from a file may be rounded


def coordinate_count(n: int) -> int:
    """Return the number of coordinates of a matrix of conv SO(n)."""
    return 2 if n == 2 else 9


def frobenius_factor(n: int) -> float:
    """Return c with squared Frobenius norm = c * (sum of squared coordinates)."""
    return 2.0 if n == 2 else 1.0


def coordinates(matrix: Array) -> Array:
    """Return the coordinates, shape (..., 2) or (..., 9), of matrices of shape (..., n, n)."""
    if matrix.shape[-1] == 2:
        return matrix[..., :, 0]
    return np.swapaxes(matrix, -1, -2).reshape(*matrix.shape[:-2], 9)


def matrix(x: Array) -> Array:
    """Return the matrices, shape (..., n, n), of coordinates of shape (..., 2) or (..., 9)."""
    if x.shape[-1] == 2:
        r = np.empty((*x.shape[:-1], 2, 2))
        r[..., 0, 0] = r[..., 1, 1] = x[..., 0]
        r[..., 1, 0] = x[..., 1]
        r[..., 0, 1] = -x[..., 1]
        return r
    return np.swapaxes(x.reshape(*x.shape[:-1], 3, 3), -1, -2)


def lmi(x: Array) -> Array:
    """Return the paper's matrix, shape (4, 4), of coordinates (9,): PSD exactly on conv SO(3)."""
    x11, x21, x31, x12, x22, x32, x13, x23, x33 = x
    return np.array(
        [
            [1 + x11 + x22 + x33, x32 - x23, x13 - x31, x21 - x12],
            [x32 - x23, 1 + x11 - x22 - x33, x21 + x12, x13 + x31],
            [x13 - x31, x21 + x12, 1 - x11 + x22 - x33, x32 + x23],
            [x21 - x12, x13 + x31, x32 + x23, 1 - x11 - x22 + x33],
        ]
    )


@lru_cache(maxsize=1)
def lmi_parts() -> tuple[Array, Array]:
    """Return c, shape (16,), and A, shape (16, 9), of the affine map: lmi(x).ravel() = A x + c."""
    constant = lmi(np.zeros(9)).ravel()
    linear = np.column_stack([lmi(e).ravel() - constant for e in np.eye(9)])
    return sealed(constant), sealed(linear)


def margin(rotation: Array) -> Array:
    """Return by how much matrices of shape (..., n, n) lie inside conv SO(n), negative outside.

    n = 2: 1 - |(a, b)|. n = 3: the smallest eigenvalue of the 4x4 matrix, found from signed
    singular values s1 >= s2 >= |s3| alone (Sanyal, Sottile, Sturmfels, *Orbitopes*).
    """
    if rotation.shape[-1] == 2:
        return 1.0 - np.linalg.norm(rotation[..., :, 0], axis=-1)
    singular = np.linalg.svd(rotation, compute_uv=False)
    s1, s2 = singular[..., 0], singular[..., 1]
    s3 = singular[..., 2] * np.where(np.linalg.det(rotation) < 0.0, -1.0, 1.0)
    # The other three sign patterns never exceed this one when s1 >= s2 >= |s3|.
    return 1.0 - (s1 + s2 - s3)
