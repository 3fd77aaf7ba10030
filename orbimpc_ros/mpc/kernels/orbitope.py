# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The 4x4 matrix S(R) whose positive semidefiniteness is conv SO(3), in machine code.

S(R) = I + K(R) with K linear onto the traceless symmetric matrices; K* is its adjoint for the
entrywise inner products. R is given by its nine entries, column by column.

Mathematics: docs/mathematics.md, 2.2.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import compiled


@compiled
def set_lmi(x, s):
    """Set S(R), the matrix of :func:`orbimpc_ros.mpc.geometry.orbitopes.lmi`.

    Args:
        x: R's entries column by column, shape (9,).
        s: to be set, shape (4, 4).
    """
    s[0, 0] = 1.0 + x[0] + x[4] + x[8]
    s[1, 1] = 1.0 + x[0] - x[4] - x[8]
    s[2, 2] = 1.0 - x[0] + x[4] - x[8]
    s[3, 3] = 1.0 - x[0] - x[4] + x[8]
    s[0, 1] = s[1, 0] = x[5] - x[7]
    s[0, 2] = s[2, 0] = x[6] - x[2]
    s[0, 3] = s[3, 0] = x[1] - x[3]
    s[1, 2] = s[2, 1] = x[1] + x[3]
    s[1, 3] = s[3, 1] = x[6] + x[2]
    s[2, 3] = s[3, 2] = x[5] + x[7]


@compiled
def add_adjoint(m, scale, out):
    """Add a multiple of K*(m), the adjoint of R's part of S(R).

    Args:
        m: symmetric, shape (4, 4).
        scale: of what is added.
        out: to be added to, shape (9,).
    """
    out[0] += scale * (m[0, 0] + m[1, 1] - m[2, 2] - m[3, 3])
    out[4] += scale * (m[0, 0] - m[1, 1] + m[2, 2] - m[3, 3])
    out[8] += scale * (m[0, 0] - m[1, 1] - m[2, 2] + m[3, 3])
    out[5] += scale * 2.0 * (m[0, 1] + m[2, 3])
    out[7] += scale * 2.0 * (m[2, 3] - m[0, 1])
    out[6] += scale * 2.0 * (m[0, 2] + m[1, 3])
    out[2] += scale * 2.0 * (m[1, 3] - m[0, 2])
    out[1] += scale * 2.0 * (m[0, 3] + m[1, 2])
    out[3] += scale * 2.0 * (m[1, 2] - m[0, 3])


@compiled
def set_pair(basis, i, j, out):
    """Set K* of the unit symmetric matrix that two columns of a basis span.

    Args:
        basis: orthonormal columns, shape (4, 4).
        i: of one column.
        j: of the other, or i.
        out: to be set, shape (9,).
    """
    scale = 1.0 if i == j else np.sqrt(2.0)
    a, b, c, d = basis[0, i], basis[1, i], basis[2, i], basis[3, i]
    p, q, r, s = basis[0, j] * scale, basis[1, j] * scale, basis[2, j] * scale, basis[3, j] * scale
    out[0] = a * p + b * q - c * r - d * s
    out[4] = a * p - b * q + c * r - d * s
    out[8] = a * p - b * q - c * r + d * s
    left, right = a * q + b * p, c * s + d * r
    out[5], out[7] = left + right, right - left
    left, right = a * r + c * p, b * s + d * q
    out[6], out[2] = left + right, right - left
    left, right = a * s + d * p, b * r + c * q
    out[1], out[3] = left + right, right - left
