# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Penalty terms over SO(3): what the method of multipliers adds to the quadratic.

Each term is a maximum over multipliers, linear in R. Its Moreau envelope of parameter 1/sigma has
as its gradient the projection of (multipliers + sigma * what they multiply) on the multipliers'
set: of L_k - sigma S(R_k) on the positive semidefinite matrices, of w + sigma R_k e1 on the ball,
and so on. The generalised Hessian of the envelopes is a sum of a few rank-one parts for each
constraint that acts.

The 4x4 matrix S(R) = I + K(R), positive semidefinite over conv SO(3), has K linear onto the
traceless symmetric matrices; K* is its adjoint for the entrywise inner products. R is given by its
nine entries, column by column.

Mathematics: docs/mathematics.md, 2.2 and 4.7.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled, entry_point
from orbimpc_ros.mpc.kernels.linear import diagonalise, is_positive

NEGLIGIBLE = 1e-12  # share of sigma at which a part of the Hessian is left out
REFUTED = 1e-9  # share of what cancels from which on a refutation is one
ROOM = 14  # parts of the Hessian for a step: ten of the orbitope, three of the length, a row


class Terms(NamedTuple):
    """What comes to the quadratic.

    Attributes:
        inverse: P, for R_k e1 and for the other columns, shape (2, n + K, n + K); beyond the n
            steps for the K positions: P reach', reach P and reach P reach'.
        slide: P has this times its transpose on top, shape (n + K, 9): where rho takes everything.
        lengths: c_k, shape (n,).
        rows: normals of the rows, shape (n, 3); row k is over R_k e1.
        offsets: of the rows, shape (n,); with a zero normal and a negative offset a row is inert.
        coasting: whether rho stands in the first place.
        reach: what R_1 e1..R_n e1 add to the positions, shape (K, n); without coasting only.
        steps: of the rows on positions, counted from 0, shape (m,).
        sides: their normals, shape (m, 3); row i is over what is added to position steps[i].
        heights: their offsets, shape (m,).
    """

    inverse: Array
    slide: Array
    lengths: Array
    rows: Array
    offsets: Array
    coasting: bool
    reach: Array
    steps: np.ndarray
    sides: Array
    heights: Array


class Multipliers(NamedTuple):
    """Multipliers of the terms; arrays that are updated in place.

    Attributes:
        orbitopes: shape (n, 4, 4), symmetric, positive semidefinite.
        lengths: shape (n, 3), of norm at most c_k.
        rows: shape (n,), not negative.
        fraction: shape (1,), of 0 <= rho <= 1.
        sides: shape (m,), not negative.
    """

    orbitopes: Array
    lengths: Array
    rows: Array
    fraction: Array
    sides: Array


class Scratch(NamedTuple):
    """Room to work in, made once; C is how many columns there can be.

    Attributes:
        bases: eigenvectors of the last projections on the cone, shape (n, 4, 4).
        values: their eigenvalues, shape (n, 4).
        sizes: |w + sigma R_k e1| of the last projections on the balls, shape (n,).
        step: of every column of the terms' Hessian, shape (C,); n + k for position k.
        column: itself, shape (C, 9).
        weight: its weight, shape (C,).
        slid: the columns' components along ``Terms.slide``, shape (C,).
        solution: of a Newton system, shape (C,).
        matrix: of a Newton system, shape (C, C).
        small: three matrices, shape (3, 4, 4).
        lowest: the minimiser of the Lagrangian that gives the greatest bound, shape (n, 9).
        forces: what the multipliers of that exert, shape (n, 9).
        pushes: those of the lengths, shape (n, 3).
        tops: the traces of those of the orbitopes, shape (n,).
        rows: those of the rows on headings, shape (n,).
        sides: those of the rows on positions; or, where nothing is feasible, what proves it.
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
    tops: Array
    rows: Array
    sides: Array


@entry_point
def multipliers(n, m):
    """Return multipliers of zero.

    Args:
        n: how many steps they are for.
        m: how many rows on positions.
    """
    return Multipliers(np.zeros((n, 4, 4)), np.zeros((n, 3)), np.zeros(n), np.zeros(1), np.zeros(m))


def scratch(n: int, m: int = 0) -> Scratch:
    """Return room to work in.

    Args:
        n: how many steps it is for.
        m: how many rows on positions at most.
    """
    room = ROOM * n + m
    return Scratch(
        np.empty((n, 4, 4)),
        np.empty((n, 4)),
        np.empty(n),
        np.empty(room, np.int64),
        np.empty((room, 9)),
        np.empty(room),
        np.empty(room),
        np.empty(room),
        np.empty((room, room)),
        np.empty((3, 4, 4)),
        np.empty((n, 9)),
        np.empty((n, 9)),
        np.empty((n, 3)),
        np.empty(n),
        np.empty(n),
        np.empty(m),
    )


def no_sides() -> tuple[np.ndarray, Array, Array]:
    """Return what :class:`Terms` has where there are no rows on positions."""
    return np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0)


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
def _set_pair(basis, i, j, out):
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


@compiled
def set_forces(terms, held, force):
    """Set the gradient of the terms for fixed multipliers.

    Args:
        terms: what comes to the quadratic.
        held: the multipliers.
        force: to be set, shape (n, 9).
    """
    for k in range(len(force)):
        for c in range(9):
            force[k, c] = 0.0
        if k == 0 and terms.coasting:
            force[0, 0] = held.fraction[0]
        else:
            _add_adjoint(held.orbitopes[k], -1.0, force[k])
        for c in range(3):
            force[k, c] += held.lengths[k, c] - held.rows[k] * terms.rows[k, c]
    for i in range(len(held.sides)):
        if held.sides[i] > 0.0:
            for k in range(len(force)):
                pulled = held.sides[i] * terms.reach[terms.steps[i], k]
                for c in range(3):
                    force[k, c] -= pulled * terms.sides[i, c]


@compiled
def _short_of_side(terms, i, x):
    """Return by how much a row on a position is missed."""
    short = terms.heights[i]
    for k in range(len(x)):
        along = 0.0
        for c in range(3):
            along += terms.sides[i, c] * x[k, c]
        short -= terms.reach[terms.steps[i], k] * along
    return short


@compiled
def refuted(terms, sides):
    """Return whether multipliers prove that no headings in their balls meet the rows on positions.

    Whatever the headings z_k are, the rows' shortfalls, weighed by the multipliers, add up to at
    least what they are at z = 0, less the length of what pulls at each z_k (Farkas).

    Args:
        terms: give the rows.
        sides: their multipliers, shape (m,).
    """
    value = magnitude = 0.0
    for i in range(len(sides)):
        value += sides[i] * terms.heights[i]
        magnitude += abs(sides[i] * terms.heights[i])
    for k in range(terms.reach.shape[1]):
        a = b = c = 0.0
        for i in range(len(sides)):
            pulled = sides[i] * terms.reach[terms.steps[i], k]
            a += pulled * terms.sides[i, 0]
            b += pulled * terms.sides[i, 1]
            c += pulled * terms.sides[i, 2]
        size = np.sqrt(a * a + b * b + c * c)
        value, magnitude = value - size, magnitude + size
    return value > REFUTED * magnitude


@compiled
def _project_shortfalls(held, sigma, new):
    """Project on what is not negative; return the terms' value, |new - held|^2, the violation.

    ``new`` comes with what the rows are short of, and leaves with their multipliers.
    """
    value = moved = worst = 0.0
    for i in range(len(held)):
        missed = new[i]
        new[i] = max(0.0, held[i] + sigma * missed)
        change = new[i] - held[i]
        value += new[i] * missed
        moved += change * change
        worst = max(worst, abs(change))
    return value, moved, worst / sigma


@compiled
def _project_sides(terms, x, held, sigma, new):
    """Project the multipliers of rows on positions, see :func:`_project_shortfalls`."""
    for i in range(len(held)):
        new[i] = _short_of_side(terms, i, x)
    return _project_shortfalls(held, sigma, new)


@compiled
def _project_orbitope(x, held, sigma, new, basis, values, small):
    """Project L - sigma S(R) on the cone; return -<new, S>, |new - L|^2, the violation.

    ``basis`` brings the eigenvectors of the last projection and takes this one's.
    """
    s, t, u = small[0], small[1], small[2]
    _set_lmi(x, s)
    if held[0, 0] == held[1, 1] == held[2, 2] == held[3, 3] == 0.0:
        t[:] = s
        if is_positive(t):  # most steps: the constraint does not act
            new[:] = 0.0
            values[:] = -1.0
            return 0.0, 0.0, 0.0
    for i in range(4):
        for j in range(4):
            u[i, j] = 0.0
            for k in range(4):
                u[i, j] += (held[i, k] - sigma * s[i, k]) * basis[k, j]
    for i in range(4):
        for j in range(4):
            t[i, j] = 0.0
            for k in range(4):
                t[i, j] += basis[k, i] * u[k, j]
    diagonalise(t, basis, values)
    value = moved = worst = 0.0
    for i in range(4):
        for j in range(i + 1):
            total = 0.0
            for k in range(4):
                if values[k] > 0.0:
                    total += values[k] * basis[i, k] * basis[j, k]
            new[i, j] = new[j, i] = total
            share = 1.0 if i == j else 2.0
            value -= share * total * s[i, j]
            moved += share * (total - held[i, j]) ** 2
            worst = max(worst, abs(total - held[i, j]))
    return value, moved, worst / sigma


@compiled
def _project_fraction(rho, held, sigma, new):
    """Project on [0, 1]; return the term's value, |new - held|^2, the violation."""
    change = sigma * (rho - min(1.0, max(0.0, rho + held[0] / sigma)))
    new[0] = held[0] + change
    return new[0] * rho - max(0.0, new[0]), change * change, abs(change) / sigma


@compiled
def _project_lengths(x, held, sigma, limits, new, sizes):
    """Project w + sigma z on balls of radius c; return the terms' value and |new - w|^2."""
    value = moved = 0.0
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
            value += new[k, c] * x[k, c]
            moved += (new[k, c] - held[k, c]) ** 2
    return value, moved


@compiled
def _project_rows(x, rows, offsets, held, sigma, new):
    """Project the multipliers of rows on thrust axes, see :func:`_project_shortfalls`."""
    for k in range(len(x)):
        short = offsets[k]
        for c in range(3):
            short -= rows[k, c] * x[k, c]
        new[k] = short
    return _project_shortfalls(held, sigma, new)


@compiled
def project(terms, x, held, sigma, new, work):
    """Project multipliers + sigma * what they multiply (Moreau envelopes) for every term.

    Args:
        terms: what comes to the quadratic.
        x: shape (n, 9).
        held: the multipliers to set out from.
        sigma: the envelopes' inverse parameter.
        new: set to the projections.
        work: its ``bases``, ``values`` and ``sizes`` are set for :func:`set_columns`.

    Returns:
        The terms' value at the projections, |new - held|^2, the violation of the constraints.
    """
    value, moved, worst = _project_rows(x, terms.rows, terms.offsets, held.rows, sigma, new.rows)
    v, m = _project_lengths(x, held.lengths, sigma, terms.lengths, new.lengths, work.sizes)
    value, moved = value + v, moved + m
    if len(held.sides):
        v, m, w = _project_sides(terms, x, held.sides, sigma, new.sides)
        value, moved, worst = value + v, moved + m, max(worst, w)
    first = 0
    if terms.coasting:
        v, m, w = _project_fraction(x[0, 0], held.fraction, sigma, new.fraction)
        value, moved, worst, first = value + v, moved + m, max(worst, w), 1
    before, after = held.orbitopes, new.orbitopes
    bases, values, small = work.bases, work.values, work.small
    for k in range(first, len(x)):
        v, m, w = _project_orbitope(x[k], before[k], sigma, after[k], bases[k], values[k], small)
        value, moved, worst = value + v, moved + m, max(worst, w)
    return value, moved, worst


@compiled
def value_of(terms, x, held, s):
    """Return the value of the terms for fixed multipliers.

    Args:
        terms: what comes to the quadratic.
        x: shape (n, 9).
        held: the multipliers.
        s: room to work in, shape (4, 4).
    """
    value = held.fraction[0] * x[0, 0] - max(0.0, held.fraction[0])
    for k in range(len(x)):
        if not (k == 0 and terms.coasting):
            _set_lmi(x[k], s)
            for i in range(4):
                for j in range(4):
                    value -= held.orbitopes[k, i, j] * s[i, j]
        value += held.rows[k] * terms.offsets[k]
        for c in range(3):
            value += (held.lengths[k, c] - held.rows[k] * terms.rows[k, c]) * x[k, c]
    for i in range(len(held.sides)):
        if held.sides[i] > 0.0:
            value += held.sides[i] * _short_of_side(terms, i, x)
    return value


@compiled
def set_columns(terms, x, held, sigma, new, work):
    """Set every rank-one part of the generalised Hessian of the terms' envelopes.

    Args:
        terms: what comes to the quadratic.
        x: shape (n, 9).
        held: the multipliers that were projected.
        sigma: the envelopes' inverse parameter.
        new: their projections.
        work: its ``step``, ``column`` and ``weight`` are set.

    Returns:
        How many parts there are; those of rows on positions come last.
    """
    step, column, weight = work.step, work.column, work.weight
    count = first = 0
    if terms.coasting:
        first = 1
        if new.fraction[0] != 0.0:
            column[0] = 0.0
            column[0, 0] = 1.0
            step[0], weight[0] = 0, sigma
            count = 1
    count = _orbitope_columns(first, work.bases, work.values, sigma, step, column, weight, count)
    count = _length_columns(
        x, held.lengths, sigma, terms.lengths, work.sizes, step, column, weight, count
    )
    count = _row_columns(terms.rows, new.rows, sigma, step, column, weight, count)
    for i in range(len(new.sides)):
        if new.sides[i] > 0.0:
            column[count] = 0.0
            column[count, :3] = terms.sides[i]
            step[count], weight[count] = len(x) + terms.steps[i], sigma
            count += 1
    return count


@compiled
def _orbitope_columns(first, bases, values, sigma, step, column, weight, count):
    """Add the Hessian of the orbitopes' envelopes, by pairs of eigenvectors."""
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
                    _set_pair(bases[k], i, j, column[count])
                    step[count], weight[count] = k, sigma * share
                    count += 1
    return count


@compiled
def _length_columns(x, held, sigma, limits, sizes, step, column, weight, count):
    """Add the Hessian of the lengths' envelopes: c/|v| (I - d d') where |v| > c, v = w + sigma z.

    Householder's reflection that takes an axis, ``pole``, to d takes the others across d.
    """
    d = np.zeros(3)
    for k in range(len(x)):
        if limits[k] == 0.0:
            continue
        outside = sizes[k] > limits[k]
        pole = 0
        for c in range(3):
            d[c] = (held[k, c] + sigma * x[k, c]) / sizes[k] if outside else 0.0
            if abs(d[c]) > abs(d[pole]):
                pole = c
        sign = 1.0 if d[pole] >= 0.0 else -1.0
        for i in range(3):
            if outside and i == pole:
                continue
            for c in range(9):
                column[count, c] = 1.0 if c == i else 0.0
            for c in range(3):
                along = d[c] + sign if c == pole else d[c]
                column[count, c] -= d[i] * along / (1.0 + abs(d[pole]))
            step[count] = k
            weight[count] = sigma * limits[k] / sizes[k] if outside else sigma
            count += 1
    return count


@compiled
def _row_columns(rows, new, sigma, step, column, weight, count):
    """Add the Hessian of the envelopes of the rows that act."""
    for k in range(len(rows)):
        if new[k] > 0.0:
            for c in range(9):
                column[count, c] = rows[k, c] if c < 3 else 0.0
            step[count], weight[count] = k, sigma
            count += 1
    return count
