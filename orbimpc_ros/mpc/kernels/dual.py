# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The best bound that multipliers of the annulus prove, whatever point they belong to.

With multipliers theta of the moduli, and lengths bounded below by their chord in |z|^2, the dual
function of the annulus problem (:func:`orbimpc_ros.mpc.kernels.annulus.bound_at`) is

    D(theta) = min_z (1/2 z.(H + diag(theta))z + q.z) + sum_k h_k(theta_k),
    h_k(theta) = min (l_k t - theta t^2 / 2)  over t = floor and t = 1,

z subject to the arrival. It is concave, and defined where the matrix is positive definite on the
null space of the arrival: its maximum is the value of the semidefinite relaxation that lifts z_k to
second moments (Shor). It is climbed by Newton's method with a logarithmic barrier mu log det on the
matrix, and h smoothed by the same mu: h is -1/2 lambda + 1/2 floor^2 (lambda - theta), up to a
shift, for the best lambda >= max(0, theta). With z the minimiser and P the inverse on the null
space, the gradient is |z_k|^2/2 + mu P_kk + h', and the negative Hessian
(z_j . z_k) P_jk + mu P_jk^2 - h''.

Where more is known of a heading, :class:`Cuts` say so. Their multipliers c >= 0 add to the
Lagrangian, which keeps its form, and mu log c to what is climbed.

Mathematics: docs/mathematics.md, 4.5 and 4.6.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.annulus import ROUNDING, Annulus, bound_at, mirror, reflect
from orbimpc_ros.mpc.kernels.linear import add_product, invert_spd, quadratic, solve_spd

CLIMBS = 60  # Newton steps
MU, BOUND, FIRST, TAKEN = range(4)  # in Ascent.numbers
SMALLEST = 1e-8  # mu, of the forces at work
SHRINK = 0.2  # of mu, from step to step
HALVINGS = 30
INSIDE = 0.9  # of the way to where a multiplier of a cut would vanish
NEAR = 0.2  # of what a bound lacks: where no more is left to climb, it will not be enough


class Cuts(NamedTuple):
    """What else holds: 1/2 b |z_k|^2 <= n . z_k + o, b >= 0, for the heading z_k of some step.

    Attributes:
        steps: which headings, shape (M,).
        bends: b, shape (M,).
        normals: n, shape (M, n).
        offsets: o, shape (M,).
    """

    steps: np.ndarray
    bends: Array
    normals: Array
    offsets: Array


def no_cuts(dimension: int) -> Cuts:
    """Return no cuts of headings of a dimension."""
    return Cuts(np.zeros(0, np.int64), np.zeros(0), np.zeros((0, dimension)), np.zeros(0))


@compiled
def _set_cut(annulus, q, cuts, weights, hessian, linear):
    """Set H and q with cuts, each times its multiplier, in the cost; return the constant part."""
    hessian[:], linear[:], constant = annulus.hessian, q, 0.0
    for i in range(len(weights)):
        k = cuts.steps[i]
        hessian[k, k] += weights[i] * cuts.bends[i]
        constant -= weights[i] * cuts.offsets[i]
        for c in range(q.shape[1]):
            linear[k, c] -= weights[i] * cuts.normals[i, c]
    return constant


@compiled
def _set_inverse(matrix, arrival, arrives, inverse):
    """Set P, shape (N, N); return log det of the matrix that it inverts, -inf if not positive."""
    count, first = len(matrix), 1 if arrives else 0
    if not arrives:
        return invert_spd(matrix.copy(), inverse)
    turned, reflector = matrix.copy(), np.zeros(count)
    reflect(arrival.copy().reshape((count, 1)), count, 0, reflector)
    mirror(turned, count, reflector)
    mirror(turned.T, count, reflector)
    free = np.empty((count - first, count - first))
    size = invert_spd(np.ascontiguousarray(turned[first:, first:]), free)
    inverse[:] = 0.0
    inverse[first:, first:] = free
    mirror(inverse, count, reflector)
    mirror(inverse.T, count, reflector)
    return size


@compiled
def _set_minimiser(annulus, q, left, theta, inverse, z):
    """Set P, shape (N, N), and z, shape (N, n), to the Lagrangian's minimiser for multipliers.

    Returns:
        The Lagrangian there, and log det of the matrix that P inverts: -inf, and nothing else is
        set, where that is not positive definite.
    """
    count, arrives = len(theta), len(left) > 0
    matrix = annulus.hessian.copy()
    for k in range(count):
        matrix[k, k] += theta[k]
    size = _set_inverse(matrix, annulus.arrival, arrives, inverse)
    if size == -np.inf:
        return -np.inf, size
    force = q.copy()
    z[:] = 0.0
    if arrives:
        square = (annulus.arrival**2).sum()
        for k in range(count):
            for c in range(len(left)):
                z[k, c] = annulus.arrival[k] * left[c] / square
        add_product(matrix, z, 1.0, force)
    add_product(inverse, force, -1.0, z)
    return quadratic(matrix, q, z), size


@compiled
def _end(floor, length, theta, mu):
    """Return h smoothed by mu, its derivative and its second one."""
    if floor == 1.0:
        return length - 0.5 * theta, -0.5, 0.0
    shift = 2.0 * length / (1.0 + floor)
    bent, a = theta - shift, 0.5 * (1.0 - floor * floor)
    root = np.sqrt(a * a * bent * bent + 4.0 * mu * mu)
    # Both lambda and lambda - bent, without cancelling.
    if bent >= 0.0:
        above = (a * bent + 2.0 * mu + root) / (2.0 * a)
        below = mu * above / (a * above - mu)
    else:
        below = (-a * bent + 2.0 * mu + root) / (2.0 * a)
        above = mu * below / (a * below - mu)
    value = length * floor - 0.5 * shift * floor * floor - 0.5 * above + 0.5 * floor * floor * below
    value += mu * (np.log(above) + np.log(below))
    turn = 0.5 - 0.5 * a * bent / root  # 1 - d lambda / d theta
    return value, -0.5 * floor * floor - mu / below, -mu * turn / (below * below)


@compiled
def _smoothed(annulus, theta, weights, mu, least, size):
    """Return the smoothed dual function, of the Lagrangian's minimum and log det."""
    value = least + mu * size
    for k in range(len(theta)):
        value += _end(annulus.floor, annulus.length[k], theta[k], mu)[0]
    for i in range(len(weights)):
        value += mu * np.log(weights[i])
    return value


@compiled
def _set_pulls(cuts, z, pulls):
    """Set how each multiplier pulls at its heading, z_k of the moduli, b z_k - n of the cuts."""
    count, n = z.shape
    pulls[:count] = z
    for i in range(len(cuts.steps)):
        for c in range(n):
            pulls[count + i, c] = cuts.bends[i] * z[cuts.steps[i], c] - cuts.normals[i, c]


@compiled
def _set_ascent(annulus, cuts, theta, weights, mu, inverse, z, system, step):
    """Set Newton's step up the smoothed dual function, (N + M,); return whether there is one."""
    (count, n), total = z.shape, len(step)
    pulls = np.empty((total, n))
    _set_pulls(cuts, z, pulls)
    for i in range(total):
        k, bend = (i, 1.0) if i < count else (cuts.steps[i - count], cuts.bends[i - count])
        for j in range(i + 1):
            other, bent = (j, 1.0) if j < count else (cuts.steps[j - count], cuts.bends[j - count])
            inner = mu * bend * bent * inverse[k, other]
            for c in range(n):
                inner += pulls[i, c] * pulls[j, c]
            system[i, j] = inner * inverse[k, other]
        square = 0.0
        for c in range(n):
            square += z[k, c] * z[k, c]
        step[i] = bend * (0.5 * square + mu * inverse[k, k])
        if i < count:
            _, slope, curve = _end(annulus.floor, annulus.length[k], theta[k], mu)
        else:
            slope, curve = mu / weights[i - count], -mu / weights[i - count] ** 2
            slope -= cuts.offsets[i - count]
            for c in range(n):
                slope -= cuts.normals[i - count, c] * z[k, c]
        step[i] += slope
        system[i, i] = (system[i, i] - curve) * (1.0 + 1e-12)
    return solve_spd(system, step, total)


@compiled
def pull_at(annulus, q, left, theta, z):
    """Return the multipliers of an arrival that a Lagrangian's minimiser has, shape of ``left``.

    Args:
        annulus: what is minimised over.
        q: linear terms, shape (N, n).
        left: b, shape (n,), or (0,) without an arrival.
        theta: multipliers of the moduli, shape (N,).
        z: the minimiser, shape (N, n).
    """
    nu = np.zeros(len(left))
    if len(left) > 0:
        force, square = q.copy(), (annulus.arrival**2).sum()
        add_product(annulus.hessian, z, 1.0, force)
        for k in range(len(theta)):
            for c in range(len(nu)):
                nu[c] -= annulus.arrival[k] * (force[k, c] + theta[k] * z[k, c]) / square
    return nu


@compiled
def _bound(annulus, q, left, theta, z, known):
    """Return the bound that multipliers prove at the Lagrangian's minimiser, or one known."""
    nu = pull_at(annulus, q, left, theta, z)
    return bound_at(annulus, q, left, z, theta, np.ones(len(theta)), nu, known)


class Ascent(NamedTuple):
    """A climb up the dual function that can be interrupted.

    Attributes:
        theta: multipliers of the moduli, shape (N,).
        weights: multipliers of the cuts, positive, shape (M,).
        z: the Lagrangian's minimiser, shape (N, n).
        numbers: mu; the greatest lower bound; the first mu; Newton steps taken, shape (4,).
    """

    theta: Array
    weights: Array
    z: Array
    numbers: Array


@compiled
def ascent(annulus, q, cuts, known):
    """Return a climb that has not begun.

    Args:
        annulus: what is minimised over.
        q: linear terms, shape (N, n).
        cuts: what else holds.
        known: a lower bound.
    """
    scale = np.abs(q).max() + np.abs(annulus.hessian).max() + 1e-300
    numbers = np.array([scale, known, scale, 0.0])
    weights = np.full(len(cuts.steps), scale)
    return Ascent(np.full(len(q), scale), weights, np.zeros(q.shape), numbers)


@compiled
def _set_lagrangian(annulus, q, left, cuts, theta, weights, room, z):
    """Set the Lagrangian's minimiser, and the matrices in ``room``, for multipliers.

    Returns:
        What :func:`_set_minimiser` does, with the constant part of the cuts in the former.
    """
    hessian, linear, inverse = room
    constant = _set_cut(annulus, q, cuts, weights, hessian, linear)
    cut = Annulus(hessian, annulus.length, annulus.arrival, annulus.floor)
    least, size = _set_minimiser(cut, linear, left, theta, inverse, z)
    return least + constant, size


@compiled
def _set_bound(annulus, left, cuts, progress, room):
    """Raise the bound of a climb to what its multipliers prove; ``room`` holds their matrices."""
    hessian, linear, _ = room
    theta, weights, z, numbers = progress
    constant = magnitude = 0.0
    for i in range(len(weights)):
        constant -= weights[i] * cuts.offsets[i]
        magnitude += weights[i] * abs(cuts.offsets[i])
    constant -= ROUNDING * magnitude
    cut = Annulus(hessian, annulus.length, annulus.arrival, annulus.floor)
    numbers[BOUND] = _bound(cut, linear, left, theta, z, numbers[BOUND] - constant) + constant


@compiled
def _longest(weights, step):
    """Return the share of a step, at most 1, that leaves all multipliers of cuts positive."""
    share = 1.0
    for i in range(len(weights)):
        if step[i] < 0.0:
            share = min(share, -INSIDE * weights[i] / step[i])
    return share


@compiled
def _advance(annulus, q, left, cuts, progress, step, reached, room):
    """Take the longest share of a step that leads higher, up to what multipliers allow.

    Returns:
        That share, 0 where none does; how many were tried; the Lagrangian there and log det.
    """
    theta, weights, z, numbers = progress
    least, size = reached
    before = _smoothed(annulus, theta, weights, numbers[MU], least, size)
    share = _longest(weights, step[len(theta) :])
    for tried in range(HALVINGS):
        there = theta + share * step[: len(theta)]
        held = weights + share * step[len(theta) :]
        least, size = _set_lagrangian(annulus, q, left, cuts, there, held, room, z)
        if _smoothed(annulus, there, held, numbers[MU], least, size) >= before:
            theta[:], weights[:] = there, held
            return share, tried + 1, (least, size)
        share *= 0.5
    return 0.0, HALVINGS, _set_lagrangian(annulus, q, left, cuts, theta, weights, room, z)


@compiled
def climb(annulus, q, left, cuts, enough, progress, work):
    """Climb the dual function by Newton's method, its barrier shrinking; interruptible.

    Args:
        annulus: what is minimised over.
        q: linear terms, shape (N, n).
        left: b, shape (n,), or (0,) without an arrival.
        cuts: what else holds.
        enough: the bound at which to stop, inf for the best there is; where it will clearly not be
            reached, the climb ends as well.
        progress: updated in place.
        work: multiplications to do at most, though no less than one Newton step takes.

    Returns:
        Whether it has ended.
    """
    theta, weights, z, numbers = progress
    count, total = len(theta), len(theta) + len(weights)
    room = np.empty((count, count)), np.empty(q.shape), np.empty((count, count))
    system, step = np.empty((total, total)), np.empty(total)
    reached = _set_lagrangian(annulus, q, left, cuts, theta, weights, room, z)
    size = reached[1]
    while size > -np.inf and numbers[MU] >= SMALLEST * numbers[FIRST] and numbers[TAKEN] < CLIMBS:
        numbers[TAKEN] += 1.0
        if not _set_ascent(annulus, cuts, theta, weights, numbers[MU], room[2], z, system, step):
            return True
        share, tried, reached = _advance(annulus, q, left, cuts, progress, step, reached, room)
        work -= tried * (count**3 + 20.0 * count * count + 100.0) + total**3 / 6.0
        _set_bound(annulus, left, cuts, progress, room)
        if numbers[BOUND] >= enough:
            return True
        lacking, left_over = enough - numbers[BOUND], numbers[MU] * (2.0 * count + total)
        if lacking < np.inf and left_over <= NEAR * lacking:
            return True
        if share > 0.3 or share == 0.0:  # as high as rounding lets it be, or nearly
            numbers[MU] *= SHRINK
        if work <= 0.0:
            return False
    return True
