# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Shor multipliers of round floors: the curvature of the cost that steps keep for themselves.

With theta_k on |z_k|^2 / 2, and w >= 0 on what else holds in narrow sectors (:class:`Rows`),
the dual function is

    D(theta, w) = min_z (1/2 z.(H + diag(b))z + (q - sum w n).z) - w.o + sum_k h_k(theta_k),
    h_k(theta) = min (l_k t - theta t^2 / 2)  over t = floor and t = 1,

b_k being theta_k and the w of k's rows that curve. It is concave, and defined where the matrix is
positive definite: without rows its maximum is the value of the semidefinite relaxation that lifts
z_k to second moments (Shor). It is climbed by Newton's method with barriers mu log det and
mu log w, and h smoothed by the same mu: h is -1/2 lambda + 1/2 floor^2 (lambda - theta), up to a
shift, for the best lambda >= max(0, theta). With z the minimiser and P the inverse, the gradient is
|z_k|^2/2 + mu P_kk + h', and the negative Hessian (z_j . z_k) P_jk + mu P_jk^2 - h''.

Whatever multipliers that leads to, a tangent at z proves what it does; so do the multipliers of a
stationary point, which are most often enough.

Mathematics: docs/mathematics.md, 4.4 and 4.5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.linear import (
    SINGULAR,
    add_product,
    extend_factor,
    invert_spd,
    solve_factored,
    solve_spd,
)
from orbimpc_ros.mpc.search.relax import GOING, KEY, MU, PRUNED, SOLVED, TAKEN, tangent_bound
from orbimpc_ros.mpc.search.ring import HALF, HIGH, LOW

MODULUS, ARC, FIRST_EDGE, LAST_EDGE = range(4)  # what multipliers of a step are of
KINDS = 4
CLIMBS = 60  # Newton steps
SMALLEST = 1e-8  # mu, of the forces at work
SHRINK = 0.2  # of mu, from step to step
HALVINGS = 30
INSIDE = 0.9  # of the way to where a multiplier would vanish
SMOOTHED = 100.0  # times as much as its parent in the end, a node is to begin with
AWAY, LEAST = 2.0, 3.0  # of mu: what comes to theta, and a row's multiplier at least
ON_BOUND = 1e-6  # a heading this close to the rim or the floor sits on it
SPARES = (1e-14, 1e-10, 1e-8, 1e-6, 1e-5, 1e-4, 1e-3)  # of the largest curvature
MARGIN = 1e-13  # of the largest curvature, for each step, that convexity is verified with


class Rows(NamedTuple):
    """What holds of headings: 1/2 c |z_k|^2 <= n . z_k + o; first the moduli, which h knows.

    Attributes:
        steps: which headings, shape (M,).
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
def rows_of(fraction, sectors, dimension):
    """Return the moduli, and what holds of headings in sectors narrower than half a circle.

    For one of half-width d about the unit vector m, |z|^2 <= (1 + f) m.z / cos d - f, which with
    both edges describes the convex hull of all (z, |z|^2).

    Args:
        fraction: f, the least modulus.
        sectors: shape (N, 4); whole circles but in the plane.
        dimension: n.
    """
    steps, most = len(sectors), KINDS * len(sectors)
    rows = Rows(
        np.zeros(most, np.int64),
        np.zeros(most, np.int64),
        np.zeros(most),
        np.zeros((most, dimension)),
        np.zeros(most),
    )
    count = steps
    for k in range(steps):
        rows.steps[k], rows.curved[k] = k, 1.0
        low, high = sectors[k, LOW], sectors[k, HIGH]
        if high - low >= HALF:
            continue
        for kind in range(ARC, KINDS):
            rows.steps[count], rows.kinds[count] = k, kind
            if kind == ARC:
                middle, cosine = 0.5 * (low + high), np.cos(0.5 * (high - low))
                share = 0.5 * (1.0 + fraction) / cosine
                rows.curved[count], rows.offsets[count] = 1.0, -0.5 * fraction
                rows.normals[count, 0] = share * np.cos(middle)
                rows.normals[count, 1] = share * np.sin(middle)
            else:
                edge, sign = (low, 1.0) if kind == FIRST_EDGE else (high, -1.0)
                rows.normals[count, 0] = -sign * np.sin(edge)
                rows.normals[count, 1] = sign * np.cos(edge)
            count += 1
    return Rows(
        rows.steps[:count],
        rows.kinds[:count],
        rows.curved[:count],
        rows.normals[:count],
        rows.offsets[:count],
    )


@compiled
def _set_minimiser(quad, rows, weights, inverse, z):
    """Set P, shape (N, N), and z, shape (N, n), to the Lagrangian's minimiser.

    Returns:
        The Lagrangian there without moduli, and log det of the matrix that P inverts: -inf, and
        nothing is set, where that is not positive definite.
    """
    matrix, linear, constant = quad.hessian.copy(), quad.q.copy(), 0.0
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
    return constant, size


@compiled
def _end(fraction, length, theta, mu):
    """Return h smoothed by mu, its derivative and its second one."""
    if fraction == 1.0:
        return length - 0.5 * theta, -0.5, 0.0
    shift = 2.0 * length / (1.0 + fraction)
    bent, a = theta - shift, 0.5 * (1.0 - fraction * fraction)
    root = np.sqrt(a * a * bent * bent + 4.0 * mu * mu)
    # Both lambda and lambda - bent, without cancelling.
    if bent >= 0.0:
        above = (a * bent + 2.0 * mu + root) / (2.0 * a)
        below = mu * above / (a * above - mu)
    else:
        below = (-a * bent + 2.0 * mu + root) / (2.0 * a)
        above = mu * below / (a * below - mu)
    square = fraction * fraction
    value = length * fraction - 0.5 * shift * square - 0.5 * above + 0.5 * square * below
    value += mu * (np.log(above) + np.log(below))
    turn = 0.5 - 0.5 * a * bent / root  # 1 - d lambda / d theta
    return value, -0.5 * square - mu / below, -mu * turn / (below * below)


@compiled
def _smoothed(quad, fraction, weights, mu, reached):
    """Return the smoothed dual function, of the Lagrangian's minimum and log det."""
    value = reached[0] + mu * reached[1]
    for i in range(len(weights)):
        if i < len(quad.q):
            value += _end(fraction, quad.lengths[i], weights[i], mu)[0]
        else:
            value += mu * np.log(weights[i])
    return value


@compiled
def _set_ascent(quad, fraction, rows, weights, mu, inverse, z, system, step):
    """Set Newton's step up the smoothed dual function, shape (M,); return whether there is one."""
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
            _, slope, curve = _end(fraction, quad.lengths[k], weights[i], mu)
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
def _advance(quad, fraction, rows, weights, mu, step, reached, inverse, z):
    """Take the longest share of a step that leads higher, up to what multipliers allow.

    Returns:
        That share, 0 where none does; how many were tried; the Lagrangian there and log det.
    """
    before, share = _smoothed(quad, fraction, weights, mu, reached), 1.0
    for i in range(len(z), len(weights)):
        if step[i] < 0.0:
            share = min(share, -INSIDE * weights[i] / step[i])
    for tried in range(HALVINGS):
        there = weights + share * step
        reached = _set_minimiser(quad, rows, there, inverse, z)
        if _smoothed(quad, fraction, there, mu, reached) >= before:
            weights[:] = there
            return share, tried + 1, reached
        share *= 0.5
    return 0.0, HALVINGS, _set_minimiser(quad, rows, weights, inverse, z)


@compiled
def prove(quad, shapes, theta, z, node):
    """Raise a node's bound to what the tangent at a point proves, if that is more.

    Args:
        quad: the cost.
        shapes: outlines of the sets, shape (N, 12).
        theta: what makes the cost convex, shape (N,).
        z: where the tangent touches, shape (N, n).
        node: the point of its bound, the curvatures kept there, and what is known; updated.
    """
    point, kept, known = node
    slope, top = quad.q.copy(), 0.0
    for k in range(len(z)):
        top = max(top, quad.hessian[k, k] + abs(theta[k]))
    kept_here = -theta - MARGIN * len(z) * top
    add_product(quad.hessian, z, 1.0, slope)
    for k in range(len(z)):
        for c in range(z.shape[1]):
            slope[k, c] -= kept_here[k] * z[k, c]
    least = tangent_bound(quad, shapes, kept_here, z, slope)[1]
    if least > known[KEY]:
        known[KEY], point[:], kept[:] = least, z, kept_here


@compiled
def certify(quad, fraction, shapes, z, node, cutoff):
    """Raise the root's bound to what the multipliers of a stationary point prove, if they do.

    With mu_k the multiplier of the modulus, theta_k is mu_k and as much of the length's curvature
    l_k / |z_k| as leaves the step least at |z_k|. On a bound, a larger theta costs next to nothing:
    it is raised until the cost is convex.

    Args:
        quad: the cost.
        fraction: the least modulus.
        shapes: outlines of the sets, shape (N, 12).
        z: the point, on the ring, shape (N, n).
        node: the root's, as in :func:`prove`.
        cutoff: the bound that is enough.
    """
    count, n = z.shape
    force, theta, right = quad.q.copy(), np.zeros(count), -quad.q
    matrix, column, there = np.empty((count, count)), np.empty(count), np.empty((count, n))
    add_product(quad.hessian, z, 1.0, force)
    for k in range(count):
        along = square = 0.0
        for c in range(n):
            along += force[k, c] * z[k, c]
            square += z[k, c] * z[k, c]
        size = np.sqrt(square) + 1e-300
        slope, share = quad.lengths[k] / size if quad.lengths[k] > 0.0 else 0.0, 0.0
        if size > 1.0 - ON_BOUND or size < fraction + ON_BOUND:
            theta[k] = -along / square - slope
            share = slope
            if fraction < 1.0:
                share = min(slope, abs(theta[k]) * (1.0 + fraction) / (1.0 - fraction))
        theta[k] += share
        for c in range(n):
            right[k, c] -= (slope - share) * z[k, c]
    top, before = np.abs(quad.hessian).max(), 0.0
    for share in SPARES:
        matrix[:] = quad.hessian
        for k in range(count):
            theta[k] += (share - before) * top
            matrix[k, k] += theta[k]
        before = share
        if not extend_factor(matrix, matrix, 0, count, SINGULAR):
            continue
        for c in range(n):
            column[:] = right[:, c]
            solve_factored(matrix, column, count)
            there[:, c] = column
        prove(quad, shapes, theta, there, node)
        if node[2][KEY] >= cutoff:
            break


@compiled
def _begin(quad, held, known, rows, weights):
    """Set the multipliers to begin with, and mu; return the forces at work."""
    scale = np.abs(quad.q).max() + np.abs(quad.hessian).max() + 1e-300
    going, mu = known[TAKEN] > 0.0, known[MU]
    if not going:
        mu = known[MU] = min(scale, SMOOTHED * mu) if mu > 0.0 else scale
    for i in range(len(weights)):
        weights[i] = held[rows.kinds[i], rows.steps[i]]
        if not going and i < held.shape[1]:
            weights[i] += AWAY * mu
        elif not going:
            weights[i] = max(weights[i], LEAST * mu)
    return scale


@compiled
def climb(quad, fraction, sectors, shapes, node, near, cutoff, work):
    """Climb the dual function by Newton's method, its barriers shrinking; interruptible.

    Args:
        quad: the cost.
        fraction: the least modulus.
        sectors: of the node, shape (N, 4).
        shapes: their outlines, shape (N, 12).
        node: where it is, shape (N, n); multipliers by their kinds, shape (4, N); and what
            :func:`prove` raises; all updated.
        near: share of what the bound lacks; where no more is left to climb, the climb ends.
        cutoff: the bound at which the node is of no use.
        work: multiplications to do, though no less than one Newton step takes.

    Returns:
        What becomes of the node, and the multiplications left.
    """
    z, held, point, kept, known = node
    count, rows = len(z), rows_of(fraction, sectors, z.shape[1])
    total, status = len(rows.steps), SOLVED
    weights, inverse = np.empty(total), np.empty((count, count))
    system, step, theta = np.empty((total, total)), np.empty(total), np.empty(count)
    scale = _begin(quad, held, known, rows, weights)
    reached = _set_minimiser(quad, rows, weights, inverse, z)
    while reached[1] > -np.inf and known[MU] >= SMALLEST * scale and known[TAKEN] < CLIMBS:
        known[TAKEN] += 1.0
        mu = known[MU]
        if not _set_ascent(quad, fraction, rows, weights, mu, inverse, z, system, step):
            break
        share, tried, reached = _advance(
            quad, fraction, rows, weights, mu, step, reached, inverse, z
        )
        work -= tried * (count**3 + 20.0 * count * count + 100.0) + total**3 / 6.0
        theta[:] = 0.0
        for i in range(total):
            theta[rows.steps[i]] += rows.curved[i] * weights[i]
        prove(quad, shapes, theta, z, (point, kept, known))
        lacking = cutoff - known[KEY]
        if lacking <= 0.0:
            status = PRUNED
            break
        if lacking < np.inf and mu * (2.0 * count + total) <= near * lacking:
            break
        if share > 0.3 or share == 0.0:  # as high as rounding lets it be, or nearly
            known[MU] *= SHRINK
        if work <= 0.0:
            status = GOING
            break
    for i in range(total):
        held[rows.kinds[i], rows.steps[i]] = weights[i]
    return status, work


@compiled
def set_spread(quad, fraction, sectors, node, aside):
    """Set how far second moments reach to the side of where a climb has ended, in the plane.

    They are those of z and of 2 mu P on top. Where two ways round cost nearly the same, P is next
    to singular, and z between the two.

    Args:
        quad: the cost.
        fraction: the least modulus.
        sectors: of the node, shape (N, 4).
        node: as in :func:`climb`.
        aside: shape (N, 2), set.
    """
    z, held, _, _, known = node
    rows, inverse = rows_of(fraction, sectors, 2), np.zeros((len(z), len(z)))
    weights, j = np.empty(len(rows.steps)), 0
    for i in range(len(weights)):
        weights[i] = held[rows.kinds[i], rows.steps[i]]
    _set_minimiser(quad, rows, weights, inverse, aside)
    for k in range(len(z)):
        if inverse[k, k] > inverse[j, j]:
            j = k
    size = np.sqrt(z[j, 0] ** 2 + z[j, 1] ** 2) + 1e-300
    reach = np.sqrt(2.0 * known[MU] / SHRINK / (inverse[j, j] + 1e-300)) / size
    x, y = -z[j, 1] * reach, z[j, 0] * reach
    for k in range(len(z)):
        aside[k, 0], aside[k, 1] = inverse[k, j] * x, inverse[k, j] * y


@compiled
def priced_branching(quad, fraction, held, z, sectors, narrowest):
    """Return the step whose modulus misses most, as its multiplier prices it; -1 for none."""
    chosen, most = -1, 0.0
    for k in range(len(z)):
        bent, square = held[MODULUS, k] - 2.0 * quad.lengths[k] / (1.0 + fraction), 0.0
        for c in range(z.shape[1]):
            square += z[k, c] * z[k, c]
        missed = abs(bent * ((1.0 if bent > 0.0 else fraction * fraction) - square))
        if missed > most and sectors[k, HIGH] - sectors[k, LOW] > narrowest:
            chosen, most = k, missed
    return chosen
