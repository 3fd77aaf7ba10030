# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Small dense linear algebra in machine code."""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import compiled, vectorised

SINGULAR = 1e-13  # a pivot no larger than this share of its diagonal entry counts as zero, and NaN
DIAGONAL = 1e-32  # squared relative norm of negligible off-diagonal entries
SWEEPS = 12
REFUTED = 1e-9  # least value of a proof of infeasibility, relative to the terms that cancel


@compiled
def copy_to(target, source):
    """Copy the numbers of an array to another one of the same shape.

    For an assignment numba would also compile the message that their shapes differ.
    """
    for i in range(source.size):
        target.flat[i] = source.flat[i]


@compiled
def add_product(matrix, x, share, out):
    """Add a share of the product of a matrix and points.

    Args:
        matrix: shape (N, N).
        x: points, shape (N, n).
        share: of the product.
        out: to be added to, shape (N, n).
    """
    for j in range(len(x)):
        for c in range(x.shape[1]):
            total = 0.0
            for k in range(len(x)):
                total += matrix[j, k] * x[k, c]
            out[j, c] += share * total


@compiled
def largest(matrix):
    """Return the largest magnitude of an entry."""
    most = 0.0
    for row in matrix:
        for each in row:
            most = max(most, abs(each))
    return most


@compiled
def set_basis(by):
    """Set an orthonormal basis about the vector in the first row, e_1 if it is zero; (n, n)."""
    square = 0.0
    for c in range(len(by)):
        square += by[0, c] * by[0, c]
    size = np.sqrt(square)
    if size == 0.0:
        by[0, 0] = size = 1.0
    for c in range(len(by)):
        by[0, c] /= size
    if len(by) == 2:
        by[1, 0], by[1, 1] = -by[0, 1], by[0, 0]
        return
    i = 0
    for c in range(1, 3):
        if abs(by[0, c]) < abs(by[0, i]):
            i = c
    j, k = (i + 1) % 3, (i + 2) % 3
    size = np.sqrt(by[0, j] ** 2 + by[0, k] ** 2)
    by[1, i], by[1, j], by[1, k] = 0.0, -by[0, k] / size, by[0, j] / size
    for c in range(3):
        d, e = (c + 1) % 3, (c + 2) % 3
        by[2, c] = by[0, d] * by[1, e] - by[0, e] * by[1, d]


@vectorised
def _factorise(matrix, count):
    """Factorise the lower triangle by Cholesky, with inverted diagonal; return False if singular.

    It takes two rows and columns at a time, so that every loaded number serves two sums.

    Args:
        matrix: symmetric, its lower triangle given, shape (count, count) at least.
        count: number of its rows.
    """
    for i in range(0, count - 1, 2):
        for j in range(0, i, 2):
            a, b, c, d = matrix[i, j], matrix[i, j + 1], matrix[i + 1, j], matrix[i + 1, j + 1]
            for k in range(j):
                upper, lower = matrix[i, k], matrix[i + 1, k]
                left, right = matrix[j, k], matrix[j + 1, k]
                a -= upper * left
                b -= upper * right
                c -= lower * left
                d -= lower * right
            a, c = a * matrix[j, j], c * matrix[j, j]
            matrix[i, j], matrix[i + 1, j] = a, c
            matrix[i, j + 1] = (b - a * matrix[j + 1, j]) * matrix[j + 1, j + 1]
            matrix[i + 1, j + 1] = (d - c * matrix[j + 1, j]) * matrix[j + 1, j + 1]
        a, c, d = matrix[i, i], matrix[i + 1, i], matrix[i + 1, i + 1]
        for k in range(i):
            upper, lower = matrix[i, k], matrix[i + 1, k]
            a -= upper * upper
            c -= lower * upper
            d -= lower * lower
        if not a > SINGULAR * matrix[i, i]:
            return False
        matrix[i, i] = 1.0 / np.sqrt(a)
        matrix[i + 1, i] = c = c * matrix[i, i]
        if not d - c * c > SINGULAR * matrix[i + 1, i + 1]:
            return False
        matrix[i + 1, i + 1] = 1.0 / np.sqrt(d - c * c)
    return count % 2 == 0 or extend_factor(matrix, matrix, count - 1, count)


@vectorised
def extend_factor(matrix, factor, first, count):
    """Set the rows of Cholesky's factor from ``first`` on, diagonal inverted; False if singular.

    Rows before it are kept: an additional row costs no more than a solve.

    Args:
        matrix: symmetric, its lower triangle given, shape (count, count) at least.
        factor: of the same shape; may be the matrix itself.
        first: index of the first row to set.
        count: number of its rows.
    """
    for i in range(first, count):
        for j in range(i):
            value = matrix[i, j]
            for k in range(j):
                value -= factor[i, k] * factor[j, k]
            factor[i, j] = value * factor[j, j]
        value = matrix[i, i]
        for k in range(i):
            value -= factor[i, k] * factor[i, k]
        if not value > SINGULAR * matrix[i, i]:
            return False
        factor[i, i] = 1.0 / np.sqrt(value)
    return True


@vectorised
def solve_factored(factor, right, count):
    """Solve with Cholesky's factor in place; return |L^-1 right|^2.

    Args:
        factor: its diagonal inverted, shape (count, count) at least.
        right: shape (count,) at least; becomes the solution.
        count: number of rows of the system.
    """
    square = 0.0
    for i in range(count):
        value = right[i]
        for k in range(i):
            value -= factor[i, k] * right[k]
        value *= factor[i, i]
        right[i] = value
        square += value * value
    for i in range(count - 1, -1, -1):
        value = right[i] * factor[i, i]
        right[i] = value
        for k in range(i):
            right[k] -= factor[i, k] * value
    return square


@vectorised
def solve_spd(matrix, right, count):
    """Solve a positive definite system in place; return False if it is singular.

    Args:
        matrix: its lower triangle given, shape (count, count) at least; destroyed.
        right: shape (count,) at least; becomes the solution.
        count: number of rows of the system.
    """
    if not _factorise(matrix, count):
        return False
    solve_factored(matrix, right, count)
    return True


@vectorised
def invert_spd(matrix, inverse):
    """Set the inverse of a positive definite matrix; return the logarithm of its determinant.

    A linear algebra library would use threads for this, which on a busy machine wait for each other
    a hundred times as long as the work takes.

    Args:
        matrix: its lower triangle given, shape (n, n); destroyed.
        inverse: shape (n, n).

    Returns:
        -inf if the matrix is not positive definite; the inverse is then not set.
    """
    count, size = len(matrix), 0.0
    if not _factorise(matrix, count):
        return -np.inf
    inverse[:], row = 0.0, np.empty(count)
    for i in range(count):  # invert the factor in place, row by row
        pivot = matrix[i, i]
        size -= 2.0 * np.log(pivot)
        row[:i] = 0.0
        for k in range(i):
            share = matrix[i, k]
            for j in range(k + 1):
                row[j] -= share * matrix[k, j]
        for j in range(i):
            matrix[i, j] = pivot * row[j]
    for k in range(count):
        for i in range(k + 1):
            share = matrix[k, i]
            for j in range(i + 1):
                inverse[i, j] += share * matrix[k, j]
    for i in range(count):
        for j in range(i):
            inverse[j, i] = inverse[i, j]
    return size


@compiled
def diagonalise(matrix, basis, values):
    """Diagonalise a symmetric matrix by Jacobi's rotations.

    Args:
        matrix: shape (4, 4), destroyed.
        basis: multiplied by the eigenvectors, which are columns, shape (4, 4).
        values: set to the eigenvalues, shape (4,).
    """
    for _ in range(SWEEPS):
        beside = along = 0.0
        for i in range(4):
            along += matrix[i, i] ** 2
            for j in range(i):
                beside += matrix[i, j] ** 2
        if beside <= DIAGONAL * along:
            break
        for p in range(3):
            for q in range(p + 1, 4):
                if matrix[p, q] != 0.0:
                    _rotate(matrix, basis, p, q)
    for i in range(4):
        values[i] = matrix[i, i]


@compiled
def _rotate(matrix, basis, p, q):
    """Rotate axes p and q so that entry (p, q) vanishes."""
    entry = matrix[p, q]
    cotangent = 0.5 * (matrix[q, q] - matrix[p, p]) / entry
    t = 1.0 / (abs(cotangent) + np.sqrt(cotangent * cotangent + 1.0))
    if cotangent < 0.0:
        t = -t
    c = 1.0 / np.sqrt(t * t + 1.0)
    s = t * c
    matrix[p, p] -= t * entry
    matrix[q, q] += t * entry
    matrix[p, q] = matrix[q, p] = 0.0
    for r in range(4):
        if r != p and r != q:
            a, b = matrix[r, p], matrix[r, q]
            matrix[r, p] = matrix[p, r] = c * a - s * b
            matrix[r, q] = matrix[q, r] = s * a + c * b
        a, b = basis[r, p], basis[r, q]
        basis[r, p] = c * a - s * b
        basis[r, q] = s * a + c * b


@compiled
def refutes(maps, rows, y):
    """Return True if multipliers prove that no headings in their balls satisfy rows a . v >= b.

    For all headings z_k, the sum of the rows' violations, weighted by the multipliers, is at least
    its value at z = 0 minus the norms of its gradients in each z_k (Farkas).

    Args:
        maps: coefficients of z_1..z_N in the vectors v, shape (P, N).
        rows: index of the vector v that each of at least M rows constrains; a, shape (.., n); b.
        y: multipliers of the first M, >= 0, shape (M,).
    """
    places, normals, offsets = rows
    value, magnitude, pull = 0.0, 0.0, np.empty(normals.shape[1])
    for i in range(len(y)):
        value += y[i] * offsets[i]
        magnitude += abs(y[i] * offsets[i])
    for k in range(maps.shape[1]):
        pull[:] = 0.0
        for i in range(len(y)):
            for c in range(len(pull)):
                pull[c] += y[i] * maps[places[i], k] * normals[i, c]
        size = np.sqrt((pull * pull).sum())
        value, magnitude = value - size, magnitude + size
    return value > REFUTED * magnitude
