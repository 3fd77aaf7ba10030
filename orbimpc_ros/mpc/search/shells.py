# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Primal heuristic for round floors: descent over shells, floor <= |z_k| <= 1.

The variables are the modulus of each heading, between its bounds, and its direction, in the tangent
plane of the sphere. A damped Newton method descends in these; a modulus on a bound that the
gradient pushes against is held. Multipliers and a penalty add an arrival a z = b to the cost (an
augmented Lagrangian).

Mathematics: docs/mathematics.md, 4.4.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.linear import copy_to, set_basis
from orbimpc_ros.mpc.search.best_first import NEGLIGIBLE
from orbimpc_ros.mpc.search.local import CALMED, DAMPED, SETTLED, STIFFENED, STIFFEST, set_step
from orbimpc_ros.mpc.search.relax import (
    ARRIVED,
    cost_of,
    length_of,
    missed_by,
    misses,
    rise_of,
    settle,
)

SWEEPS, STILL = 50, 1e-4  # most sweeps over the headings; they end when none moves by more
SWEEP = 10.0  # typical number of sweeps in a round
STEPS = 40  # most Newton steps in a round
LOST = 1e-4  # share of a settled decrease: smaller expected ones are lost in rounding
CALMEST = 1e-14  # least damping
LONGEST = 0.5  # longest step of a heading, on average
ROUNDS = 20  # most updates of the multipliers of an arrival
SOFT, STIFFER = 1e-3, 10.0  # of the arrival's weight: initially; growth if misses shrink slowly
SLOW = 0.1  # ratio of successive misses above which they shrink slowly
PROJECTIONS = 1000  # most alternating projections, onto arrival and shells
TINY = 1e-12  # a heading shorter than this has no direction


ACTIVE, DAMPING, STIFF, MISSED, TAKEN, ROUND = range(6)  # in Descent.numbers


class Descent(NamedTuple):
    """A descent, which may be interrupted.

    Attributes:
        z: the current headings, shape (N, n).
        pull: multipliers of the arrival, shape (n,).
        numbers: whether it is active; damping; weight of the arrival; its last miss; steps in this
            round of multipliers; rounds; shape (6,).
    """

    z: Array
    pull: Array
    numbers: Array


@compiled
def _put(posed, z):
    """Project headings onto the shells."""
    for k in range(len(z)):
        size = length_of(z, k)
        if size < TINY:
            z[k, :] = 0.0
            z[k, 0] = size = 1.0
        onto = min(1.0, max(posed.floor, size)) / size
        for c in range(z.shape[1]):
            z[k, c] *= onto


@compiled
def arrive(posed, z):
    """Set headings that arrive, alternating about the straight path; return False on failure."""
    (count, n), by = z.shape, np.zeros((z.shape[1], z.shape[1]))
    far, way = np.sqrt((posed.left**2).sum()), posed.arrival.sum()
    copy_to(by[0], posed.left)
    set_basis(by)
    speed = min(1.0, max(posed.floor, far / way))
    ahead = min(speed, far / way)
    aside = np.sqrt(speed * speed - ahead * ahead)
    for k in range(count):
        for c in range(n):
            z[k, c] = ahead * by[0, c] + (aside if k % 2 == 0 else -aside) * by[1, c]
    return land(posed, z)


@compiled
def land(posed, z):
    """Project headings alternately onto the shells and the arrival; return False on failure."""
    for _ in range(PROJECTIONS):
        _put(posed, z)
        if misses(posed, z) <= ARRIVED:
            return True
        settle(posed, z)
    return False


@compiled
def _slope(posed, stiff, pull, z, k, c):
    """Return the derivative in z_k along an axis of the cost without lengths, and the arrival's."""
    slope = posed.q[k, c]
    for j in range(len(z)):
        slope += posed.hessian[k, j] * z[j, c]
    if stiff > 0.0:
        slope += posed.arrival[k] * (pull[c] + stiff * missed_by(posed, z, c))
    return slope


@compiled
def _sweep(posed, stiff, pull, z):
    """Move each heading in turn to the minimiser of the cost over its shell."""
    (count, n), slope = z.shape, np.empty(z.shape[1])
    for _ in range(SWEEPS):
        moved = 0.0
        for k in range(count):
            a, square = posed.arrival[k], 0.0
            h = posed.hessian[k, k] + stiff * a * a
            for c in range(n):
                slope[c] = _slope(posed, stiff, pull, z, k, c) - h * z[k, c]
                square += slope[c] * slope[c]
            size = np.sqrt(square)
            if size == 0.0:
                continue
            onto = min(1.0, max(posed.floor, (size - posed.lengths[k]) / h))
            for c in range(n):
                there = -onto * slope[c] / size
                moved = max(moved, abs(there - z[k, c]))
                z[k, c] = there
        if moved <= STILL:
            break


@compiled
def _rise(posed, stiff, pull, z, there):
    """Return the rise of the augmented cost from z to other headings."""
    rise = rise_of(posed, z, there)
    for c in range(z.shape[1] if stiff > 0.0 else 0):
        before, after = missed_by(posed, z, c), missed_by(posed, there, c)
        rise += (after - before) * (pull[c] + 0.5 * stiff * (after + before))
    return rise


@compiled
def _set_model(posed, stiff, pull, z, by, gradient, curved):
    """Set the gradient and the Hessian's lower triangle, in moduli and steps along tangents.

    Args:
        posed: the problem.
        stiff: weight of the arrival.
        pull: its multipliers, shape (n,).
        z: headings on the shells, shape (N, n).
        by: their directions, and tangents of the headings' lengths, shape (N, n, n), set.
        gradient: shape (n N,), set.
        curved: shape (n N, n N), set.
    """
    (count, n), slope = z.shape, np.empty(z.shape[1])
    for k in range(count):
        size, a = length_of(z, k), posed.arrival[k]
        for c in range(n):
            by[k, 0, c] = z[k, c]
            slope[c] = _slope(posed, stiff, pull, z, k, c)
        set_basis(by[k])
        for e in range(n):
            gradient[n * k + e] = posed.lengths[k] if e == 0 else 0.0
            for c in range(n):
                by[k, e, c] *= size if e > 0 else 1.0
                gradient[n * k + e] += slope[c] * by[k, e, c]
        for j in range(k + 1):
            h = posed.hessian[k, j] + stiff * a * posed.arrival[j]
            for e in range(n):
                for f in range(n):
                    inner = 0.0
                    for c in range(n):
                        inner += by[k, e, c] * by[j, f, c]
                    curved[n * k + e, n * j + f] = h * inner
        ahead = gradient[n * k] - posed.lengths[k]
        for e in range(1, n):
            curved[n * k + e, n * k + e] -= size * ahead
            curved[n * k + e, n * k] += gradient[n * k + e] / size


@compiled
def _move(posed, z, by, step, there):
    """Set headings moved by a step, the moduli kept within their bounds."""
    for k in range(len(z)):
        n, size, square = z.shape[1], length_of(z, k), 0.0
        for e in range(1, n):
            square += step[n * k + e] ** 2
        angle = np.sqrt(square)
        onto = min(1.0, max(posed.floor, size + step[n * k]))
        aside = np.sin(angle) / angle if angle > 0.0 else 1.0
        for c in range(n):
            there[k, c] = onto * np.cos(angle) * by[k, 0, c]
            for e in range(1, n):
                there[k, c] += onto * aside * step[n * k + e] * by[k, e, c] / size


@compiled
def _newton_step(posed, descent, room):
    """Take a Newton step for given multipliers of the arrival.

    Returns:
        True if the descent has settled, and the number of systems solved.
    """
    by, gradient, curved, step, y, bounds, free, there = room
    z, numbers, pull = descent.z, descent.numbers, descent.pull
    (count, n), stiff, tried = z.shape, numbers[STIFF], 0
    _set_model(posed, stiff, pull, z, by, gradient, curved)
    settled = SETTLED * max(abs(cost_of(posed, z) + posed.constant), NEGLIGIBLE)
    scale, fall = 1e-300, 0.0
    for k in range(count):
        y[n * k] = length_of(z, k)
        scale = max(scale, posed.hessian[k, k])
    while numbers[DAMPING] <= STIFFEST:
        expected, square, tried = 0.0, np.inf, tried + 1
        if set_step(curved, gradient, y, bounds, numbers[DAMPING] * scale, free, step) >= 0:
            square = 0.0
            for i in range(len(step)):
                square += step[i] * step[i]
                expected -= 0.5 * step[i] * gradient[i]
        if square <= count * LONGEST * LONGEST:
            _move(posed, z, by, step, there)
            fall = -_rise(posed, stiff, pull, z, there)
            if fall > 0.0 or expected <= LOST * settled:
                copy_to(z, there)
                numbers[DAMPING] = max(CALMEST, CALMED * numbers[DAMPING])
                break
        numbers[DAMPING] *= STIFFENED
    return fall <= settled, tried


@compiled
def _end_round(posed, descent):
    """Update the multipliers of the arrival, and raise its weight if misses shrink slowly."""
    pull, numbers = descent.pull, descent.numbers
    before, missed = numbers[MISSED], misses(posed, descent.z)
    for c in range(len(pull) if posed.stiff > 0.0 else 0):
        pull[c] += numbers[STIFF] * missed_by(posed, descent.z, c)
    if missed > SLOW * before:
        numbers[STIFF] = min(posed.stiff, STIFFER * numbers[STIFF])
    numbers[MISSED], numbers[TAKEN], numbers[ROUND] = missed, 0.0, numbers[ROUND] + 1.0
    if missed <= ARRIVED or numbers[ROUND] == ROUNDS:
        numbers[ACTIVE] = 0.0


@compiled
def set_out(posed, descent, pull):
    """Begin a descent from its current headings, which may have any length.

    Args:
        posed: the problem.
        descent: its headings are set.
        pull: initial multipliers of the arrival, shape (n,).
    """
    numbers = descent.numbers
    _put(posed, descent.z)
    copy_to(descent.pull, pull)
    numbers[ACTIVE], numbers[STIFF], numbers[MISSED] = 1.0, SOFT * posed.stiff, np.inf
    numbers[TAKEN] = numbers[ROUND] = 0.0


@compiled
def descend(posed, descent, work):
    """Descend to a stationary point.

    Args:
        posed: the problem.
        descent: updated; it has ended when it is no longer active.
        work: multiplications to do; one Newton step is done at least.

    Returns:
        The remaining multiplications.
    """
    (count, n), numbers = descent.z.shape, descent.numbers
    size = n * count
    y, bounds = np.zeros(size), np.empty((size, 2))
    bounds[:, 0], bounds[:, 1] = -np.inf, np.inf
    bounds[::n, 0], bounds[::n, 1] = posed.floor, 1.0
    free = np.empty(size, np.int64), np.empty((size, size)), np.empty(size)
    by, gradient, curved = np.empty((count, n, n)), np.empty(size), np.empty((size, size))
    room = by, gradient, curved, np.empty(size), y, bounds, free, np.empty((count, n))
    while numbers[ACTIVE] > 0.0 and work > 0.0:
        if numbers[TAKEN] == 0.0:
            _sweep(posed, numbers[STIFF], descent.pull, descent.z)
            numbers[DAMPING] = DAMPED
            work -= SWEEP * n * count * count
        settled, tried = _newton_step(posed, descent, room)
        numbers[TAKEN] += 1.0
        work -= tried * (size**3 / 6.0 + 500.0) + 3.0 * size * size
        if settled or numbers[TAKEN] == STEPS:
            _end_round(posed, descent)
    return work
