# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Stationary points over the annulus floor <= |z_k| <= 1, and the bounds that they prove.

With z_k = R_k e1, a stationary point of 1/2 z.Hz + q.z + l.|z| subject to an arrival, if there is
one, satisfies

.. math::
    \sum_j H_{kj} z_j + q_k + \ell_k z_k/|z_k| + \mu_k z_k + a_k \nu = 0, \qquad
    \sum_k a_k z_k = b,

with mu_k = 0 between the bounds, >= 0 at the rim and <= 0 at the floor. It is the *global* optimum
if the Lagrangian is convex in z: if H + diag(Theta) is positive semidefinite on the null space of
a (:func:`_bound`). Points are sought by Newton's method on the manifold of the bounds that headings
sit on, its steps damped until the matrix is positive definite and the step short (Levenberg,
Marquardt), and shortened until an exact penalty function descends.

Where floor and l vanish, the problem is the hull's, and convex: its optimum is a start and a bound.

Mathematics: docs/mathematics.md, 4.4.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.linear import quadratic, shift_to_semidefinite, solve_spd

ITERATIONS = 200
HALVINGS = 20
RESIDUAL = 1e-10  # of the forces at work
ARRIVED = 1e-11  # of the way that an arrival asks for
LONGEST_STEP = 0.4  # of a heading, on average
ON_BOUND = 1e-3  # a start this close to the rim or the floor is taken to sit on it
SMALLEST = 1e-9
SOFTEST, DAMPED, EASED = 1e-7, 8.0, 0.125  # damping: the first, its growth, its decay
ROUNDING = 1e-13  # of numbers that cancel
GOLDEN_ANGLE, OTHER_ANGLE = 2.399963229728653, 4.159129
SLICE = 1_000_000  # multiplications in about a millisecond
START, STEPS, TRIED, PLACED = range(4)  # in Progress.counts
COST, BOUND, DAMPING = range(3)  # in Progress.numbers


class Annulus(NamedTuple):
    """What is minimised over, and what stays from tick to tick.

    Attributes:
        hessian: H, shape (N, N).
        length: weight of each |z_k|, shape (N,).
        arrival: a, shape (N,); zero without an arrival.
        floor: least |z_k|.
    """

    hessian: Array
    length: Array
    arrival: Array
    floor: float


class Progress(NamedTuple):
    """A search that can be interrupted: where it is, and the best so far.

    Attributes:
        z: the headings it is at, shape (N, n).
        side: the bound that each heading sits on, floor -1, rim 1, neither 0, shape (N,).
        best: the headings of least cost, shape (N, n).
        proved: the headings whose multipliers prove the bound, shape (N, n).
        held: the bounds that these sit on, shape (N,).
        counts: the start it came from, Newton steps since, starts tried, whether z is on the
            annulus, shape (4,).
        numbers: cost of ``best``, inf if there is none; greatest lower bound; damping, shape (3,).
    """

    z: Array
    side: np.ndarray
    best: Array
    proved: Array
    held: np.ndarray
    counts: np.ndarray
    numbers: Array


def begun(steps: int, dimension: int) -> Progress:
    """Return the progress of a search that has not begun.

    Args:
        steps: N.
        dimension: n, 2 or 3.
    """
    shape = (steps, dimension)
    numbers = np.array([np.inf, -np.inf, 0.0])
    side, held, counts = np.zeros(steps, np.int64), np.zeros(steps, np.int64), np.zeros(4, np.int64)
    return Progress(np.zeros(shape), side, np.zeros(shape), np.zeros(shape), held, counts, numbers)


@compiled
def _size(z, k):
    """Return |z_k| of headings, shape (N, n)."""
    total = 0.0
    for c in range(z.shape[1]):
        total += z[k, c] * z[k, c]
    return np.sqrt(total)


@compiled
def cost_of(annulus, q, z):
    """Return the cost of headings without its constant: 1/2 z.Hz + q.z + l.|z|.

    Args:
        annulus: gives H and l.
        q: linear terms, shape (N, n).
        z: headings, shape (N, n).
    """
    total = quadratic(annulus.hessian, q, z)
    for k in range(len(q)):
        if annulus.length[k] > 0.0:
            total += annulus.length[k] * _size(z, k)
    return total


@compiled
def _set_missed(annulus, left, z, missed):
    """Set by how much headings miss the arrival, shape (n,) or (0,); return the largest."""
    worst = 0.0
    for c in range(len(missed)):
        missed[c] = -left[c]
        for k in range(len(z)):
            missed[c] += annulus.arrival[k] * z[k, c]
        worst = max(worst, abs(missed[c]))
    return worst


@compiled
def _put(z, k, size, onto):
    """Give heading k, of a size, another one."""
    if size < SMALLEST:
        for c in range(z.shape[1]):
            z[k, c] = 0.0
        z[k, 0], size = 1.0, 1.0
    for c in range(z.shape[1]):
        z[k, c] *= onto / size


@compiled
def _place(z, side, floor):
    """Take headings to the annulus, those near a bound onto it."""
    for k in range(len(z)):
        size = _size(z, k)
        side[k] = 0
        if floor > 0.0 and size <= floor + ON_BOUND:
            side[k] = -1
        if size >= 1.0 - ON_BOUND or floor == 1.0:
            side[k] = 1
        if side[k] != 0:
            _put(z, k, size, 1.0 if side[k] > 0 else floor)


@compiled
def _set_forces(annulus, q, z, force):
    """Set H z + q, shape (N, n)."""
    for k in range(len(q)):
        for c in range(q.shape[1]):
            total = q[k, c]
            for j in range(len(q)):
                total += annulus.hessian[k, j] * z[j, c]
            force[k, c] = total


@compiled
def _set_gradient(annulus, q, z, gradient):
    """Set the derivative of the cost, shape (N, n)."""
    _set_forces(annulus, q, z, gradient)
    for k in range(len(q)):
        if annulus.length[k] > 0.0:
            slope = annulus.length[k] / _size(z, k)
            for c in range(q.shape[1]):
                gradient[k, c] += slope * z[k, c]


@compiled
def _set_pull(annulus, z, side, gradient, nu):
    """Set nu, shape (n,), to the least-squares multipliers of the arrival."""
    n = len(nu)
    system, square = np.zeros((n, n)), 0.0
    nu[:] = 0.0
    for k in range(len(z)):
        a, along, norm = annulus.arrival[k], 0.0, 1.0
        if side[k] != 0:
            norm = _size(z, k) ** 2
            for c in range(n):
                along += z[k, c] * gradient[k, c] / norm
        for c in range(n):
            across = gradient[k, c] - along * z[k, c]
            nu[c] -= a * across
            system[c, c] += a * a
            for d in range(n):
                if side[k] != 0:
                    system[c, d] -= a * a * z[k, c] * z[k, d] / norm
        square += a * a
    for c in range(n):
        system[c, c] += 1e-12 * square  # headings in line with the arrival leave it undetermined
    if not solve_spd(system, nu, n):
        nu[:] = 0.0


@compiled
def _set_multipliers(annulus, z, side, gradient, nu, mu):
    """Set mu, shape (N,); return the largest force that nothing balances."""
    worst = 0.0
    arrives = len(nu) > 0
    for k in range(len(z)):
        mu[k], norm = 0.0, 0.0
        for c in range(z.shape[1]):
            force = gradient[k, c]
            if arrives:
                force += annulus.arrival[k] * nu[c]
            mu[k] -= force * z[k, c]
            norm += z[k, c] * z[k, c]
        mu[k] = mu[k] / norm if side[k] != 0 else 0.0
        for c in range(z.shape[1]):
            force = gradient[k, c] + mu[k] * z[k, c]
            if arrives:
                force += annulus.arrival[k] * nu[c]
            worst = max(worst, abs(force))
    return worst


@compiled
def _set_basis(z, side, owner, basis):
    """Set the directions that headings may move in, and whose they are; return their number.

    Those of a heading on a bound are its tangents, Householder's reflections of the axes across
    the one that it is nearest to; those of another are the axes.
    """
    count, n = 0, z.shape[1]
    for k in range(len(z)):
        size, pole = _size(z, k), 0
        for c in range(n):
            if abs(z[k, c]) > abs(z[k, pole]):
                pole = c
        sign = 1.0 if z[k, pole] >= 0.0 else -1.0
        for i in range(n):
            if side[k] != 0 and i == pole:
                continue
            owner[count] = k
            for c in range(n):
                basis[count, c] = 1.0 if c == i else 0.0
                if side[k] != 0:
                    along = z[k, c] / size + sign if c == pole else z[k, c] / size
                    basis[count, c] -= z[k, i] / size * along / (1.0 + abs(z[k, pole]) / size)
            count += 1
    return count


@compiled
def _set_reduced(annulus, z, mu, owner, basis, count, reduced):
    """Set the Lagrangian's Hessian in a basis; return its largest diagonal entry."""
    n, scale = z.shape[1], 0.0
    for i in range(count):
        a = owner[i]
        for j in range(i + 1):
            b, inner = owner[j], 0.0
            for c in range(n):
                inner += basis[i, c] * basis[j, c]
            entry = annulus.hessian[a, b] * inner
            if a == b:
                entry += mu[a] * inner
                if annulus.length[a] > 0.0:
                    size, along_i, along_j = _size(z, a), 0.0, 0.0
                    for c in range(n):
                        along_i += basis[i, c] * z[a, c] / size
                        along_j += basis[j, c] * z[a, c] / size
                    entry += annulus.length[a] / size * (inner - along_i * along_j)
            reduced[i, j] = reduced[j, i] = entry
        scale = max(scale, abs(reduced[i, i]))
    return scale


@compiled
def reflect(rows, count, column, reflector):
    """Reflect rows so that a column vanishes below its own place (a step of Householder's QR).

    Args:
        rows: shape (count, n) at least, updated in place.
        count: of the rows that belong to it.
        column: to be reflected; the ones before it have been.
        reflector: to be set to v of I - 2 v v'/|v|^2, shape (count,) at least.
    """
    norm = 0.0
    for i in range(count):
        reflector[i] = rows[i, column] if i >= column else 0.0
        norm += reflector[i] * reflector[i]
    norm = np.sqrt(norm)
    reflector[column] += norm if reflector[column] >= 0.0 else -norm
    mirror(rows, count, reflector)


@compiled
def mirror(matrix, count, reflector):
    """Multiply a matrix from the left by Householder's I - 2 v v'/|v|^2.

    Args:
        matrix: shape (count, m), updated in place.
        count: of its rows.
        reflector: v, shape (count,) at least.
    """
    square = 0.0
    for i in range(count):
        square += reflector[i] * reflector[i]
    if square == 0.0:
        return
    for j in range(matrix.shape[1]):
        along = 0.0
        for i in range(count):
            along += reflector[i] * matrix[i, j]
        along *= 2.0 / square
        for i in range(count):
            matrix[i, j] -= along * reflector[i]


@compiled
def _set_particular(rows, missed, move):
    """Set the first coordinates of a move to what makes up for a missed arrival: R'y = -missed."""
    largest = np.abs(rows).max()
    for c in range(len(missed)):
        move[c, 0] = -missed[c]
        for i in range(c):
            move[c, 0] -= rows[i, c] * move[i, 0]
        firm = abs(rows[c, c]) > 1e-8 * largest
        move[c, 0] = move[c, 0] / rows[c, c] if firm else 0.0


@compiled
def _set_damped(reduced, right, first, count, scale, damping, longest, move, work):
    """Set the rest of a move to a Newton step, damped as it takes (Levenberg, Marquardt).

    Args:
        reduced: a symmetric matrix, shape (count, count), whose rows from ``first`` on count.
        right: what the step has to make up for, shape (count,).
        first: of the coordinates that are free.
        count: of all coordinates.
        scale: of the matrix.
        damping: to begin with.
        longest: the step may be, in the Euclidean norm.
        move: shape (count, 1).
        work: multiplications to do at most, though no less than one attempt takes.

    Returns:
        Whether there is a step, and the damping that it took; without one, the damping to go on
        with; the work left.
    """
    free, found = count - first, False
    system, step = np.empty((free, free)), np.empty(free)
    while damping < 1e6 * scale:
        for i in range(free):
            step[i] = -right[first + i]
            for j in range(i + 1):
                system[i, j] = reduced[first + i, first + j]
            system[i, i] += damping
        work -= free**3 / 6.0 + 2.0 * free * free
        found = solve_spd(system, step, free) and step @ step <= longest * longest
        if found:
            break
        damping = max(DAMPED * damping, SOFTEST * scale)
        if work <= 0.0:
            return False, damping, work
    for i in range(free):
        move[first + i, 0] = step[i] if found else 0.0
    return True, damping, work


@compiled
def _set_move(annulus, z, side, gradient, mu, nu, missed, damping, longest, move, work):
    """Set a move, shape (N, n), along the bounds that headings sit on.

    Returns:
        What :func:`_set_damped` does; a damping too soft to matter is zero.
    """
    n_steps, n, met = len(z), z.shape[1], len(missed)
    owner, basis = np.empty(n * n_steps, np.int64), np.empty((n * n_steps, n))
    count = _set_basis(z, side, owner, basis)
    reduced = np.empty((count, count))
    scale = max(_set_reduced(annulus, z, mu, owner, basis, count, reduced), 1e-300)
    pull, small = np.zeros((count, 1)), np.zeros((count, 1))
    rows, reflectors = np.empty((count, met)), np.empty((met, count))
    for i in range(count):
        for c in range(n):
            pull[i, 0] += basis[i, c] * gradient[owner[i], c]
        for c in range(met):
            rows[i, c] = basis[i, c] * annulus.arrival[owner[i]]
            pull[i, 0] += rows[i, c] * nu[c]
    first = min(met, count)
    if met > 0:
        for c in range(first):
            reflect(rows, count, c, reflectors[c])
            mirror(pull, count, reflectors[c])
            mirror(reduced, count, reflectors[c])
            mirror(reduced.T, count, reflectors[c])
        _set_particular(rows, missed[:first], small)
        pull += np.ascontiguousarray(reduced[:, :first]) @ small[:first]
    work -= count * count * (1.0 + 4.0 * first) + 4.0 * n_steps * n_steps
    found, damping, work = _set_damped(
        reduced, pull[:, 0], first, count, scale, damping, longest, small, work
    )
    if not found:
        return False, damping, work
    for c in range(first - 1, -1, -1):
        mirror(small, count, reflectors[c])
    move[:] = 0.0
    for i in range(count):
        for c in range(n):
            move[owner[i], c] += small[i, 0] * basis[i, c]
    return True, damping if damping > SOFTEST * scale else 0.0, work


@compiled
def _set_moved(z, side, floor, move, share, there):
    """Set where a share of a move leads, back on the bounds; headings do not cross the others."""
    for k in range(len(z)):
        for c in range(z.shape[1]):
            there[k, c] = z[k, c] + share * move[k, c]
        size = _size(there, k)
        if side[k] > 0 or size > 1.0:
            _put(there, k, size, 1.0)
        elif side[k] < 0 or size < floor:
            _put(there, k, size, floor)


@compiled
def _advance(annulus, q, left, z, side, move, missed, weight):
    """Take the longest share of a move that lowers an exact penalty; return it, 0 if none does."""
    there = np.empty_like(z)
    before = cost_of(annulus, q, z) + weight * np.abs(missed).sum()
    share = 1.0
    for _ in range(HALVINGS):
        _set_moved(z, side, annulus.floor, move, share, there)
        _set_missed(annulus, left, there, missed)
        reached = cost_of(annulus, q, there) + weight * np.abs(missed).sum()
        if reached <= before + ROUNDING * abs(before):
            z[:] = there
            return share
        share *= 0.5
    return 0.0


@compiled
def _catch(z, side, floor):
    """Note which headings came to a bound."""
    for k in range(len(z)):
        if side[k] == 0:
            size = _size(z, k)
            if size >= 1.0 - 1e-14:
                side[k] = 1
            elif floor > 0.0 and size <= floor * (1.0 + 1e-14):
                side[k] = -1


@compiled
def _release(side, mu, floor, least):
    """Let go of the headings that pull away from their bound by more than ``least``."""
    released = False
    if floor < 1.0:
        for k in range(len(side)):
            if mu[k] * side[k] < -least:
                side[k], released = 0, True
    return released


@compiled
def _curvature(length, floor, side, mu, size):
    r"""Return theta, and the share alpha of a length that is bounded below by its chord.

    The length l |z| is bounded below by (1 - alpha) l d.z + alpha l |z|, with d the direction of z,
    and on the annulus |z| by its chord in |z|^2. The larger alpha, the larger
    theta = mu + l/|z| - (1 - alpha) l/|z|; but the multiplier left for the modulus,
    theta - 2 alpha l / (1 + floor), must keep its sign.
    """
    slope = length / size if length > 0.0 else 0.0
    if floor == 1.0:
        return mu + slope, 1.0  # the modulus is an equation, its multiplier free
    spread, share = slope - 2.0 * length / (1.0 + floor), 0.0
    if side != 0 and spread != 0.0:
        share = min(max(-mu / spread, 0.0), 1.0)
    return mu + share * slope, share


@compiled
def _shortage(matrix, arrival, met, most):
    """Return by how much, if at all, a matrix falls short of being positive semidefinite.

    Args:
        matrix: symmetric, shape (N, N); destroyed.
        arrival: a, shape (N,).
        met: whether only the null space of the arrival counts.
        most: the largest answer of interest.

    Returns:
        Minus a lower bound on the least eigenvalue; inf where that is more than ``most``.
    """
    count, first = len(matrix), 1 if met else 0
    if met:
        row, reflector = arrival.copy().reshape((count, 1)), np.empty(count)
        reflect(row, count, 0, reflector)
        mirror(matrix, count, reflector)
        mirror(matrix.T, count, reflector)
    free = np.ascontiguousarray(matrix[first:, first:])
    scale = np.abs(free).max() if len(free) > 0 else 0.0
    if scale == 0.0:
        return 0.0
    slack, largest = 1e-15 * count * scale, 2.0 * count * scale  # no eigenvalue is as large
    return shift_to_semidefinite(free, slack, min(largest, most)) + slack


@compiled
def bound_at(annulus, q, left, z, theta, shares, nu, known):
    r"""Return a lower bound on the cost of all headings of the annulus that meet the arrival.

    For any theta, nu, alpha in [0, 1] and unit vectors d, cost(z') is at least

        1/2 z'.(H + diag(theta))z' + (q + (1 - alpha) l d + a nu).z' - nu.b
        + sum_k min_t (alpha_k l_k t - theta_k t^2 / 2),   floor <= t <= 1,

    whose last part is attained at an end. Here that quadratic is expanded about z, d = z/|z|: all
    other headings are within |z_k' - z_k| <= 1 + |z_k|. What is left of its gradient, and of its
    convexity, counts against the bound, and so does rounding.

    Args:
        annulus: what is minimised over.
        q: linear terms, shape (N, n).
        left: b, shape (n,) or (0,).
        z: where the Lagrangian is least, or nearly, shape (N, n).
        theta: multipliers of the moduli, shape (N,).
        shares: alpha, shape (N,).
        nu: multipliers of the arrival, shape of ``left``.
        known: a bound that holds already; where this one is no better, it is returned at once.
    """
    n, floor, arrives = z.shape[1], annulus.floor, len(nu) > 0
    matrix, force, missed = annulus.hessian.copy(), np.empty_like(z), np.empty(len(nu))
    _set_forces(annulus, q, z, force)
    off = _set_missed(annulus, left, z, missed)
    value = quadratic(annulus.hessian, q, z)
    magnitude, stray, reach = abs(value), 0.0, 0.0
    for c in range(len(nu)):
        value += nu[c] * missed[c]
    for k in range(len(z)):
        size, bent = _size(z, k), theta[k]
        held = shares[k] * annulus.length[k]
        straight = annulus.length[k] - held
        matrix[k, k] += bent
        end = 1.0 if 0.5 * bent * (1.0 + floor) >= held else floor
        value += 0.5 * bent * (size - end) * (size + end) + held * end + straight * size
        magnitude += abs(bent) * max(size, end) ** 2 + annulus.length[k]
        left_over = 0.0
        for c in range(n):
            total = force[k, c] + bent * z[k, c]
            if straight > 0.0:
                total += straight / size * z[k, c]
            if arrives:
                total += annulus.arrival[k] * nu[c]
            left_over += total * total
            magnitude += abs(force[k, c] * z[k, c])
        stray += np.sqrt(left_over) * (1.0 + size)
        reach += (1.0 + size) ** 2
    if arrives:  # the way to another point leads out of the null space by what is missed
        astray = off * np.sqrt(n) / max(np.sqrt((annulus.arrival**2).sum()), 1e-300)
        value -= np.sqrt((matrix**2).sum()) * astray * (np.sqrt(reach) + astray)
    value -= stray + ROUNDING * magnitude
    if not value > known:
        return known
    short = _shortage(matrix, annulus.arrival, arrives, 2.0 * (value - known) / reach)
    return max(known, value - 0.5 * short * reach)


@compiled
def _bound(annulus, q, left, z, side, mu, nu, known):
    """Return the bound that the multipliers of a point prove, if it is better than one known."""
    theta, shares = np.empty(len(z)), np.empty(len(z))
    for k in range(len(z)):
        size = _size(z, k)
        theta[k], shares[k] = _curvature(annulus.length[k], annulus.floor, side[k], mu[k], size)
    return bound_at(annulus, q, left, z, theta, shares, nu, known)


@compiled
def multipliers_at(annulus, q, left, z, side):
    """Return theta, shape (N,), and nu, shape of ``left``, of the bound at a stationary point.

    Args:
        annulus: what is minimised over.
        q: linear terms, shape (N, n).
        left: b, shape (n,), or (0,) without an arrival.
        z: headings, shape (N, n).
        side: the bounds they sit on, shape (N,).
    """
    gradient, mu, theta = np.empty_like(z), np.empty(len(z)), np.empty(len(z))
    nu = np.zeros(len(left))
    _set_gradient(annulus, q, z, gradient)
    if len(left) > 0:
        _set_pull(annulus, z, side, gradient, nu)
    _set_multipliers(annulus, z, side, gradient, nu, mu)
    for k in range(len(z)):
        theta[k], _ = _curvature(annulus.length[k], annulus.floor, side[k], mu[k], _size(z, k))
    return theta, nu


@compiled
def _descend(annulus, q, left, progress, longest, work):
    """Take z towards a stationary point, on from where it is.

    Args:
        annulus: what to minimise over.
        q: linear terms, shape (N, n).
        left: b, shape (n,), or (0,) without an arrival.
        progress: updated in place, but for its best; its steps become ``ITERATIONS`` when there is
            nothing more to do.
        longest: Euclidean norm of a step.
        work: multiplications to do at most.

    Returns:
        By how much z misses the arrival, the work left.
    """
    z, side, counts, numbers = progress.z, progress.side, progress.counts, progress.numbers
    n_steps, met = len(z), len(left)
    mu, nu, missed = np.zeros(n_steps), np.zeros(met), np.empty(met)
    gradient, move = np.empty_like(z), np.empty_like(z)
    scale = np.abs(q).max() + np.abs(annulus.hessian).max() + annulus.length.max() + 1e-300
    near, stuck = ARRIVED * (1.0 + np.abs(annulus.arrival).max()), False
    while True:
        off = _set_missed(annulus, left, z, missed)
        _set_gradient(annulus, q, z, gradient)
        if met > 0:
            _set_pull(annulus, z, side, gradient, nu)
        residual = _set_multipliers(annulus, z, side, gradient, nu, mu)
        settled = residual <= RESIDUAL * scale and off <= near
        least = max(RESIDUAL * scale, 10.0 * residual)
        if (settled or not stuck) and _release(side, mu, annulus.floor, least):
            settled = False
        if settled or stuck or counts[STEPS] >= ITERATIONS:
            counts[STEPS] = ITERATIONS
            break
        if work <= 0.0:
            break
        work -= 20.0 * n_steps * n_steps + 500.0
        found, numbers[DAMPING], work = _set_move(
            annulus, z, side, gradient, mu, nu, missed, numbers[DAMPING], longest, move, work
        )
        if not found:
            break
        counts[STEPS] += 1
        weight = scale + 2.0 * np.abs(nu).max() if met > 0 else 0.0
        share = _advance(annulus, q, left, z, side, move, missed, weight)
        _catch(z, side, annulus.floor)
        if share == 1.0:
            numbers[DAMPING] *= EASED
        elif share == 0.0:
            numbers[DAMPING] = max(64.0 * numbers[DAMPING], 1e-6 * scale)
            stuck = numbers[DAMPING] > 1e3 * scale
    bound = _bound(annulus, q, left, z, side, mu, nu, numbers[BOUND])
    if bound > numbers[BOUND]:
        numbers[BOUND], progress.proved[:], progress.held[:] = bound, z, side
    return off, work


@compiled
def _begin(z, side, starts, start, floor):
    """Set headings to a start: one that is given, or one of those spread over all directions."""
    if start < len(starts):
        z[:] = starts[start]
    else:
        for k in range(len(z)):
            turn = (start + 1.0) * (k + 1.0)
            height = np.cos(OTHER_ANGLE * turn) if z.shape[1] == 3 else 0.0
            flat = np.sqrt(1.0 - height * height)
            z[k, 0] = flat * np.cos(GOLDEN_ANGLE * turn)
            z[k, 1] = flat * np.sin(GOLDEN_ANGLE * turn)
            if z.shape[1] == 3:
                z[k, 2] = height
    _place(z, side, floor)


@compiled
def relax(annulus, q, left, progress, work):
    """Minimise over the hull, without length, from where the progress is; interruptible.

    Args:
        annulus: of floor 0 and length 0.
        q: linear terms, shape (N, n).
        left: b, shape (n,), or (0,) where there is no arrival.
        progress: updated in place; its best is the hull's optimum.
        work: multiplications to do at most.

    Returns:
        Whether it has ended.
    """
    counts, numbers = progress.counts, progress.numbers
    off, work = _descend(annulus, q, left, progress, np.inf, work)
    progress.best[:] = progress.z
    if off <= 1e-9 * (1.0 + np.abs(annulus.arrival).max()):
        numbers[COST] = cost_of(annulus, q, progress.z)
    return counts[STEPS] >= ITERATIONS


@compiled
def improve(annulus, q, left, constant, starts, more, tolerance, progress, work):
    """Go from start to start until a stationary point is proved global; interruptible.

    Args:
        annulus: what to minimise over.
        q: linear terms, shape (N, n).
        left: b, shape (n,), or (0,) where there is no arrival.
        constant: what costs lack; it only scales the tolerance.
        starts: headings to start from, shape (S, N, n).
        more: further starts, spread evenly over directions.
        tolerance: relative gap at which to stop.
        progress: updated in place.
        work: multiplications to do at most.

    Returns:
        Whether it has ended.
    """
    z, side, counts, numbers = progress.z, progress.side, progress.counts, progress.numbers
    longest = LONGEST_STEP * np.sqrt(len(z))
    near = 1e-9 * (1.0 + np.abs(annulus.arrival).max())
    while counts[START] < len(starts) + more:
        if counts[PLACED] == 0:
            _begin(z, side, starts, counts[START], annulus.floor)
            counts[PLACED], counts[STEPS], numbers[DAMPING] = 1, 0, 0.0
        off, work = _descend(annulus, q, left, progress, longest, work)
        cost = cost_of(annulus, q, z)
        if off <= near and cost < numbers[COST]:
            numbers[COST] = cost
            progress.best[:] = z
        if counts[STEPS] >= ITERATIONS:
            counts[START] += 1
            counts[TRIED] += 1
            counts[PLACED] = 0
        if numbers[COST] - numbers[BOUND] <= tolerance * max(abs(numbers[COST] + constant), 1e-9):
            return True
        if work <= 0.0:
            return False
    return True


@compiled
def improve_from_hull(disks, annulus, q, left, constant, least, tolerance, hull, progress, work):
    """Minimise over the hull, and improve the annulus' best from there; interruptible.

    In one call, since to pass the arrays takes as long as to work through a short horizon.

    Args:
        disks: of floor 0 and length 0.
        annulus: what to minimise over.
        q: linear terms, shape (N, n).
        left: b, shape (n,), or (0,) where there is no arrival.
        constant: what costs lack; it only scales the tolerance.
        least: what the annulus costs more than the disks, at least.
        tolerance: relative gap at which to stop.
        hull: the progress over the disks, updated in place.
        progress: over the annulus, updated in place.
        work: multiplications to do at most, for each of the two.

    Returns:
        Whether it has ended.
    """
    if hull.counts[STEPS] < ITERATIONS and not relax(disks, q, left, hull, work):
        return False
    progress.numbers[BOUND] = max(progress.numbers[BOUND], hull.numbers[BOUND] + least)
    starts = hull.best.copy().reshape((1, len(q), q.shape[1]))
    return improve(annulus, q, left, constant, starts, 0, tolerance, progress, work)
