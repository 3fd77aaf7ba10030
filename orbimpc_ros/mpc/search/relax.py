# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The relaxation of a node: a convex quadratic over the hulls of its stage sets.

Block coordinate descent (by proximal maps of single steps) identifies the active faces, and a
Newton step moves along all of them at once. If that stalls, an interior-point method takes over. At
whatever point this ends, the minimum of the cost's tangent over the sets themselves has a closed
form: a lower bound.

Mathematics: docs/mathematics.md, 4.3.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.linear import copy_to, solve_spd
from orbimpc_ros.mpc.search.best_first import NEGLIGIBLE
from orbimpc_ros.mpc.search.interior import (
    BLOCKED,
    CENTRED,
    LIMITS,
    LONG,
    STEPS,
    move_inside,
    set_depths,
    set_inside,
    set_system,
)
from orbimpc_ros.mpc.search.ring import FREE, INNER, OUTLINE, POINT, RIM, prox, support

SOLVED, PRUNED, STALLED, GOING = range(4)  # outcomes of a relaxation
PATIENCE = 2  # rounds between checks of whether the bound still rises
RISES = 0.1  # least rise, as a share of the gap
LONGEST = 1e7  # most multiplications without a check of the deadline
ON = 1e-12  # relative: so close to the least speed, a length does not pull
ROUNDING = 1e-15  # relative error of terms that cancel
HALVINGS, SHRINK = 6, 0.4
ARRIVED = 1e-9  # in units of a step's length: smaller misses of an arrival do not count
SPACES = 4  # number of working memories that are kept


class StageProblem(NamedTuple):
    """1/2 sum_jk H_jk z_j . z_k + sum_k q_k . z_k + sum_k l_k |z_k|, maybe with sum_k a_k z_k = b.

    Attributes:
        hessian: H, positive definite, shape (N, N).
        inverse: of H, shape (N, N).
        q: shape (N, n).
        lengths: l >= 0, shape (N,).
        constant: omitted from the cost; it only scales tolerances.
        floor: the least modulus.
        arrival: a, shape (N,); zeros without an arrival.
        left: b, shape (n,).
        stiff: weight on |a z - b|^2 / 2 in computations; 0 without an arrival.
    """

    hessian: Array
    inverse: Array
    q: Array
    lengths: Array
    constant: float
    floor: float
    arrival: Array
    left: Array
    stiff: float


class Room(NamedTuple):
    """Working memory of a relaxation.

    Attributes:
        slope: H z + q, shape (N, 2).
        shapes: outlines of a node's sectors, shape (N, 12).
        parts: those of a child's, shape (N, 12).
        changed: whether a child's outline differs from its parent's, shape (N,).
        faces: of each heading, the face that contains it, shape (N,).
        along: directions of these faces, shape (N, 2).
        trial: a trial point, shape (N, 2).
        other: another, shape (N, 2).
        steps: index of the heading of each free direction, shape (2N,).
        basis: the free directions, shape (2N, 2).
        system: matrix of a Newton step, shape (2N, 2N).
        right: its right-hand side, then the step, shape (2N,).
        speeds: of a trajectory under construction, shape (N,).
        turns: of the same, shape (N,).
    """

    slope: Array
    shapes: Array
    parts: Array
    changed: np.ndarray
    faces: np.ndarray
    along: Array
    trial: Array
    other: Array
    steps: np.ndarray
    basis: Array
    system: Array
    right: Array
    speeds: Array
    turns: Array


@lru_cache(maxsize=SPACES)
def room_for(thread: int, steps: int) -> Room:
    """Return working memory for N = ``steps`` headings, which is the same for all of a thread."""
    n, size, pair, outlines = steps, 2 * steps, (steps, 2), (steps, OUTLINE)
    headings = pair, outlines, outlines, n, n, pair, pair, pair
    shapes = *headings, size, (size, 2), (size, size), size, n, n
    made = Room._make(np.zeros(each) for each in shapes)
    faces, indices = np.zeros(n, np.int64), np.zeros(size, np.int64)
    return made._replace(changed=np.zeros(n, np.bool_), faces=faces, steps=indices)


@compiled
def missed_by(posed, z, c):
    """Return the miss of the arrival along an axis."""
    missed = -posed.left[c]
    for k in range(len(z)):
        missed += posed.arrival[k] * z[k, c]
    return missed


@compiled
def misses(posed, z):
    """Return the largest miss of the arrival along an axis."""
    most = 0.0
    for c in range(len(posed.left) if posed.stiff > 0.0 else 0):
        most = max(most, abs(missed_by(posed, z, c)))
    return most


@compiled
def settle(posed, z):
    """Move headings by as little as possible onto the arrival, if there is one."""
    square = 0.0
    for a in posed.arrival:
        square += a * a
    for c in range(z.shape[1] if posed.stiff > 0.0 else 0):
        share = missed_by(posed, z, c) / square
        for k in range(len(z)):
            z[k, c] -= share * posed.arrival[k]


@compiled
def pulled(posed, pull, stiff):
    """Return a problem with multipliers of its arrival, and a penalty, in the cost instead.

    Args:
        posed: the problem, maybe without an arrival.
        pull: multipliers, shape (n,).
        stiff: weight of the penalty.
    """
    hessian, q, constant, a = posed.hessian.copy(), posed.q.copy(), posed.constant, posed.arrival
    for c in range(len(posed.left)):
        left = posed.left[c]
        constant += (0.5 * stiff * left - pull[c]) * left
        for k in range(len(a)):
            q[k, c] += a[k] * (pull[c] - stiff * left)
    for j in range(len(a)):
        for k in range(len(a)):
            hessian[j, k] += stiff * a[j] * a[k]
    cost = hessian, posed.inverse, q, posed.lengths, constant
    return StageProblem(*cost, posed.floor, a, posed.left, posed.stiff)


@compiled
def set_slope(hessian, q, z, slope):
    """Set H z + q."""
    count = len(z)
    for j in range(count):
        a, b = q[j, 0], q[j, 1]
        for k in range(count):
            a += hessian[j, k] * z[k, 0]
            b += hessian[j, k] * z[k, 1]
        slope[j, 0], slope[j, 1] = a, b


@compiled
def tangent_bound(posed, shapes, z, slope):
    """Return the relaxed cost at a point, and a bound: its tangent's minimum over the sets.

    Args:
        posed: the problem.
        shapes: outlines, shape (N, 12).
        z: tangent point, shape (N, 2).
        slope: H z + q, shape (N, 2).
    """
    cost = least = size = 0.0
    for k in range(len(z)):
        gx, gy, x, y, length = slope[k, 0], slope[k, 1], z[k, 0], z[k, 1], posed.lengths[k]
        half = 0.5 * (x * (gx + posed.q[k, 0]) + y * (gy + posed.q[k, 1]))
        along = gx * x + gy * y
        there = support(shapes[k], length, gx, gy)
        cost += half + length * max(shapes[k, INNER], np.sqrt(x * x + y * y))
        least += half + there - along
        size += abs(half) + abs(there) + abs(along)
    return cost, least - ROUNDING * len(z) * size


@compiled
def _sweep(posed, shapes, z, room):
    """Move each heading in turn to its proximal map, and update the slope."""
    hessian, slope, count = posed.hessian, room.slope, len(z)
    for k in range(count):
        h, x, y = hessian[k, k], z[k, 0], z[k, 1]
        cx, cy = slope[k, 0] - h * x, slope[k, 1] - h * y
        px, py, face, dx, dy = prox(shapes[k], h, posed.lengths[k], cx, cy)
        room.faces[k], room.along[k, 0], room.along[k, 1] = face, dx, dy
        moved_x, moved_y = px - x, py - y
        if moved_x != 0.0 or moved_y != 0.0:
            for j in range(count):
                slope[j, 0] += hessian[j, k] * moved_x
                slope[j, 1] += hessian[j, k] * moved_y
            z[k, 0], z[k, 1] = px, py


@compiled
def _set_basis(posed, shapes, z, room):
    """Set directions along faces, with the curvature of lengths and rims; return their number."""
    count, steps, basis, right, system = 0, room.steps, room.basis, room.right, room.system
    for k in range(len(z)):
        face, x, y, length = room.faces[k], z[k, 0], z[k, 1], posed.lengths[k]
        if face == POINT:
            continue
        gx, gy, size = room.slope[k, 0], room.slope[k, 1], np.sqrt(x * x + y * y)
        if size <= shapes[k, INNER] * (1.0 + ON):
            length = 0.0
        if length > 0.0:
            gx, gy = gx + length * x / size, gy + length * y / size
        if face == FREE:
            steps[count] = steps[count + 1] = k
            basis[count, 0], basis[count, 1] = 1.0, 0.0
            basis[count + 1, 0], basis[count + 1, 1] = 0.0, 1.0
            right[count], right[count + 1] = -gx, -gy
            bent = length / size**3 if length > 0.0 else 0.0
            system[count, count] = bent * y * y
            system[count + 1, count] = -bent * x * y
            system[count + 1, count + 1] = bent * x * x
            count += 2
            continue
        dx, dy = room.along[k, 0], room.along[k, 1]
        if face == RIM:
            dx, dy = -y / size, x / size
            bent = max(0.0, -(gx * x + gy * y) / (size * size))
        else:
            across = x * dy - y * dx
            bent = length * across * across / size**3 if length > 0.0 else 0.0
        steps[count], basis[count, 0], basis[count, 1] = k, dx, dy
        right[count], system[count, count] = -(gx * dx + gy * dy), bent
        count += 1
    return count


@compiled
def _newton(posed, shapes, z, reached, room):
    """Take a Newton step along all faces at once; return the cost, lower if that succeeded."""
    count = _set_basis(posed, shapes, z, room)
    steps, basis, system = room.steps, room.basis, room.system
    for i in range(count):
        k, a, b = steps[i], basis[i, 0], basis[i, 1]
        for j in range(i):
            inner = posed.hessian[k, steps[j]] * (a * basis[j, 0] + b * basis[j, 1])
            system[i, j] = inner + (system[i, j] if steps[j] == k else 0.0)
        system[i, i] += posed.hessian[k, k]
    if count == 0 or not solve_spd(system, room.right, count):
        return reached
    trial, slope, share = room.trial, room.slope, 1.0
    for _ in range(HALVINGS):
        copy_to(trial, z)
        for i in range(count):
            trial[steps[i], 0] += share * room.right[i] * basis[i, 0]
            trial[steps[i], 1] += share * room.right[i] * basis[i, 1]
        _pull_back(shapes, z, room)
        set_slope(posed.hessian, posed.q, trial, slope)
        cost = tangent_bound(posed, shapes, trial, slope)[0]
        if cost < reached:
            copy_to(z, trial)
            return cost
        share *= SHRINK
    set_slope(posed.hessian, posed.q, z, slope)
    return reached


@compiled
def _pull_back(shapes, z, room):
    """Project a trial point back onto the hulls."""
    trial = room.trial
    for k in range(len(z)):
        if room.faces[k] == POINT:
            continue
        x, y = trial[k, 0], trial[k, 1]
        trial[k, 0], trial[k, 1], _, _, _ = prox(shapes[k], 1.0, 0.0, -x, -y)


@compiled
def length_of(z, k):
    """Return the length of a heading."""
    square = 0.0
    for c in range(z.shape[1]):
        square += z[k, c] * z[k, c]
    return np.sqrt(square)


@compiled
def most_of(posed):
    """Return an upper bound on the costs of all points, without the constant."""
    most = 0.0
    for j in range(len(posed.q)):
        most += posed.lengths[j] + length_of(posed.q, j)
        for k in range(len(posed.q)):
            most += 0.5 * abs(posed.hessian[j, k])
    return most


@compiled
def rise_of(posed, z, there):
    """Return the rise of the cost from z to another point, of any dimension.

    The difference of two nearly equal costs would be lost in rounding.
    """
    rise, hessian = 0.0, posed.hessian
    for j in range(len(z)):
        for c in range(z.shape[1]):
            slope = posed.q[j, c]
            for k in range(len(z)):
                slope += 0.5 * hessian[j, k] * (z[k, c] + there[k, c])
            rise += (there[j, c] - z[j, c]) * slope
        if posed.lengths[j] > 0.0:
            rise += posed.lengths[j] * (length_of(there, j) - length_of(z, j))
    return rise


@compiled
def cost_of(posed, z):
    """Return the cost at a point of any dimension, without the constant."""
    return rise_of(posed, np.zeros_like(z), z)


@compiled
def _raise(posed, node, room):
    """Raise a node's bound to that of the tangent at its point; return the cost there."""
    z, best, key, shapes = node
    cost, least = tangent_bound(posed, shapes, z, room.slope)
    if least > key[0]:
        key[0] = least
        copy_to(best, z)
    return cost


@compiled
def _pass_through(posed, node, limits, room):
    """Minimise through the interior of the hulls; return the outcome."""
    z, _, key, shapes = node
    cutoff, gap = limits
    copy_to(room.other, z)
    inside = max(1, set_inside(shapes, z))
    depths, multipliers = np.empty((len(z), LIMITS)), np.zeros((len(z), LIMITS))
    around = depths, np.empty((len(z), LIMITS, 2))
    set_depths(shapes, z, around)
    set_slope(posed.hessian, posed.q, z, room.slope)
    cost, least = tangent_bound(posed, shapes, z, room.slope)
    left, share = cost - least, 0.0
    for k in range(len(z)):
        for i in range(LIMITS):
            if depths[k, i] > 0.0:
                multipliers[k, i] = left / inside / depths[k, i]
    for _ in range(STEPS):
        left = 0.0
        for k in range(len(z)):
            for i in range(LIMITS):
                left += depths[k, i] * multipliers[k, i]
        aim = (CENTRED if share > LONG else BLOCKED) * left / inside
        set_system(posed, shapes, z, room.slope, around, multipliers, aim, room.system, room.right)
        if not solve_spd(room.system, room.right, 2 * len(z)):
            break
        share = move_inside(z, room.right, around, multipliers, aim)
        set_depths(shapes, z, around)
        set_slope(posed.hessian, posed.q, z, room.slope)
        cost = _raise(posed, node, room)
        if key[0] >= cutoff:
            return PRUNED
        if cost - key[0] <= gap * max(abs(cost + posed.constant), NEGLIGIBLE):
            _sweep(posed, shapes, z, room)
            return SOLVED
    if rise_of(posed, room.other, z) > 0.0:
        copy_to(z, room.other)
    return STALLED


@compiled
def relax(posed, node, limits, room, work):
    """Minimise over the hulls, starting at a point.

    Args:
        posed: the problem.
        node: the point, shape (N, 2); the tangent point of its bound, shape (N, 2); an array that
            begins with that bound; all updated; and the outlines of the sets, shape (N, 12).
        limits: the bound at which the node is pruned, and the relative gap that suffices.
        room: working memory.
        work: multiplications to do; a few rounds are done at least.

    Returns:
        The outcome, and the remaining multiplications.
    """
    z, _, key, shapes = node
    cutoff, gap = limits
    count = len(z)
    set_slope(posed.hessian, posed.q, z, room.slope)
    cost, before = 0.0, -np.inf
    while True:
        for _ in range(PATIENCE):
            _sweep(posed, shapes, z, room)
            for turn in range(2):
                cost = _raise(posed, node, room)
                if key[0] >= cutoff:
                    return PRUNED, work
                if cost - key[0] <= gap * max(abs(cost + posed.constant), NEGLIGIBLE):
                    return SOLVED, work
                if turn == 0:
                    _newton(posed, shapes, z, cost, room)
            work -= 10.0 * count * count + count**3
        if not key[0] - before >= RISES * (cost - key[0]):  # nearly at the limit of rounding
            spent = STEPS * 2.0 * count**3
            if spent > LONGEST:
                return STALLED, work
            return _pass_through(posed, node, limits, room), work - spent
        if work <= 0.0 and before > -np.inf:
            return GOING, work
        before = key[0]
