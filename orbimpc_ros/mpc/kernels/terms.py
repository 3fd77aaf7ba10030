"""What comes to the quadratic of a problem over SO(3), term by term, for the method of multipliers.

Each term is a maximum over multipliers, linear in R. Its Moreau envelope of parameter 1/sigma has
as its gradient the projection of (multipliers + sigma * what they multiply) on the multipliers'
set: of L_k - sigma S(R_k) on the positive semidefinite matrices, of w + sigma R_k e1 on the ball,
and so on. The generalised Hessian of the envelopes is a sum of a few rank-one parts for each
constraint that acts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.linear import diagonalise, is_positive
from orbimpc_ros.mpc.kernels.orbitope import add_adjoint, set_lmi, set_pair

NEGLIGIBLE = 1e-12  # share of sigma at which a part of the Hessian is left out
ROOM = 14  # parts of the Hessian for a step: ten of the orbitope, three of the length, a row


class Terms(NamedTuple):
    """What comes to the quadratic.

    Attributes:
        inverse: P, for R_k e1 and for the other columns, shape (2, n, n).
        slide: P has this times its transpose on top, shape (n, 9): where rho takes everything.
        lengths: c_k, shape (n,).
        rows: normals of the rows, shape (n, 3); row k is over R_k e1.
        offsets: of the rows, shape (n,); with a zero normal and a negative offset a row is inert.
        coasting: whether rho stands in the first place.
    """

    inverse: Array
    slide: Array
    lengths: Array
    rows: Array
    offsets: Array
    coasting: bool


class Multipliers(NamedTuple):
    """Multipliers of the terms; arrays that are updated in place.

    Attributes:
        orbitopes: shape (n, 4, 4), symmetric, positive semidefinite.
        lengths: shape (n, 3), of norm at most c_k.
        rows: shape (n,), not negative.
        fraction: shape (1,), of 0 <= rho <= 1.
    """

    orbitopes: Array
    lengths: Array
    rows: Array
    fraction: Array


class Scratch(NamedTuple):
    """Room to work in, made once.

    Attributes:
        bases: eigenvectors of the last projections on the cone, shape (n, 4, 4).
        values: their eigenvalues, shape (n, 4).
        sizes: |w + sigma R_k e1| of the last projections on the balls, shape (n,).
        step: of every column of the terms' Hessian, shape (ROOM * n,).
        column: itself, shape (ROOM * n, 9).
        weight: its weight, shape (ROOM * n,).
        slid: the columns' components along ``Terms.slide``, shape (ROOM * n,).
        solution: of a Newton system, shape (ROOM * n,).
        matrix: of a Newton system, shape (ROOM * n, ROOM * n).
        small: three matrices, shape (3, 4, 4).
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


@compiled
def multipliers(n):
    """Return multipliers of zero for n steps."""
    return Multipliers(np.zeros((n, 4, 4)), np.zeros((n, 3)), np.zeros(n), np.zeros(1))


def scratch(n: int) -> Scratch:
    """Return room for n steps."""
    room = ROOM * n
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
    )


@compiled
def set_forces(terms, held, force):
    """Set ``force`` to the gradient, shape (n, 9), of the terms for fixed multipliers."""
    for k in range(len(force)):
        for c in range(9):
            force[k, c] = 0.0
        if k == 0 and terms.coasting:
            force[0, 0] = held.fraction[0]
        else:
            add_adjoint(held.orbitopes[k], -1.0, force[k])
        for c in range(3):
            force[k, c] += held.lengths[k, c] - held.rows[k] * terms.rows[k, c]


@compiled
def _project_orbitope(x, held, sigma, new, basis, values, small):
    """Project L - sigma S(R) on the cone; return -<new, S>, |new - L|^2, the violation.

    ``basis`` brings the eigenvectors of the last projection and takes this one's.
    """
    s, t, u = small[0], small[1], small[2]
    set_lmi(x, s)
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
def _project_length(x, held, sigma, limit, new):
    """Project w + sigma z on the ball of radius c; return the term's value, |new - w|^2, |.|."""
    size = 0.0
    for c in range(3):
        new[c] = held[c] + sigma * x[c]
        size += new[c] * new[c]
    size = np.sqrt(size)
    share = limit / size if size > limit else 1.0
    value = moved = 0.0
    for c in range(3):
        new[c] *= share
        value += new[c] * x[c]
        moved += (new[c] - held[c]) ** 2
    return value, moved, size


@compiled
def _project_row(terms, k, x, held, sigma, new):
    """Project on what is not negative; return the term's value, |new - held|^2, the violation."""
    short = terms.offsets[k]
    for c in range(3):
        short -= terms.rows[k, c] * x[c]
    new[k] = max(0.0, held[k] + sigma * short)
    change = new[k] - held[k]
    return new[k] * short, change * change, abs(change) / sigma


@compiled
def project(terms, x, held, sigma, new, work):
    """Set ``new`` to the projections; return the terms' value, |new - held|^2, the violation."""
    value = moved = worst = 0.0
    for k in range(len(x)):
        if k == 0 and terms.coasting:
            v, m, w = _project_fraction(x[0, 0], held.fraction, sigma, new.fraction)
        else:
            v, m, w = _project_orbitope(
                x[k], held.orbitopes[k], sigma, new.orbitopes[k], work.bases[k], work.values[k],
                work.small,
            )  # fmt: skip
        value, moved, worst = value + v, moved + m, max(worst, w)
        if terms.lengths[k] > 0.0:
            v, m, work.sizes[k] = _project_length(
                x[k], held.lengths[k], sigma, terms.lengths[k], new.lengths[k]
            )
            value, moved = value + v, moved + m
        v, m, w = _project_row(terms, k, x[k], held.rows, sigma, new.rows)
        value, moved, worst = value + v, moved + m, max(worst, w)
    return value, moved, worst


@compiled
def value_of(terms, x, held, s):
    """Return the value of the terms for fixed multipliers."""
    value = held.fraction[0] * x[0, 0] - max(0.0, held.fraction[0])
    for k in range(len(x)):
        if not (k == 0 and terms.coasting):
            set_lmi(x[k], s)
            for i in range(4):
                for j in range(4):
                    value -= held.orbitopes[k, i, j] * s[i, j]
        value += held.rows[k] * terms.offsets[k]
        for c in range(3):
            value += (held.lengths[k, c] - held.rows[k] * terms.rows[k, c]) * x[k, c]
    return value


@compiled
def set_columns(terms, x, held, sigma, new, work):
    """Set every rank-one part of the terms' Hessian in the scratch; return how many there are."""
    count = 0
    for k in range(len(x)):
        if k == 0 and terms.coasting:
            if new.fraction[0] != 0.0:
                work.column[0] = 0.0
                work.column[0, 0] = 1.0
                work.step[0], work.weight[0] = 0, sigma
                count = 1
        else:
            count = _orbitope_columns(k, sigma, count, work)
        if terms.lengths[k] > 0.0:
            count = _length_columns(x[k], held.lengths[k], sigma, terms.lengths[k], k, count, work)
        if new.rows[k] > 0.0:
            work.column[count] = 0.0
            for c in range(3):
                work.column[count, c] = terms.rows[k, c]
            work.step[count], work.weight[count] = k, sigma
            count += 1
    return count


@compiled
def _orbitope_columns(k, sigma, count, work):
    """Add the Hessian of an orbitope's envelope, by pairs of eigenvectors."""
    values = work.values[k]
    for i in range(4):
        if values[i] <= 0.0:
            continue
        for j in range(4):
            both = values[j] > 0.0
            if both and j < i:
                continue
            share = 1.0 if both else values[i] / (values[i] - values[j])
            if share > NEGLIGIBLE:
                set_pair(work.bases[k], i, j, work.small[0], work.column[count])
                work.step[count], work.weight[count] = k, sigma * share
                count += 1
    return count


@compiled
def _length_columns(x, held, sigma, limit, k, count, work):
    """Add the Hessian of a length's envelope: c/|v| (I - d d') where |v| > c, v = w + sigma z."""
    size, column = work.sizes[k], work.column
    outside = size > limit
    d = np.zeros(3)
    pole = 0
    if outside:
        for c in range(3):
            d[c] = (held[c] + sigma * x[c]) / size
            if abs(d[c]) > abs(d[pole]):
                pole = c
    # Householder's reflection that takes axis ``pole`` to d takes the others across d.
    sign = 1.0 if d[pole] >= 0.0 else -1.0
    for i in range(3):
        if outside and i == pole:
            continue
        for c in range(9):
            column[count, c] = 0.0
        for c in range(3):
            along = d[c] + sign if c == pole else d[c]
            column[count, c] = (1.0 if c == i else 0.0) - d[i] * along / (1.0 + abs(d[pole]))
        work.step[count] = k
        work.weight[count] = sigma * limit / size if outside else sigma
        count += 1
    return count
