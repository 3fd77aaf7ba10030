# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Primal heuristic: descent over speeds and turns, all iterates of which are trajectories.

In the plane a heading is z_k = m_k (cos theta_k, sin theta_k). With the modulus written as
m = rho(theta) + t (1 - rho(theta)), where rho is the least speed in that direction, and
theta_k = theta_0 + d_1 + ... + d_k, floor, disk and turn rate become the box 0 <= t_k <= 1,
|d_k| <= delta. A damped Newton method descends in it: variables at a bound that the gradient pushes
against are held, all others move, and steps are projected back into the box.

A limit of the change of speed couples the moduli of neighbours. Multipliers and a penalty add it to
the cost (an augmented Lagrangian); remaining violations are clipped, for a feasible result.
An arrival is added likewise; the descent fails if it is not met.

Mathematics: docs/mathematics.md, 4.3.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.linear import largest, solve_spd
from orbimpc_ros.mpc.search.best_first import NEGLIGIBLE
from orbimpc_ros.mpc.search.relax import ARRIVED, cost_of, missed_by, misses, pulled, rise_of
from orbimpc_ros.mpc.search.ring import HALF, HIGH, LOW, TURN, least_speed

STEPS = 40  # most steps of Newton's method
SETTLED = 1e-9  # relative decrease of the cost at which it ends
DAMPED, CALMED, STIFFENED = 1e-6, 0.2, 8.0  # initial damping; factor on success; on failure
STIFFEST = 1e8
AT_BOUND = 1e-12
WITHIN = 1.0 - 1e-9  # share of the largest turn, so that rounding does not exceed it
SMALL = 1e-12  # a heading shorter than this has no direction
ROUNDS = 10  # most updates of the multipliers of changes of speed
KEPT = 1e-8  # a change too large by less needs no further round
LANDINGS = 20  # most updates of the multipliers of an arrival
# Of its weight: initially; growth if misses shrink slowly, by more than this ratio.
SOFT, HARDER, SLOWLY = 1e-3, 10.0, 0.1
STIFF, STIFFER = 10.0, 3.0  # penalty in units of the largest curvature, and its growth per round


@compiled
def _floor_along(ring, angle):
    """Return rho, the least speed along an angle [rad], its slope and its second derivative."""
    if ring.faces == 0:
        return ring.fraction, 0.0, 0.0
    share = TURN / ring.faces
    off = angle - share * np.round(angle / share)
    rho, slope = ring.fraction / np.cos(off), np.tan(off)
    return rho, rho * slope, rho * (1.0 + 2.0 * slope * slope)


@compiled
def set_headings(ring, speeds, turns, z):
    """Set headings from speeds and turns.

    Args:
        ring: floor and turn rate.
        speeds: t, shape (N,).
        turns: d, shape (N,).
        z: headings, shape (N, 2), set.
    """
    angle = ring.first
    for k in range(len(turns)):
        angle += turns[k]
        rho = least_speed(ring.fraction, ring.faces, angle)
        size = rho + speeds[k] * (1.0 - rho)
        z[k, 0], z[k, 1] = size * np.cos(angle), size * np.sin(angle)


@compiled
def round_off(ring, x, sector, speeds, turns):
    """Set speeds and turns of a trajectory near headings x within sectors.

    Args:
        ring: floor and turn rate.
        x: headings, shape (N, 2).
        sector: shape (N, 4).
        speeds: t, shape (N,), set.
        turns: d, shape (N,), set.
    """
    before = ring.first
    for k in range(len(x)):
        size = np.sqrt(x[k, 0] ** 2 + x[k, 1] ** 2)
        angle, low, high = before, sector[k, LOW], sector[k, HIGH]
        if size > SMALL:
            raw = np.arctan2(x[k, 1], x[k, 0])
            middle = min(high, max(low, before))
            angle = raw + TURN * np.round((middle - raw) / TURN)
        angle = min(high, max(low, angle))
        turn = angle - before
        if ring.widest >= HALF:
            turn -= TURN * np.round(turn / TURN)
        turns[k] = min(WITHIN * ring.widest, max(-WITHIN * ring.widest, turn))
        before += turns[k]
        rho = least_speed(ring.fraction, ring.faces, before)
        along = np.cos(before) * x[k, 0] + np.sin(before) * x[k, 1]
        speeds[k] = min(1.0, max(0.0, (along - rho) / max(SMALL, 1.0 - rho)))


@compiled
def is_paced(ring, speeds, turns):
    """Set nearby speeds that change within the limit, with headings held.

    Args:
        ring: floor and limit.
        speeds: t, shape (N,), updated.
        turns: d, shape (N,).

    Returns:
        False if there are none: along a polygon, the least speed may rise too fast.
    """
    count, change, angle = len(turns), WITHIN * ring.change, ring.first
    rho, least = np.empty(count), np.empty(count)
    for k in range(count):
        angle += turns[k]
        rho[k] = least[k] = least_speed(ring.fraction, ring.faces, angle)
    for k in range(count - 2, -1, -1):
        least[k] = max(least[k], least[k + 1] - change)
    if ring.entry + change < least[0]:
        return False
    before = ring.entry
    for k in range(count):
        wanted = max(least[k], rho[k] + speeds[k] * (1.0 - rho[k]))
        before = min(before + change, max(before - change, wanted))
        speeds[k] = min(1.0, max(0.0, (before - rho[k]) / max(SMALL, 1.0 - rho[k])))
    return True


@compiled
def _changes(ring, z, k):
    """Return the excess of the rise of speed into a step over the limit, and of the fall."""
    size, before = np.sqrt(z[k, 0] ** 2 + z[k, 1] ** 2), ring.entry
    if k > 0:
        before = np.sqrt(z[k - 1, 0] ** 2 + z[k - 1, 1] ** 2)
    return size - before - ring.change, before - size - ring.change


@compiled
def _rise(posed, ring, chain, stiff, z, there):
    """Return the rise of the augmented cost from z to other headings.

    Args:
        posed: the problem.
        ring: gives the limit of the change of speed.
        chain: multipliers of its rise and its fall at each step, shape (N, 2).
        stiff: weight of the penalty; 0 for none.
        z: headings, shape (N, 2).
        there: the other headings, shape (N, 2).
    """
    rise = rise_of(posed, z, there)
    if stiff > 0.0:
        for k in range(len(z)):
            for x, sign in ((there, 1.0), (z, -1.0)):
                rises, falls = _changes(ring, x, k)
                up, down = chain[k, 0] + stiff * rises, chain[k, 1] + stiff * falls
                rise += sign * (max(0.0, up) ** 2 + max(0.0, down) ** 2) / (2.0 * stiff)
    return rise


@compiled
def _add_changes(ring, chain, stiff, speeds, turns, z, gradient, curved):
    """Add the terms of changes of speed to gradient and Hessian in speeds and headings.

    A polygon's curvature along headings is left out, which only makes steps less accurate.
    """
    count, angle = len(turns), ring.first
    by, at = np.zeros(4), np.zeros(4, np.int64)  # derivatives of m_k in t_k, theta_k; of -m_{k-1}
    for k in range(count):
        angle += turns[k]
        rho, slope, _ = _floor_along(ring, angle)
        by[2], by[3], at[2], at[3] = -by[0], -by[1], at[0], at[1]
        by[0], by[1], at[0], at[1] = 1.0 - rho, (1.0 - speeds[k]) * slope, k, count + k
        rises, falls = _changes(ring, z, k)
        up = max(0.0, chain[k, 0] + stiff * rises)
        down = max(0.0, chain[k, 1] + stiff * falls)
        active = (1.0 if up > 0.0 else 0.0) + (1.0 if down > 0.0 else 0.0)
        if active == 0.0:
            continue
        for i in range(4 if k > 0 else 2):
            gradient[at[i]] += (up - down) * by[i]
            for j in range(4 if k > 0 else 2):
                curved[at[i], at[j]] += active * stiff * by[i] * by[j]


@compiled
def _set_model(posed, ring, chain, stiff, y, z, by, gradient, curved):
    """Set the gradient, shape (2N,), and the Hessian, shape (2N, 2N), in speeds and then turns."""
    hessian, count, angle = posed.hessian, len(z), ring.first
    for k in range(count):  # derivatives of z_k in t_k and theta_k
        angle += y[count + k]
        c, s = np.cos(angle), np.sin(angle)
        rho, slope, bend = _floor_along(ring, angle)
        size, rest = rho + y[k] * (1.0 - rho), 1.0 - y[k]
        along = rest * slope
        by[k, 0, 0], by[k, 0, 1] = (1.0 - rho) * c, (1.0 - rho) * s
        by[k, 1, 0], by[k, 1, 1] = along * c - size * s, along * s + size * c
        a, b, length = posed.q[k, 0], posed.q[k, 1], posed.lengths[k]
        for j in range(count):
            a += hessian[k, j] * z[j, 0]
            b += hessian[k, j] * z[j, 1]
        gradient[k] = a * by[k, 0, 0] + b * by[k, 0, 1] + length * (1.0 - rho)
        gradient[count + k] = a * by[k, 1, 0] + b * by[k, 1, 1] + length * along
        ahead, aside = a * c + b * s, b * c - a * s
        for j in range(k + 1):
            h = hessian[k, j]
            for e in range(2):
                for f in range(2):
                    inner = h * (by[k, e, 0] * by[j, f, 0] + by[k, e, 1] * by[j, f, 1])
                    curved[e * count + k, f * count + j] = inner
                    curved[f * count + j, e * count + k] = inner
        mixed = -slope * (ahead + length) + (1.0 - rho) * aside
        curved[count + k, k] += mixed
        curved[k, count + k] += mixed
        turned = (rest * bend - size) * ahead + 2.0 * along * aside + rest * bend * length
        curved[count + k, count + k] += turned
    if stiff > 0.0:
        _add_changes(ring, chain, stiff, y[:count], y[count:], z, gradient, curved)
    # theta_k is the sum of the turns up to k, so derivatives in turns are sums from k on.
    for k in range(count - 2, -1, -1):
        gradient[count + k] += gradient[count + k + 1]
        for j in range(2 * count):
            curved[count + k, j] += curved[count + k + 1, j]
    for k in range(count - 2, -1, -1):
        for j in range(count):
            curved[count + j, count + k] += curved[count + j, count + k + 1]


@compiled
def set_step(curved, gradient, y, bounds, damping, room, step):
    """Set Newton's step of the free variables; return their number, -1 if there is no step."""
    free, matrix, right = room
    count = 0
    for i in range(len(y)):
        step[i] = 0.0
        pushed = (y[i] <= bounds[i, 0] + AT_BOUND and gradient[i] > 0.0) or (
            y[i] >= bounds[i, 1] - AT_BOUND and gradient[i] < 0.0
        )
        if not pushed:
            free[count] = i
            count += 1
    for i in range(count):
        right[i] = -gradient[free[i]]
        for j in range(i + 1):
            matrix[i, j] = curved[free[i], free[j]]
        matrix[i, i] += damping
    if count > 0 and not solve_spd(matrix, right, count):
        return -1
    for i in range(count):
        step[free[i]] = right[i]
    return count


@compiled
def _descend(posed, ring, chain, stiff, speeds, turns, z):
    """Descend as in :func:`descend`, for given multipliers of the changes of speed."""
    count = len(z)
    size = 2 * count
    y, trial, step, gradient = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    bounds, curved, there = np.empty((size, 2)), np.empty((size, size)), np.empty((count, 2))
    room = np.empty(size, np.int64), np.empty((size, size)), np.empty(size)
    by = np.empty((count, 2, 2))
    for k in range(count):
        y[k], y[count + k] = speeds[k], turns[k]
        bounds[k, 0], bounds[k, 1] = 0.0, 1.0
        widest = WITHIN * ring.widest if k >= ring.decided else 0.0
        bounds[count + k, 0], bounds[count + k, 1] = -widest, widest
    set_headings(ring, speeds, turns, z)
    damping = DAMPED
    for _ in range(STEPS):
        _set_model(posed, ring, chain, stiff, y, z, by, gradient, curved)
        scale, fall = 1e-300, 0.0
        for i in range(size):
            scale = max(scale, abs(curved[i, i]))
        while damping <= STIFFEST:
            if set_step(curved, gradient, y, bounds, damping * scale, room, step) >= 0:
                for i in range(size):
                    trial[i] = min(bounds[i, 1], max(bounds[i, 0], y[i] + step[i]))
                set_headings(ring, trial[:count], trial[count:], there)
                fall = -_rise(posed, ring, chain, stiff, z, there)
                if fall > 0.0:
                    y, trial = trial, y
                    for k in range(count):
                        z[k, 0], z[k, 1] = there[k, 0], there[k, 1]
                    damping = max(1e-10, CALMED * damping)
                    break
            damping *= STIFFENED
        if fall <= SETTLED * max(abs(cost_of(posed, z) + posed.constant), NEGLIGIBLE):
            break
    for k in range(count):
        speeds[k], turns[k] = y[k], y[count + k]


@compiled
def _land(posed, ring, pull, speeds, turns, z):
    """Descend to a local optimum that arrives; return False on failure; see :func:`descend`."""
    stiff, last, none = SOFT * posed.stiff, np.inf, np.zeros((0, 2))
    for _ in range(LANDINGS):
        _descend(pulled(posed, pull, stiff), ring, none, 0.0, speeds, turns, z)
        missed = misses(posed, z)
        if missed <= ARRIVED:
            return True
        for c in range(2):
            pull[c] += stiff * missed_by(posed, z, c)
        if missed > SLOWLY * last:
            stiff = min(posed.stiff, HARDER * stiff)
        last = missed
    return False


@compiled
def descend(posed, ring, pull, speeds, turns, z):
    """Descend to a local optimum.

    Args:
        posed: the problem.
        ring: floor and turn rate, and the limit of the change of speed.
        pull: initial multipliers of an arrival, shape (2,), updated.
        speeds: initial t, shape (N,), updated.
        turns: initial d, shape (N,), updated.
        z: headings, shape (N, 2), set.

    Returns:
        False if no speeds were found that change within the limit, or none that arrive.
    """
    if posed.stiff > 0.0:
        return _land(posed, ring, pull, speeds, turns, z)
    chain, limited = np.zeros((len(z), 2)), ring.change < np.inf
    stiff = STIFF * largest(posed.hessian) if limited else 0.0
    for _ in range(ROUNDS):
        _descend(posed, ring, chain, stiff, speeds, turns, z)
        worst = 0.0
        for k in range(len(z) if limited else 0):
            rises, falls = _changes(ring, z, k)
            chain[k, 0] = max(0.0, chain[k, 0] + stiff * rises)
            chain[k, 1] = max(0.0, chain[k, 1] + stiff * falls)
            worst = max(worst, rises, falls)
        if worst <= KEPT:
            break
        stiff *= STIFFER
    if limited:
        if not is_paced(ring, speeds, turns):
            return False
        set_headings(ring, speeds, turns, z)
    return True
