# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Penalty terms over SO(3), which the method of multipliers adds to the quadratic.

Each term is a maximum over multipliers, linear in R. The gradient of its Moreau envelope of
parameter 1/sigma is the projection of (multipliers + sigma * their factors) onto the multipliers'
set: of L_k - sigma S(R_k) onto the positive semidefinite matrices, of w + sigma R_k e1 onto the
ball, and so on. The generalised Hessian of the envelopes is a sum of a few rank-one parts for each
active constraint.

The 4x4 matrix S(R) = I + K(R), positive semidefinite over conv SO(3), has K linear onto the
traceless symmetric matrices; K* is its adjoint for the entrywise inner products. R is given by its
nine entries, column by column.

Mathematics: docs/mathematics.md, 2.2 and 4.7.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.linear import copy_to, diagonalise, extend_factor, set_basis

NEGLIGIBLE = 1e-12  # share of sigma below which a part of the Hessian is left out
ROOM = 13  # rank-one parts of the Hessian for a step: ten of the orbitope, three of the length


class Terms(NamedTuple):
    """Terms added to the quadratic.

    Attributes:
        inverse: P, for R_k e1 and for the other columns, shape (2, n + K, n + K); beyond the n
            steps, for K positions with shares S: P S', S P and S P S'.
        slide: its product with its transpose is added to P, as the effect of a factor on a coasted
            R_1; zero without one, shape (n + K, 9).
        lengths: c_k, shape (n,).
        decided: number of steps, the first ones, without an orbitope.
        shares: of R_1 e1..R_n e1 in the vectors that rows constrain: the identity, and below it
            their shares in the positions, shape (n + K, n).
        places: index of the vector that each row constrains, shape (m,).
        normals: of the rows, shape (m, 3).
        offsets: of the rows, shape (m,).
    """

    inverse: Array
    slide: Array
    lengths: Array
    decided: int
    shares: Array
    places: np.ndarray
    normals: Array
    offsets: Array


class TermMultipliers(NamedTuple):
    """Multipliers of the terms; arrays that are updated in place.

    Attributes:
        orbitopes: shape (n, 4, 4), symmetric, positive semidefinite.
        lengths: shape (n, 3), of norm at most c_k.
        rows: shape (m,), not negative.
    """

    orbitopes: Array
    lengths: Array
    rows: Array


class Scratch(NamedTuple):
    """Working memory, created once; C is the largest number of columns.

    Attributes:
        bases: eigenvectors of the last projections on the cone, shape (n, 4, 4).
        values: their eigenvalues, shape (n, 4).
        sizes: |w + sigma R_k e1| of the last projections on the balls, shape (n,).
        step: index of the vector of each column of the terms' Hessian, shape (C,).
        column: the columns, shape (C, 9).
        weight: their weights, shape (C,).
        slid: the columns' components along ``Terms.slide``, shape (C,).
        solution: of a Newton system, shape (C,).
        matrix: of a Newton system, shape (C, C).
        small: three matrices, shape (3, 4, 4).
        lowest: the minimiser of the Lagrangian that gives the greatest bound, shape (n, 9).
        forces: those of the multipliers of that bound, shape (n, 9).
        pushes: multipliers of the lengths, shape (n, 3).
        rows: multipliers of the rows; or those that prove infeasibility.
    """

    bases: Array
    values: Array
    sizes: Array
    step: Array
    column: Array
    weight: Array
    slid: Array
    solution: Array
    matrix: Array
    small: Array
    lowest: Array
    forces: Array
    pushes: Array
    rows: Array


def multipliers(n: int, m: int) -> TermMultipliers:
    """Return multipliers of zero.

    Args:
        n: number of steps.
        m: number of rows.
    """
    return TermMultipliers(np.zeros((n, 4, 4)), np.zeros((n, 3)), np.zeros(m))


def scratch(n: int, m: int) -> Scratch:
    """Return working memory.

    Args:
        n: number of steps.
        m: largest number of rows.
    """
    room = ROOM * n + m
    shapes = (
        *((n, 4, 4), (n, 4), (n,), (room,), (room, 9), (room,), (room,), (room,), (room, room)),
        *((3, 4, 4), (n, 9), (n, 9), (n, 3), (m,)),
    )
    made = Scratch._make(np.empty(each) for each in shapes)
    return made._replace(step=np.empty(room, np.int64))


@compiled
def inner(a, b):
    """Return the inner product of two arrays, each of shape (n, 9) or longer by b."""
    total = 0.0
    for k in range(len(a)):
        for c in range(9):
            total += a[k, c] * b[k, c]
    return total


@compiled
def _set_lmi(x, s):
    """Set S(R), the matrix of :func:`orbimpc_ros.mpc.geometry.rotations.lmi`.

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
def _add_adjoint(m, scale, out):
    """Add a multiple of K*(m), the adjoint of R's part of S(R).

    Args:
        m: symmetric, its upper triangle given, shape (4, 4).
        scale: the factor.
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
def set_forces(terms, held, force):
    """Set the gradient of the terms for fixed multipliers; return their value at x = 0.

    Args:
        terms: added to the quadratic.
        held: the multipliers.
        force: to be set, shape (n, 9).
    """
    value, force[:] = 0.0, 0.0
    for k in range(len(force)):
        _add_adjoint(held.orbitopes[k], -1.0, force[k])
        for i in range(4):
            value -= held.orbitopes[k, i, i]
        for c in range(3):
            force[k, c] += held.lengths[k, c]
    for i in range(len(held.rows)):
        if held.rows[i] > 0.0:
            value += held.rows[i] * terms.offsets[i]
            for k in range(len(force)):
                pulled = held.rows[i] * terms.shares[terms.places[i], k]
                for c in range(3):
                    force[k, c] -= pulled * terms.normals[i, c]
    return value


@compiled
def _project_rows(terms, x, held, sigma, new):
    """Project onto non-negative numbers; return |new - held|^2 and the violation."""
    moved = worst = 0.0
    for i in range(len(held)):
        short = terms.offsets[i]
        for k in range(len(x)):
            share = terms.shares[terms.places[i], k]
            if share != 0.0:
                for c in range(3):
                    short -= share * terms.normals[i, c] * x[k, c]
        new[i] = max(0.0, held[i] + sigma * short)
        change = new[i] - held[i]
        moved += change * change
        worst = max(worst, abs(change))
    return moved, worst / sigma


@compiled
def _turn(matrix, basis, other):
    """Express a matrix in another basis: B' M B, in place; all of shape (4, 4)."""
    for i in range(4):
        for j in range(4):
            other[i, j] = 0.0
            for k in range(4):
                other[i, j] += matrix[i, k] * basis[k, j]
    for i in range(4):
        for j in range(4):
            matrix[i, j] = 0.0
            for k in range(4):
                matrix[i, j] += basis[k, i] * other[k, j]


@compiled
def _project_orbitope(x, held, sigma, new, basis, values, small):
    """Project L - sigma S(R) on the cone; return |new - L|^2 and the violation.

    ``basis`` holds the eigenvectors of the last projection, and is set to those of this one.
    """
    s, t, u = small[0], small[1], small[2]
    _set_lmi(x, s)
    if held[0, 0] == held[1, 1] == held[2, 2] == held[3, 3] == 0.0:
        copy_to(t, s)
        if extend_factor(t, t, 0, 4):  # as for most steps: the constraint is inactive
            new[:] = 0.0
            values[:] = -1.0
            return 0.0, 0.0
    for i in range(4):
        for j in range(4):
            t[i, j] = held[i, j] - sigma * s[i, j]
    _turn(t, basis, u)
    diagonalise(t, basis, values)
    moved = worst = 0.0
    for i in range(4):
        for j in range(i + 1):
            total = 0.0
            for k in range(4):
                if values[k] > 0.0:
                    total += values[k] * basis[i, k] * basis[j, k]
            new[i, j] = new[j, i] = total
            share = 1.0 if i == j else 2.0
            moved += share * (total - held[i, j]) ** 2
            worst = max(worst, abs(total - held[i, j]))
    return moved, worst / sigma


@compiled
def _project_lengths(x, held, sigma, limits, new, sizes):
    """Project w + sigma z on balls of radius c; return |new - w|^2."""
    moved = 0.0
    for k in range(len(x)):
        if limits[k] == 0.0:
            continue
        size = 0.0
        for c in range(3):
            new[k, c] = held[k, c] + sigma * x[k, c]
            size += new[k, c] * new[k, c]
        sizes[k] = np.sqrt(size)
        share = limits[k] / sizes[k] if sizes[k] > limits[k] else 1.0
        for c in range(3):
            new[k, c] *= share
            moved += (new[k, c] - held[k, c]) ** 2
    return moved


@compiled
def project(terms, x, held, sigma, new, force, work):
    """Project multipliers + sigma * their factors (Moreau envelopes) for every term.

    Args:
        terms: added to the quadratic.
        x: shape (n, 9).
        held: the current multipliers.
        sigma: the envelopes' inverse parameter.
        new: set to the projections.
        force: set to the gradient of the terms for these, shape (n, 9).
        work: its ``bases``, ``values`` and ``sizes`` are set for :func:`set_columns`.

    Returns:
        The terms' value at the projections, |new - held|^2, the violation of the constraints.
    """
    moved, worst = _project_rows(terms, x, held.rows, sigma, new.rows)
    moved += _project_lengths(x, held.lengths, sigma, terms.lengths, new.lengths, work.sizes)
    before, after = held.orbitopes, new.orbitopes
    bases, values, small = work.bases, work.values, work.small
    for k in range(terms.decided, len(x)):
        m, w = _project_orbitope(x[k], before[k], sigma, after[k], bases[k], values[k], small)
        moved, worst = moved + m, max(worst, w)
    return set_forces(terms, new, force) + inner(force, x), moved, worst


@compiled
def set_columns(terms, x, held, sigma, new, work):
    """Set every rank-one part of the generalised Hessian of the terms' envelopes.

    Args:
        terms: added to the quadratic.
        x: shape (n, 9).
        held: the multipliers that were projected.
        sigma: the envelopes' inverse parameter.
        new: their projections.
        work: its ``step``, ``column`` and ``weight`` are set.

    Returns:
        The number of parts.
    """
    step, column, weight = work.step, work.column, work.weight
    count = _orbitope_columns(terms.decided, sigma, work)
    count = _length_columns(x, held.lengths, sigma, terms.lengths, work, count)
    for i in range(len(new.rows)):
        if new.rows[i] > 0.0:
            column[count] = 0.0
            copy_to(column[count, :3], terms.normals[i])
            step[count], weight[count] = terms.places[i], sigma
            count += 1
    return count


@compiled
def _set_pair(basis, i, j, pair):
    """Set the upper triangle of the unit symmetric matrix that two columns of a basis span."""
    scale = 1.0 if i == j else np.sqrt(2.0)
    for r in range(4):
        for c in range(r, 4):
            one, other = basis[r, i] * (basis[c, j] * scale), basis[c, i] * (basis[r, j] * scale)
            pair[r, c] = 0.5 * (one + other)


@compiled
def _orbitope_columns(first, sigma, work):
    """Set the Hessian of the orbitopes' envelopes: K* of the pairs of eigenvectors."""
    bases, values, pair, count = work.bases, work.values, work.small[0], 0
    for k in range(first, len(bases)):
        for i in range(4):
            if values[k, i] <= 0.0:
                continue
            for j in range(4):
                both = values[k, j] > 0.0
                if both and j < i:
                    continue
                share = 1.0 if both else values[k, i] / (values[k, i] - values[k, j])
                if share > NEGLIGIBLE:
                    _set_pair(bases[k], i, j, pair)
                    work.column[count] = 0.0
                    _add_adjoint(pair, 1.0, work.column[count])
                    work.step[count], work.weight[count] = k, sigma * share
                    count += 1
    return count


@compiled
def _length_columns(x, held, sigma, limits, work, count):
    """Add the Hessian of the lengths' envelopes: c/|v| (I - d d') if |v| > c, v = w + sigma z."""
    by, sizes = np.zeros((3, 3)), work.sizes
    for k in range(len(x)):
        if limits[k] == 0.0:
            continue
        outside = sizes[k] > limits[k]
        copy_to(by[0], held[k] + sigma * x[k, :3])
        set_basis(by)
        for i in range(1 if outside else 0, 3):
            work.column[count] = 0.0
            copy_to(work.column[count, :3], by[i])
            work.step[count] = k
            work.weight[count] = sigma * limits[k] / sizes[k] if outside else sigma
            count += 1
    return count
