# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planar hull over long horizons: linear-quadratic sweeps and the method of multipliers.

For n = 2 and rotation order 1 the problem is a linear-quadratic one in the state (s, R e1), or
(s, p, R e1) at translation order 2, but for the disks |R_k e1| <= 1. The augmented Lagrangian
replaces each disk by a smooth penalty with multiplier y_k, 1/2 sigma dist(R_k e1 + y_k/sigma)^2,
whose generalised Hessian is a 2 x 2 block of that step alone. A Newton step is then a
linear-quadratic problem itself: one sweep back and one forth (Riccati), linear in N.

For any y, the least of the cost plus y . R e1, by one more sweep, less the sum of |y_k| is a lower
bound.

Mathematics: docs/mathematics.md, 4.2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled, entry_point
from orbimpc_ros.mpc.kernels.penalty import (
    BEST,
    ENOUGH,
    HALVINGS,
    PAUSED,
    PROMISED,
    SETTLED,
    SIGMA,
    STALLED,
    STEPS,
    STUCK,
    TAKEN,
    descends,
    stiffen,
)

LIMIT = 150  # Newton steps and updates of the multipliers
NOTHING = 1e-20  # a minimum is near enough where so little is left


@compiled
def _back(along, turning, weights, goals, wish, bent, pulled, gain, offset):
    """Sweep back (Riccati recursion): set the feedback u = gain . state + offset of every step.

    Args:
        along: A, shape (m, m).
        turning: weight on |u|^2.
        weights: on |s_k - g_k|^2, shape (N,).
        goals: g_1..g_N, shape (N, 2).
        wish: weight on |R_N e1 - R_g e1|^2, and R_g e1; shape (3,).
        bent: Hessian of the penalty of each disk, shape (N, 2, 2).
        pulled: its gradient where R_k e1 vanishes, shape (N, 2).
        gain: to be set, shape (N, 2, m, 2).
        offset: to be set, shape (N, 2).
    """
    m, last = len(along), len(along) - 1
    value, slope = np.zeros((m, 2, m, 2)), np.zeros((m, 2))
    ahead, leaning = np.zeros((m, 2, m, 2)), np.zeros((m, 2))
    seen = np.zeros((2, m, 2))
    for a in range(2):
        value[last, a, last, a] = 2.0 * wish[0]
        slope[last, a] = -2.0 * wish[0] * wish[1 + a]
    for k in range(len(goals) - 1, -1, -1):
        for a in range(2):  # what is to be paid at step k + 1
            value[0, a, 0, a] += 2.0 * weights[k]
            slope[0, a] -= 2.0 * weights[k] * goals[k, a]
            slope[last, a] += pulled[k, a]
            for b in range(2):
                value[last, a, last, b] += bent[k, a, b]
        p, q = 2.0 * turning + value[last, 0, last, 0], value[last, 0, last, 1]
        s = 2.0 * turning + value[last, 1, last, 1]
        size = p * s - q * q
        p, q, s = s / size, -q / size, p / size
        for a in range(2):
            for j in range(m):
                for b in range(2):
                    seen[a, j, b] = 0.0
                    for i in range(m):
                        seen[a, j, b] += value[last, a, i, b] * along[i, j]
        offset[k, 0] = -p * slope[last, 0] - q * slope[last, 1]
        offset[k, 1] = -q * slope[last, 0] - s * slope[last, 1]
        for j in range(m):
            for b in range(2):
                gain[k, 0, j, b] = -p * seen[0, j, b] - q * seen[1, j, b]
                gain[k, 1, j, b] = -q * seen[0, j, b] - s * seen[1, j, b]
        _carry(along, value, slope, seen, gain[k], offset[k], ahead, leaning)
        value[:], slope[:] = ahead, leaning


@compiled
def _carry(along, value, slope, seen, gain, offset, ahead, leaning):
    """Set value and slope a step earlier: A'PA + S'K and A'p + S'k."""
    m = len(along)
    for i in range(m):
        for a in range(2):
            total = seen[0, i, a] * offset[0] + seen[1, i, a] * offset[1]
            for c in range(m):
                total += along[c, i] * slope[c, a]
            leaning[i, a] = total
            for j in range(m):
                for b in range(2):
                    total = seen[0, i, a] * gain[0, j, b] + seen[1, i, a] * gain[1, j, b]
                    for c in range(m):
                        for e in range(m):
                            total += along[c, i] * value[c, a, e, b] * along[e, j]
                    ahead[i, a, j, b] = total


@compiled
def _forth(along, start, gain, offset, z):
    """Set z_1..z_N to what the feedback leads to from a start."""
    m = len(along)
    state, after = start.copy(), np.empty_like(start)
    for k in range(len(z)):
        for a in range(2):
            for i in range(m):
                after[i, a] = 0.0
                for j in range(m):
                    after[i, a] += along[i, j] * state[j, a]
            after[m - 1, a] += offset[k, a]
            for j in range(m):
                for b in range(2):
                    after[m - 1, a] += gain[k, a, j, b] * state[j, b]
        state[:] = after
        z[k] = state[m - 1]


@compiled
def _cost(along, start, turning, weights, goals, wish, z):
    """Return the cost of z_1..z_N, shape (N, 2)."""
    m = len(along)
    state, after = start.copy(), np.empty_like(start)
    total = 0.0
    for k in range(len(z)):
        for a in range(2):
            for i in range(m):
                after[i, a] = 0.0
                for j in range(i, m):
                    after[i, a] += along[i, j] * state[j, a]
            turn, after[m - 1, a] = z[k, a] - after[m - 1, a], z[k, a]
            miss = after[0, a] - goals[k, a]
            total += turning * turn * turn + weights[k] * miss * miss
        state[:] = after
    for a in range(2):
        total += wish[0] * (state[m - 1, a] - wish[1 + a]) ** 2
    return total


@compiled
def _slope(along, start, turning, weights, goals, wish, z, target):
    """Return the derivative of the cost at z along target - z."""
    m = len(along)
    state, moving = start.copy(), np.zeros_like(start)
    after, moved = np.empty_like(start), np.empty_like(start)
    total = 0.0
    for k in range(len(z)):
        for a in range(2):
            for i in range(m):
                after[i, a] = moved[i, a] = 0.0
                for j in range(i, m):
                    after[i, a] += along[i, j] * state[j, a]
                    moved[i, a] += along[i, j] * moving[j, a]
            change = target[k, a] - z[k, a]
            total += 2.0 * turning * (z[k, a] - after[m - 1, a]) * (change - moved[m - 1, a])
            total += 2.0 * weights[k] * (after[0, a] - goals[k, a]) * moved[0, a]
            after[m - 1, a], moved[m - 1, a] = z[k, a], change
        state[:], moving[:] = after, moved
    for a in range(2):
        total += 2.0 * wish[0] * (state[m - 1, a] - wish[1 + a]) * moving[m - 1, a]
    return total


@compiled
def _project(z, held, sigma, new, bent):
    """Set the multipliers that the penalty exerts, and its Hessian.

    Returns the term's value, |new - held|^2 and the violation.
    """
    value = moved = worst = 0.0
    for k in range(len(z)):
        a, b = z[k, 0] + held[k, 0] / sigma, z[k, 1] + held[k, 1] / sigma
        size = np.sqrt(a * a + b * b)
        if size <= 1.0:
            new[k] = 0.0
            bent[k] = 0.0
        else:
            a, b = a / size, b / size
            push = sigma * (size - 1.0)
            new[k, 0], new[k, 1] = push * a, push * b
            flat = sigma * (1.0 - 1.0 / size)
            bent[k, 0, 0] = flat + (sigma - flat) * a * a
            bent[k, 1, 1] = flat + (sigma - flat) * b * b
            bent[k, 0, 1] = bent[k, 1, 0] = (sigma - flat) * a * b
            value += push * (a * z[k, 0] + b * z[k, 1] - 1.0)
        change = (new[k, 0] - held[k, 0]) ** 2 + (new[k, 1] - held[k, 1]) ** 2
        moved += change
        worst = max(worst, change)
    return value, moved, np.sqrt(worst) / sigma


@compiled
def _dual(chain, held, none, gain, offset, z):
    """Return the lower bound that multipliers give; z is set to where it is taken."""
    along, start, turning, weights, goals, wish = chain
    _back(along, turning, weights, goals, wish, none, held, gain, offset)
    _forth(along, start, gain, offset, z)
    value = _cost(along, start, turning, weights, goals, wish, z)
    for k in range(len(z)):
        value += held[k, 0] * z[k, 0] + held[k, 1] * z[k, 1]
        value -= np.sqrt(held[k, 0] ** 2 + held[k, 1] ** 2)
    return value


class Chain(NamedTuple):
    """A linear-quadratic problem in the state (s, R e1), or (s, p, R e1), for each coordinate.

    Attributes:
        along: A, shape (m, m): the state one step on; R e1 is its last part.
        start: the state at first, shape (m, 2).
        turning: weight on |R_{k+1} e1 - R_k e1|^2.
        weights: on |s_k - g_k|^2, shape (N,).
        goals: g_1..g_N, shape (N, 2).
        wish: weight on |R_N e1 - R_g e1|^2, and R_g e1; shape (3,).
    """

    along: Array
    start: Array
    turning: float
    weights: Array
    goals: Array
    wish: Array


@compiled
def minimise(chain, limits, progress, lowest, work):
    """Minimise the cost over headings in their disks, on from where the progress is.

    By Newton's method on the augmented Lagrangian, each step a Riccati recursion.

    Args:
        chain: what to minimise.
        limits: on the violation of a disk; on the gap, in proportion to the cost; what rounding
            may make of the gap; the largest sigma.
        progress: its x are z_1..z_N, shape (N, 2), its held the multipliers of their disks;
            updated in place.
        lowest: set to the minimiser of the Lagrangian that gives the greatest bound, shape (N, 2).
        work: Newton steps and updates of the multipliers to make at most.

    Returns:
        The cost of ``progress.x``, which may be outside the disks by the limit, and ``SETTLED``,
        ``STALLED`` or ``PAUSED``.
    """
    along, start, turning, weights, goals, wish = chain
    precision, proportion, rounding, largest = limits
    z, held, numbers, counts = progress
    count, m = len(goals), len(along)
    gain, offset = np.empty((count, 2, m, 2)), np.empty((count, 2))
    none, bent = np.zeros((count, 2, 2)), np.empty((count, 2, 2))
    new, pulled = np.empty((count, 2)), np.empty((count, 2))
    target, trial = np.empty((count, 2)), np.empty((count, 2))
    if counts[STEPS] == 0:
        numbers[BEST] = _dual(chain, held, none, gain, offset, z)
        lowest[:] = z
    quadratic = _cost(along, start, turning, weights, goals, wish, z)
    value, moved, worst = _project(z, held, numbers[SIGMA], new, bent)
    for _ in range(work):
        if counts[STEPS] >= LIMIT:
            return quadratic, STALLED
        counts[STEPS] += 1
        near = numbers[PROMISED] <= max(NOTHING, ENOUGH * moved / numbers[SIGMA])
        if worst <= precision or near:
            bound = _dual(chain, new, none, gain, offset, target)
            if bound > numbers[BEST]:
                numbers[BEST], lowest[:] = bound, target
            gap = quadratic - numbers[BEST]
            if worst <= precision and gap <= proportion * quadratic + rounding:
                return quadratic, SETTLED
        if near or counts[TAKEN] == STUCK:
            if near:
                held[:] = new
            stiffen(progress, near, largest)
            value, moved, worst = _project(z, held, numbers[SIGMA], new, bent)
            continue
        counts[TAKEN] += 1
        for k in range(count):
            for a in range(2):
                pulled[k, a] = new[k, a] - bent[k, a, 0] * z[k, 0] - bent[k, a, 1] * z[k, 1]
        _back(along, turning, weights, goals, wish, bent, pulled, gain, offset)
        _forth(along, start, gain, offset, target)
        merit = quadratic + value - 0.5 * moved / numbers[SIGMA]
        decrease = -_slope(along, start, turning, weights, goals, wish, z, target)
        for k in range(count):
            for a in range(2):
                decrease -= new[k, a] * (target[k, a] - z[k, a])
        numbers[PROMISED] = decrease
        share = 1.0
        for _ in range(HALVINGS):
            trial[:] = z + share * (target - z)
            quadratic = _cost(along, start, turning, weights, goals, wish, trial)
            value, moved, worst = _project(trial, held, numbers[SIGMA], new, bent)
            reached = quadratic + value - 0.5 * moved / numbers[SIGMA]
            if descends(reached, merit, share, decrease):
                break
            share *= 0.5
        z[:] = trial
    return quadratic, PAUSED


@entry_point
def within(chain, z):
    """Pull headings into their disks; return their cost.

    Args:
        chain: gives the cost.
        z: z_1..z_N, shape (N, 2), updated in place.
    """
    for k in range(len(z)):
        z[k] /= max(1.0, np.sqrt(z[k, 0] ** 2 + z[k, 1] ** 2))
    return _cost(chain.along, chain.start, chain.turning, chain.weights, chain.goals, chain.wish, z)


@entry_point
def settle(chain, limits, progress, lowest, work):
    """Do as :func:`minimise`; once that is over, pull the headings into their disks as well.

    In one call, since to pass the arrays takes as long as the minimisation of a short horizon. For
    arguments and result see there.
    """
    cost, status = minimise(chain, limits, progress, lowest, work)
    if status != PAUSED:
        cost = within(chain, progress.x)
    return cost, status
