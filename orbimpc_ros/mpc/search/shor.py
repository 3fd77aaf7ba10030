# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Shor multipliers for round floors: bounds that assign curvature to single steps.

With multipliers theta_k of |z_k|^2 / 2, and w >= 0 of constraints in narrow sectors
(:class:`Rows`), the dual function is

    D(theta, w) = min_z (1/2 z.(H + diag(b))z + (q - sum w n).z) - w.o + sum_k h_k(theta_k),
    h_k(theta) = min (l_k t - theta t^2 / 2)  over t = floor and t = 1,

where b_k is theta_k plus the w of the curved rows of k, and z is subject to the arrival, if any. It
is concave, and defined if the matrix is positive definite on such z: without rows its maximum is
the value of the semidefinite relaxation that lifts z_k to second moments (Shor). Newton's method
maximises it with barriers mu log det and mu log w, and with h smoothed by the same mu: h is -1/2
lambda + 1/2 floor^2 (lambda - theta), up to a shift, for the best lambda >= max(0, theta). With z
the minimiser and P the inverse, the gradient is |z_k|^2/2 + mu P_kk + h', and the negative Hessian
(z_j . z_k) P_jk + mu P_jk^2 - h''.

For any resulting multipliers, a tangent at z proves their bound; so it does for the multipliers of
a stationary point, which mostly suffice.

Mathematics: docs/mathematics.md, 4.4 and 4.5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.linear import (
    add_product,
    copy_to,
    extend_factor,
    invert_spd,
    largest,
    solve_factored,
    solve_spd,
)
from orbimpc_ros.mpc.search.relax import missed_by
from orbimpc_ros.mpc.search.ring import HIGH, LOW, TURN
from orbimpc_ros.mpc.search.tree import KEY, MU, NARROWEST, TAKEN

GOING, CLIMBED, PRUNED = range(3)  # outcomes of a climb
MODULUS, ARC, FIRST_EDGE, LAST_EDGE = range(4)  # kinds of multipliers of a step
KINDS = 4
CLIMBS = 60  # most Newton steps of a climb
SMALLEST = 1e-8  # least mu, relative to the scale of q and H
SHRINK = 0.2  # factor on mu from step to step
HALVINGS = 30
INSIDE = 0.9  # share of the way to where a multiplier would become zero
SMOOTHED = 100.0  # initial mu of a node, relative to the final one of its parent
AWAY, LEAST = 2.0, 3.0  # in units of mu: added to theta; least initial multiplier of a row
ON_BOUND = 1e-6  # a heading this close to the rim or the floor counts as on it
SPARES = (1e-14, 1e-10, 1e-8, 1e-6, 1e-5, 1e-4, 1e-3)  # increases of theta, relative to max |H|
MARGIN = 1e-13  # of verified convexity, in units of the largest curvature, per step
ROUNDING = 4e-16  # relative, of the terms of a bound, per step


class Rows(NamedTuple):
    """Constraints 1/2 c |z_k|^2 <= n . z_k + o; first those of moduli, which h covers.

    Attributes:
        steps: indices of the headings, shape (M,).
        kinds: of their multipliers, shape (M,).
        curved: c, 0 or 1, shape (M,).
        normals: n, shape (M, n).
        offsets: o, shape (M,).
    """

    steps: np.ndarray
    kinds: np.ndarray
    curved: Array
    normals: Array
    offsets: Array


@compiled
def rows_of(floor, sector, dimension):
    """Return the rows of moduli, and of sectors narrower than half a turn.

    In a sector of half-width d about the unit vector m, |z|^2 <= (1 + f) m.z / cos d - f, which
    with both edges describes the convex hull of all (z, |z|^2).

    Args:
        floor: f, the least modulus.
        sector: shape (N, 4); full turns in space.
        dimension: n.
    """
    total = count = steps = len(sector)
    for k in range(steps):
        total += KINDS - 1 if sector[k, HIGH] - sector[k, LOW] < np.pi else 0
    rows = Rows(
        np.zeros(total, np.int64),
        np.zeros(total, np.int64),
        np.zeros(total),
        np.zeros((total, dimension)),
        np.zeros(total),
    )
    for k in range(steps):
        rows.steps[k], rows.curved[k] = k, 1.0
        low, high = sector[k, LOW], sector[k, HIGH]
        if high - low >= np.pi:
            continue
        for kind in range(ARC, KINDS):
            rows.steps[count], rows.kinds[count] = k, kind
            if kind == ARC:
                middle, cosine = 0.5 * (low + high), np.cos(0.5 * (high - low))
                share = 0.5 * (1.0 + floor) / cosine
                rows.curved[count], rows.offsets[count] = 1.0, -0.5 * floor
                rows.normals[count, 0] = share * np.cos(middle)
                rows.normals[count, 1] = share * np.sin(middle)
            else:
                edge, sign = (low, 1.0) if kind == FIRST_EDGE else (high, -1.0)
                rows.normals[count, 0] = -sign * np.sin(edge)
                rows.normals[count, 1] = sign * np.cos(edge)
            count += 1
    return rows


@compiled
def _stiffen(posed, matrix, linear):
    """Add the arrival's weight to a matrix and to linear terms; return its constant term."""
    constant, a = 0.0, posed.arrival
    if posed.stiff > 0.0:
        for i in range(len(a)):
            for j in range(i + 1):
                matrix[i, j] += posed.stiff * a[i] * a[j]
            for c in range(len(posed.left)):
                linear[i, c] -= posed.stiff * a[i] * posed.left[c]
        for c in range(len(posed.left)):
            constant += 0.5 * posed.stiff * posed.left[c] ** 2
    return constant


@compiled
def _set_minimiser(posed, rows, weights, inverse, z, pull):
    """Set P, shape (N, N), the Lagrangian's minimiser z, shape (N, n), and the arrival's pull.

    Returns:
        The Lagrangian there without moduli, and log det of the matrix that P inverts, both for z
        subject to the arrival; -inf, with nothing set, if that matrix is not positive definite.
    """
    matrix, linear = posed.hessian.copy(), posed.q.copy()
    constant = _stiffen(posed, matrix, linear)
    for i in range(len(weights)):
        k = rows.steps[i]
        matrix[k, k] += weights[i] * rows.curved[i]
        constant -= weights[i] * rows.offsets[i]
        for c in range(z.shape[1]):
            linear[k, c] -= weights[i] * rows.normals[i, c]
    size = invert_spd(matrix, inverse)
    if size == -np.inf:
        return -np.inf, size
    z[:] = 0.0
    add_product(inverse, linear, -1.0, z)
    for k in range(len(z)):
        for c in range(z.shape[1]):
            constant += 0.5 * linear[k, c] * z[k, c]
    if posed.stiff == 0.0:
        return constant, size
    return _arrived(posed, inverse, z, pull, constant, size)


@compiled
def _arrived(posed, inverse, z, pull, constant, size):
    """Restrict P and a minimiser to the arrival; return the raised values of `_set_minimiser`."""
    along, bent, a = np.zeros(len(z)), 0.0, posed.arrival
    for j in range(len(z)):
        for k in range(len(z)):
            along[j] += inverse[j, k] * a[k]
        bent += along[j] * a[j]
    for c in range(z.shape[1]):
        missed = missed_by(posed, z, c)
        pull[c] = missed / bent
        constant += 0.5 * missed * pull[c]
        for k in range(len(z)):
            z[k, c] -= along[k] * pull[c]
    for j in range(len(z)):
        for k in range(len(z)):
            inverse[j, k] -= along[j] * along[k] / bent
    return constant, size + np.log(bent)


@compiled
def _end(floor, length, theta, mu):
    """Return h smoothed by mu, and its first two derivatives."""
    if floor == 1.0:
        return length - 0.5 * theta, -0.5, 0.0
    shift = 2.0 * length / (1.0 + floor)
    bent, a = theta - shift, 0.5 * (1.0 - floor * floor)
    root = np.sqrt(a * a * bent * bent + 4.0 * mu * mu)
    # Both lambda and lambda - bent, without cancellation.
    if bent >= 0.0:
        above = (a * bent + 2.0 * mu + root) / (2.0 * a)
        below = mu * above / (a * above - mu)
    else:
        below = (-a * bent + 2.0 * mu + root) / (2.0 * a)
        above = mu * below / (a * below - mu)
    square = floor * floor
    value = length * floor - 0.5 * shift * square - 0.5 * above + 0.5 * square * below
    value += mu * (np.log(above) + np.log(below))
    turn = 0.5 - 0.5 * a * bent / root  # 1 - d lambda / d theta
    return value, -0.5 * square - mu / below, -mu * turn / (below * below)


@compiled
def _smoothed(posed, weights, mu, reached):
    """Return the smoothed dual function, given the Lagrangian's minimum and log det."""
    value = reached[0] + mu * reached[1]
    for i in range(len(weights)):
        if i < len(posed.q):
            value += _end(posed.floor, posed.lengths[i], weights[i], mu)[0]
        else:
            value += mu * np.log(weights[i])
    return value


@compiled
def _set_ascent(posed, rows, weights, mu, inverse, z, system, step):
    """Set Newton's step for the smoothed dual function, shape (M,); return False if singular."""
    (count, n), total = z.shape, len(step)
    pulls = np.empty((total, n))
    for i in range(total):
        k, curved, square = rows.steps[i], rows.curved[i], 0.0
        step[i] = mu * curved * inverse[k, k] - rows.offsets[i]
        for c in range(n):
            pulls[i, c] = curved * z[k, c] - rows.normals[i, c]
            square += z[k, c] * z[k, c]
            step[i] -= rows.normals[i, c] * z[k, c]
        step[i] += 0.5 * curved * square
        if i < count:
            _, slope, curve = _end(posed.floor, posed.lengths[k], weights[i], mu)
        else:
            slope, curve = mu / weights[i], -mu / weights[i] ** 2
        step[i] += slope
        for j in range(i + 1):
            other = rows.steps[j]
            inner = mu * curved * rows.curved[j] * inverse[k, other]
            for c in range(n):
                inner += pulls[i, c] * pulls[j, c]
            system[i, j] = inner * inverse[k, other]
        system[i, i] = (system[i, i] - curve) * (1.0 + 1e-12)
    return solve_spd(system, step, total)


@compiled
def _advance(posed, rows, weights, mu, step, reached, inverse, z, pull):
    """Take the longest share of a step that increases the dual function with positive multipliers.

    Returns:
        That share, 0 if there is none; the number of trials; the Lagrangian there and log det.
    """
    before, share, taken, tried = _smoothed(posed, weights, mu, reached), 1.0, 0.0, 0
    for i in range(len(z), len(weights)):
        if step[i] < 0.0:
            share = min(share, -INSIDE * weights[i] / step[i])
    for _ in range(HALVINGS):
        tried += 1
        there = weights + share * step
        reached = _set_minimiser(posed, rows, there, inverse, z, pull)
        if _smoothed(posed, there, mu, reached) >= before:
            copy_to(weights, there)
            taken = share
            break
        share *= 0.5
    if taken == 0.0:
        reached = _set_minimiser(posed, rows, weights, inverse, z, pull)
    return taken, tried, reached


@compiled
def _least_over(posed, k, curvature, slope, sector):
    """Return the minimum of g . x + l |x| + b |x|^2 / 2 over a step's sector of the shell."""
    size, low, high, floor = 0.0, sector[LOW], sector[HIGH], posed.floor
    for c in range(len(slope)):
        size += slope[c] * slope[c]
    along = -np.sqrt(size)
    if high - low < TURN:
        angle = np.arctan2(-slope[1], -slope[0])
        off = abs(angle - 0.5 * (low + high))
        off = abs(off - TURN * np.round(off / (TURN)))
        along *= np.cos(max(0.0, off - 0.5 * (high - low)))
    along += posed.lengths[k]
    if curvature > 0.0:
        t = min(1.0, max(floor, -along / curvature))
        return (along + 0.5 * curvature * t) * t
    return min((along + 0.5 * curvature * floor) * floor, along + 0.5 * curvature)


@compiled
def prove(posed, theta, z, pull, tree, node):
    """Raise a node's bound to that of the tangent at a point, if it is higher.

    Args:
        posed: the problem.
        theta: curvatures that make the cost convex, shape (N,).
        z: tangent point, shape (N, n).
        pull: multipliers of the arrival, shape (n,).
        tree: the node's tangent and its bound are updated.
        node: its index.
    """
    (count, n), top, least, terms = z.shape, 0.0, 0.0, 0.0
    slope = posed.q.copy()
    for k in range(count):
        top = max(top, posed.hessian[k, k] + abs(theta[k]))
    kept = -theta - MARGIN * count * top
    add_product(posed.hessian, z, 1.0, slope)
    for c in range(n):
        least -= pull[c] * posed.left[c]
        terms += abs(pull[c] * posed.left[c])
    for k in range(count):
        value = 0.0
        for c in range(n):
            pulled = pull[c] * posed.arrival[k]
            slope[k, c] += pulled - kept[k] * z[k, c]
            value += 0.5 * z[k, c] * (posed.q[k, c] + pulled - slope[k, c])
        there = _least_over(posed, k, kept[k], slope[k], tree.sectors[node, k])
        least += value + there
        terms += abs(value) + abs(there)
    least -= ROUNDING * count * terms
    if least > tree.progress[node, KEY]:
        tree.progress[node, KEY] = least
        copy_to(tree.point[node], z)
        copy_to(tree.kept[node, 0], kept)
        copy_to(tree.pull[node, 0], pull)


@compiled
def _add_moduli(posed, z, pull, theta, right):
    """Add each step's theta, and the linear part of its length, at a point; see `certify`."""
    force, floor = posed.q.copy(), posed.floor
    add_product(posed.hessian, z, 1.0, force)
    for k in range(len(z)):
        along = square = 0.0
        for c in range(z.shape[1]):
            along += (force[k, c] + pull[c] * posed.arrival[k]) * z[k, c]
            square += z[k, c] * z[k, c]
        size = np.sqrt(square) + 1e-300
        slope, share = posed.lengths[k] / size if posed.lengths[k] > 0.0 else 0.0, 0.0
        if size > 1.0 - ON_BOUND or size < floor + ON_BOUND:
            theta[k] = -along / square - slope
            share = slope
            if floor < 1.0:
                share = min(slope, abs(theta[k]) * (1.0 + floor) / (1.0 - floor))
        theta[k] += share
        for c in range(z.shape[1]):
            right[k, c] += (slope - share) * z[k, c]


@compiled
def certify(posed, z, pull, tree, cutoff):
    """Raise the root's bound to that of the multipliers of a stationary point, if it is higher.

    With mu_k the multiplier of the modulus, theta_k is mu_k plus as much of the length's curvature
    l_k / |z_k| as leaves |z_k| the step's minimiser. For a modulus on a bound, a larger theta costs
    next to nothing: it is raised until the cost is convex.

    Args:
        posed: the problem.
        z: the point, on the shells, shape (N, n).
        pull: multipliers of the arrival, shape (n,).
        tree: its root is updated.
        cutoff: the bound that suffices.
    """
    count, n = z.shape
    theta, right = np.zeros(count), posed.q.copy()
    stiffened, matrix = posed.hessian.copy(), np.empty((count, count))
    _stiffen(posed, stiffened, right)
    there, column, held = np.empty((count, n)), np.empty(count), np.zeros(n)
    _add_moduli(posed, z, pull, theta, right)
    top = largest(posed.hessian)
    for share in SPARES:
        copy_to(matrix, stiffened)
        for k in range(count):
            theta[k] += share * top
            matrix[k, k] += theta[k]
        if not extend_factor(matrix, matrix, 0, count):
            continue
        bent = 0.0
        if posed.stiff > 0.0:
            copy_to(column, posed.arrival)
            bent = solve_factored(matrix, column, count)
        along = column.copy()
        for c in range(n):
            copy_to(column, -right[:, c])
            solve_factored(matrix, column, count)
            copy_to(there[:, c], column)
            if bent > 0.0:
                held[c] = missed_by(posed, there, c) / bent
                copy_to(there[:, c], column - held[c] * along)
        prove(posed, theta, there, held, tree, 0)
        if tree.progress[0, KEY] >= cutoff:
            break


@compiled
def _begin(posed, held, progress, rows, weights):
    """Set the initial multipliers and mu; return the scale of q and H."""
    scale = largest(posed.q) + largest(posed.hessian) + 1e-300
    going, mu = progress[TAKEN] > 0.0, progress[MU]
    if not going:
        mu = progress[MU] = min(scale, SMOOTHED * mu) if mu > 0.0 else scale
    for i in range(len(weights)):
        weights[i] = held[rows.kinds[i], rows.steps[i]]
        if not going and i < held.shape[1]:
            weights[i] += AWAY * mu
        elif not going:
            weights[i] = max(weights[i], LEAST * mu)
    return scale


@compiled
def climb(posed, tree, node, near, cutoff, work):
    """Maximise the dual function by Newton's method, with shrinking barriers; interruptible.

    Args:
        posed: the problem.
        tree: its node is updated.
        node: index of the node.
        near: share of the gap to the cutoff; the climb ends when it can gain no more than that.
        cutoff: the bound at which the node is pruned.
        work: multiplications to do; one Newton step is done at least.

    Returns:
        The outcome, and the remaining multiplications.
    """
    z, held, progress = tree.z[node], tree.held[node], tree.progress[node]
    count, rows = len(z), rows_of(posed.floor, tree.sectors[node], z.shape[1])
    total, status = len(rows.steps), CLIMBED
    weights, inverse, pull = np.empty(total), np.empty((count, count)), np.zeros(z.shape[1])
    system, step, theta = np.empty((total, total)), np.empty(total), np.empty(count)
    scale = _begin(posed, held, progress, rows, weights)
    reached = _set_minimiser(posed, rows, weights, inverse, z, pull)
    while reached[1] > -np.inf and progress[MU] >= SMALLEST * scale and progress[TAKEN] < CLIMBS:
        progress[TAKEN] += 1.0
        mu = progress[MU]
        if not _set_ascent(posed, rows, weights, mu, inverse, z, system, step):
            break
        share, tried, reached = _advance(posed, rows, weights, mu, step, reached, inverse, z, pull)
        work -= tried * (count**3 + 20.0 * count * count + 100.0) + total**3 / 6.0
        theta[:] = 0.0
        for i in range(total):
            theta[rows.steps[i]] += rows.curved[i] * weights[i]
        prove(posed, theta, z, pull, tree, node)
        lacking = cutoff - progress[KEY]
        if lacking <= 0.0:
            status = PRUNED
            break
        if lacking < np.inf and mu * (2.0 * count + total) <= near * lacking:
            break
        if share > 0.3 or share == 0.0:  # nearly maximal, or at the limit of rounding
            progress[MU] *= SHRINK
        if work <= 0.0:
            status = GOING
            break
    for i in range(total):
        held[rows.kinds[i], rows.steps[i]] = weights[i]
    return status, work


@compiled
def priced_branching(posed, tree, node):
    """Return the step whose violation of the modulus is priced highest, or -1 for none."""
    chosen, most, floor, sector, z = -1, 0.0, posed.floor, tree.sectors[node], tree.z[node]
    for k in range(len(z)):
        bent, square = tree.held[node, MODULUS, k] - 2.0 * posed.lengths[k] / (1.0 + floor), 0.0
        for c in range(z.shape[1]):
            square += z[k, c] * z[k, c]
        missed = abs(bent * ((1.0 if bent > 0.0 else floor * floor) - square))
        if missed > most and sector[k, HIGH] - sector[k, LOW] > NARROWEST:
            chosen, most = k, missed
    return chosen
