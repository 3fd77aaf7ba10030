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

Mathematics: docs/mathematics.md, 4.5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.annulus import bound_at, mirror, reflect
from orbimpc_ros.mpc.kernels.linear import add_product, invert_spd, quadratic, solve_spd

CLIMBS = 60  # Newton steps
MU, BOUND, FIRST, TAKEN = range(4)  # in Ascent.numbers
SMALLEST = 1e-8  # mu, of the forces at work
SHRINK = 0.2  # of mu, from step to step
HALVINGS = 30


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
def _smoothed(annulus, theta, mu, least, size):
    """Return the smoothed dual function, of the Lagrangian's minimum and log det."""
    value = least + mu * size
    for k in range(len(theta)):
        value += _end(annulus.floor, annulus.length[k], theta[k], mu)[0]
    return value


@compiled
def _set_ascent(annulus, theta, mu, inverse, z, system, step):
    """Set Newton's step up the smoothed dual function, shape (N,); return whether there is one."""
    n = z.shape[1]
    for k in range(len(theta)):
        _, slope, bend = _end(annulus.floor, annulus.length[k], theta[k], mu)
        for j in range(k + 1):
            inner = 0.0
            for c in range(n):
                inner += z[k, c] * z[j, c]
            system[k, j] = (inner + mu * inverse[k, j]) * inverse[k, j]
        step[k] = 0.5 * inner + mu * inverse[k, k] + slope
        system[k, k] = (system[k, k] - bend) * (1.0 + 1e-12)
    return solve_spd(system, step, len(theta))


@compiled
def _bound(annulus, q, left, theta, z, known):
    """Return the bound that multipliers prove at the Lagrangian's minimiser, or one known."""
    nu, shares = np.zeros(len(left)), np.ones(len(theta))
    if len(left) > 0:
        force, square = q.copy(), (annulus.arrival**2).sum()
        add_product(annulus.hessian, z, 1.0, force)
        for k in range(len(theta)):
            for c in range(len(nu)):
                nu[c] -= annulus.arrival[k] * (force[k, c] + theta[k] * z[k, c]) / square
    return bound_at(annulus, q, left, z, theta, shares, nu, known)


class Ascent(NamedTuple):
    """A climb up the dual function that can be interrupted.

    Attributes:
        theta: multipliers, shape (N,).
        z: the Lagrangian's minimiser, shape (N, n).
        numbers: mu; the greatest lower bound; the first mu; Newton steps taken, shape (4,).
    """

    theta: Array
    z: Array
    numbers: Array


@compiled
def ascent(annulus, q, known):
    """Return a climb that has not begun.

    Args:
        annulus: what is minimised over.
        q: linear terms, shape (N, n).
        known: a lower bound.
    """
    scale = np.abs(q).max() + np.abs(annulus.hessian).max() + 1e-300
    numbers = np.array([scale, known, scale, 0.0])
    return Ascent(np.full(len(q), scale), np.zeros(q.shape), numbers)


@compiled
def climb(annulus, q, left, enough, progress, work):
    """Climb the dual function by Newton's method, its barrier shrinking; interruptible.

    Args:
        annulus: what is minimised over.
        q: linear terms, shape (N, n).
        left: b, shape (n,), or (0,) without an arrival.
        enough: the bound at which to stop.
        progress: updated in place.
        work: multiplications to do at most, though no less than one Newton step takes.

    Returns:
        Whether it has ended.
    """
    theta, z, numbers = progress
    count = len(theta)
    inverse, trial = np.empty((count, count)), np.empty(count)
    system, step = np.empty((count, count)), np.empty(count)
    least, size = _set_minimiser(annulus, q, left, theta, inverse, z)
    while size > -np.inf and numbers[MU] >= SMALLEST * numbers[FIRST] and numbers[TAKEN] < CLIMBS:
        numbers[TAKEN] += 1.0
        before = _smoothed(annulus, theta, numbers[MU], least, size)
        if not _set_ascent(annulus, theta, numbers[MU], inverse, z, system, step):
            return True
        share, higher = 1.0, False
        for _ in range(HALVINGS):
            trial[:] = theta + share * step
            least, size = _set_minimiser(annulus, q, left, trial, inverse, z)
            work -= count**3 + 20.0 * count * count + 100.0
            higher = _smoothed(annulus, trial, numbers[MU], least, size) >= before
            if higher:
                theta[:] = trial
                break
            share *= 0.5
        if not higher:
            least, size = _set_minimiser(annulus, q, left, theta, inverse, z)
        if share > 0.3 or not higher:  # as high as rounding lets it be, or nearly
            numbers[MU] *= SHRINK
        numbers[BOUND] = _bound(annulus, q, left, theta, z, numbers[BOUND])
        if numbers[BOUND] >= enough:
            return True
        if work <= 0.0:
            return False
    return True
