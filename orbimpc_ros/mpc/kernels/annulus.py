"""Stationary points over the annulus, one after another until one is proved global.

The method of :mod:`orbimpc_ros.mpc.floors.annulus` where there is no arrival to meet: the bounds
on the headings are then independent of each other, tangents to them are known at once, and least-
squares multipliers are quotients.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.linear import quadratic, solve_spd

ITERATIONS = 80
HALVINGS = 20
RESIDUAL = 1e-10
LONGEST_STEP = 0.4
ON_BOUND = 1e-3
SMALLEST = 1e-9
GOLDEN_ANGLE = 2.399963229728653


@compiled
def _cost(hessian, q, length, z):
    total = quadratic(hessian, q, z)
    for j in range(len(q)):
        if length[j] > 0.0:
            total += length[j] * np.sqrt(z[j, 0] ** 2 + z[j, 1] ** 2)
    return total


@compiled
def _place(z, side, floor):
    """Take headings to the annulus, those near a bound onto it."""
    for k in range(len(z)):
        size = np.sqrt(z[k, 0] ** 2 + z[k, 1] ** 2)
        if size < SMALLEST:
            z[k, 0], z[k, 1], size = 1.0, 0.0, 1.0
        side[k] = 0
        if size <= floor + ON_BOUND:
            side[k] = -1
        if size >= 1.0 - ON_BOUND or floor == 1.0:
            side[k] = 1
        onto = min(max(size, floor), 1.0)
        if side[k] != 0:
            onto = 1.0 if side[k] > 0 else floor
        z[k, 0] *= onto / size
        z[k, 1] *= onto / size


@compiled
def _forces(hessian, q, length, z, side, gradient, mu):
    """Fill in gradient and multipliers; return the largest component that nothing balances."""
    worst = 0.0
    for k in range(len(q)):
        a, b = q[k, 0], q[k, 1]
        for j in range(len(q)):
            a += hessian[k, j] * z[j, 0]
            b += hessian[k, j] * z[j, 1]
        square = z[k, 0] ** 2 + z[k, 1] ** 2
        size = np.sqrt(square)
        a += length[k] * z[k, 0] / size
        b += length[k] * z[k, 1] / size
        gradient[k, 0], gradient[k, 1], mu[k] = a, b, 0.0
        if side[k] != 0:
            mu[k] = -(a * z[k, 0] + b * z[k, 1]) / square
            a += mu[k] * z[k, 0]
            b += mu[k] * z[k, 1]
        worst = max(worst, abs(a), abs(b))
    return worst


@compiled
def _direction(hessian, length, z, side, gradient, mu, move):
    """Fill in a descent direction along the bounds: Newton's, made positive definite."""
    n_steps = len(z)
    count = 0
    owner = np.empty(2 * n_steps, np.int64)
    basis = np.empty((2 * n_steps, 2))
    for k in range(n_steps):
        if side[k] != 0:
            size = np.sqrt(z[k, 0] ** 2 + z[k, 1] ** 2)
            owner[count], basis[count, 0], basis[count, 1] = k, -z[k, 1] / size, z[k, 0] / size
            count += 1
        else:
            owner[count], basis[count, 0], basis[count, 1] = k, 1.0, 0.0
            owner[count + 1], basis[count + 1, 0], basis[count + 1, 1] = k, 0.0, 1.0
            count += 2
    reduced = np.empty((count, count))
    scale = 0.0
    for i in range(count):
        for j in range(count):
            a, b = owner[i], owner[j]
            inner = basis[i, 0] * basis[j, 0] + basis[i, 1] * basis[j, 1]
            reduced[i, j] = hessian[a, b] * inner
            if a == b:
                size = np.sqrt(z[a, 0] ** 2 + z[a, 1] ** 2)
                along_i = basis[i, 0] * z[a, 0] + basis[i, 1] * z[a, 1]
                along_j = basis[j, 0] * z[a, 0] + basis[j, 1] * z[a, 1]
                reduced[i, j] += (mu[a] + length[a] / size) * inner
                reduced[i, j] -= length[a] / size**3 * along_i * along_j
        scale = max(scale, abs(reduced[i, i]))
    shift = 0.0
    right = np.empty(count)
    while True:
        system = reduced.copy()
        for i in range(count):
            system[i, i] += shift
            right[i] = -(basis[i, 0] * gradient[owner[i], 0] + basis[i, 1] * gradient[owner[i], 1])
        if solve_spd(system, right, count):
            break
        shift = max(4.0 * shift, 1e-3 * scale + 1e-12)
    move[:] = 0.0
    for i in range(count):
        move[owner[i], 0] += right[i] * basis[i, 0]
        move[owner[i], 1] += right[i] * basis[i, 1]


@compiled
def _advance(hessian, q, length, floor, z, side, move, there):
    """Take the longest share of a move that does not raise the cost, back on the bounds."""
    longest = 0.0
    for k in range(len(z)):
        longest = max(longest, np.sqrt(move[k, 0] ** 2 + move[k, 1] ** 2))
    share = min(1.0, LONGEST_STEP / max(longest, 1e-300))
    before = _cost(hessian, q, length, z)
    for _ in range(HALVINGS):
        for k in range(len(z)):
            there[k, 0] = z[k, 0] + share * move[k, 0]
            there[k, 1] = z[k, 1] + share * move[k, 1]
            if side[k] != 0:
                size = np.sqrt(there[k, 0] ** 2 + there[k, 1] ** 2)
                onto = 1.0 if side[k] > 0 else floor
                there[k, 0] *= onto / size
                there[k, 1] *= onto / size
        if _cost(hessian, q, length, there) <= before + 1e-13 * abs(before):
            break
        share *= 0.5
    z[:] = there


@compiled
def _catch(z, side, floor):
    """Put free headings that left the annulus on the bound they crossed; tell if any did."""
    caught = False
    for k in range(len(z)):
        if side[k] != 0:
            continue
        size = np.sqrt(z[k, 0] ** 2 + z[k, 1] ** 2)
        onto = size
        if size > 1.0:
            side[k], onto, caught = 1, 1.0, True
        elif size < floor:
            side[k], onto, caught = -1, floor, True
        if size < SMALLEST:
            z[k, 0], z[k, 1] = onto, 0.0
        else:
            z[k, 0] *= onto / size
            z[k, 1] *= onto / size
    return caught


@compiled
def _release(side, mu, floor, scale):
    """Let go of the heading that pulls away from its bound the most; tell if one does."""
    worst, pull = -1, -RESIDUAL * scale
    if floor < 1.0:
        for k in range(len(side)):
            if mu[k] * side[k] < pull:
                worst, pull = k, mu[k] * side[k]
    if worst >= 0:
        side[worst] = 0
    return worst >= 0


@compiled
def _doubt(hessian, length, floor, z, side, mu, residual):
    """Return by how much the optimum may undercut a stationary point (floors/annulus.py)."""
    n_steps = len(z)
    curved = hessian.copy()
    for k in range(n_steps):
        size = np.sqrt(z[k, 0] ** 2 + z[k, 1] ** 2)
        slope, theta = length[k] / size, mu[k] + length[k] / size
        if floor < 1.0:
            spread = slope - 2.0 * length[k] / (1.0 + floor)
            share = 0.0
            if side[k] != 0 and spread != 0.0:
                share = min(max(-mu[k] / spread, 0.0), 1.0)
            theta -= (1.0 - share) * slope
        curved[k, k] += theta
    least = np.linalg.eigvalsh(curved)[0]
    return 2.0 * n_steps * max(0.0, -least) + 4.0 * n_steps * residual


@compiled
def _descend(hessian, q, length, floor, z):
    """Take z to a stationary point; return whether it got there, its cost, and the doubt."""
    n_steps = len(q)
    side, mu = np.zeros(n_steps, np.int64), np.zeros(n_steps)
    gradient, move = np.empty((n_steps, 2)), np.empty((n_steps, 2))
    there = np.empty((n_steps, 2))
    scale = 1.0 + np.abs(q).max()
    _place(z, side, floor)
    for _ in range(ITERATIONS):
        residual = _forces(hessian, q, length, z, side, gradient, mu)
        if residual < RESIDUAL * scale:
            if _release(side, mu, floor, scale):
                continue
            cost = _cost(hessian, q, length, z)
            return True, cost, _doubt(hessian, length, floor, z, side, mu, residual)
        _direction(hessian, length, z, side, gradient, mu, move)
        _advance(hessian, q, length, floor, z, side, move, there)
        _catch(z, side, floor)
    return False, np.inf, np.inf


@compiled
def certified(hessian, q, constant, length, floor, tolerance, starts, more):
    """Return the best stationary point found, its cost, the best bound and the points tried.

    Args:
        hessian: H, shape (N, N).
        q: shape (N, 2).
        constant: what the cost lacks; it only scales the tolerance.
        length: weight of each |z_k|, shape (N,).
        floor: least |z_k|.
        tolerance: relative gap at which to stop.
        starts: headings to start from, shape (S, N, 2).
        more: further starts, spread evenly over directions.
    """
    best, cost, lower = starts[0].copy(), np.inf, -np.inf
    tried = 0
    for s in range(len(starts) + more):
        z = np.empty_like(best)
        if s < len(starts):
            z[:] = starts[s]
        else:
            for k in range(len(z)):
                angle = GOLDEN_ANGLE * (s + 1) * (k + 1)
                z[k, 0], z[k, 1] = np.cos(angle), np.sin(angle)
        reached, value, doubt = _descend(hessian, q, length, floor, z)
        tried += 1
        if not reached:
            continue
        lower = max(lower, value - doubt)
        if value < cost:
            cost = value
            best[:] = z
        if cost - lower <= tolerance * max(abs(cost + constant), 1e-9):
            break
    return best, cost, lower, tried
