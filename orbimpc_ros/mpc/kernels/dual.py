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
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.annulus import _mirror, _reflect, bound_at
from orbimpc_ros.mpc.kernels.linear import quadratic, solve_spd

SMALLEST = 1e-8  # mu, of the forces at work
SHRINK = 0.2  # of mu, from step to step
HALVINGS = 30


@compiled
def _inverse(annulus, theta, arrives, inverse):
    """Set P, shape (N, N); return log det of the matrix that it inverts, -inf if not positive."""
    count = len(theta)
    matrix = annulus.hessian.copy()
    for k in range(count):
        matrix[k, k] += theta[k]
    first = 1 if arrives else 0
    reflector = np.zeros(count)
    if arrives:
        row = annulus.arrival.copy().reshape((count, 1))
        _reflect(row, count, 0, reflector)
        _mirror(matrix, count, reflector)
        _mirror(matrix.T, count, reflector)
    free = np.ascontiguousarray(matrix[first:, first:])
    if not solve_spd(free.copy(), np.zeros(count - first), count - first):
        return -np.inf
    inverse[:] = 0.0
    inverse[first:, first:] = np.linalg.inv(free)
    if arrives:
        _mirror(inverse, count, reflector)
        _mirror(inverse.T, count, reflector)
    return np.linalg.slogdet(free)[1]


@compiled
def _set_least(annulus, q, left, theta, inverse, z):
    """Set z to the minimiser for multipliers, shape (N, n); return its value."""
    matrix = annulus.hessian.copy()
    for k in range(len(theta)):
        matrix[k, k] += theta[k]
    z[:] = 0.0
    if len(left) > 0:
        square = (annulus.arrival**2).sum()
        for k in range(len(z)):
            for c in range(len(left)):
                z[k, c] = annulus.arrival[k] * left[c] / square
    z -= inverse @ (q + matrix @ z)
    return quadratic(matrix, q, z)


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
def _value(annulus, q, left, theta, mu, inverse, z):
    """Return the smoothed dual function, -inf outside its domain; set P and z."""
    size = _inverse(annulus, theta, len(left) > 0, inverse)
    if size == -np.inf:
        return -np.inf
    value = _set_least(annulus, q, left, theta, inverse, z) + mu * size
    for k in range(len(theta)):
        value += _end(annulus.floor, annulus.length[k], theta[k], mu)[0]
    return value


@compiled
def climb(annulus, q, left, theta, z, numbers):
    """Take one Newton step up the dual function; return the bound there.

    Args:
        annulus: what is minimised over.
        q: linear terms, shape (N, n).
        left: b, shape (n,), or (0,) without an arrival.
        theta: multipliers, shape (N,), updated in place; to begin with all positive.
        z: set to the Lagrangian's minimiser, shape (N, n).
        numbers: mu, shape (1,), updated in place.
    """
    count, mu = len(theta), numbers[0]
    inverse, trial = np.empty((count, count)), np.empty(count)
    before = _value(annulus, q, left, theta, mu, inverse, z)
    system, step = np.empty((count, count)), np.empty(count)
    for k in range(count):
        _, slope, bend = _end(annulus.floor, annulus.length[k], theta[k], mu)
        step[k] = 0.5 * (z[k] @ z[k]) + mu * inverse[k, k] + slope
        for j in range(k + 1):
            system[k, j] = (z[k] @ z[j]) * inverse[k, j] + mu * inverse[k, j] ** 2
        system[k, k] -= bend
        system[k, k] *= 1.0 + 1e-12
    if not solve_spd(system, step, count):
        numbers[0] = 0.0
        return -np.inf
    share = 1.0
    for _ in range(HALVINGS):
        trial[:] = theta + share * step
        if _value(annulus, q, left, trial, mu, inverse, z) >= before:
            theta[:] = trial
            break
        share *= 0.5
    if share > 0.3:
        numbers[0] *= SHRINK
    _value(annulus, q, left, theta, mu, inverse, z)
    nu, square = np.zeros(len(left)), (annulus.arrival**2).sum()
    for c in range(len(nu)):
        for k in range(count):
            total = q[k, c] + theta[k] * z[k, c]
            for j in range(count):
                total += annulus.hessian[k, j] * z[j, c]
            nu[c] -= annulus.arrival[k] * total / square
    return bound_at(annulus, q, left, z, theta, np.ones(count), nu)
