"""Branch and bound over the faces of a planar floor, and over none: the hull.

For n = 2, orders (1, any), no length weight and no constraint but orbitope and polygonal floor, the
problem is a strictly convex quadratic in z_1..z_N with the same N x N Hessian H for both
coordinates. At a node, disks are kept as tangents, added where the iterate leaves its disk, and the
quadratic program over tangents and chosen faces is solved by a dual active-set method (Goldfarb and
Idnani). Each of its iterates minimises the Lagrangian for multipliers u >= 0, so its value is a
lower bound at any time: a node is given up as soon as the bound says so. A child starts from its
parent's active set.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.linear import SINGULAR, solve_spd

SOLVED, PRUNED, REFUTED, STALLED = 0, 1, 2, 3
ITERATIONS = 300
OUTSIDE = 1e-10  # a disk or face violated by less holds
SATISFIED = 1e-8  # a face missed by less need not be branched on


@compiled
def _minimiser(inverse, q, rows, normals, u, count, x):
    """Set x to the minimiser of the Lagrangian: H x + q - sum_i u_i n_i = 0."""
    n_steps = len(q)
    for j in range(n_steps):
        a = b = 0.0
        for k in range(n_steps):
            a -= inverse[j, k] * q[k, 0]
            b -= inverse[j, k] * q[k, 1]
        for i in range(count):
            weight = inverse[j, rows[i]] * u[i]
            a += weight * normals[i, 0]
            b += weight * normals[i, 1]
        x[j, 0], x[j, 1] = a, b


@compiled
def _lagrangian(hessian, q, rows, normals, offsets, u, count, x):
    """Return f(x) + sum_i u_i (b_i - n_i . x)."""
    value = 0.0
    for j in range(len(q)):
        a, b = q[j, 0], q[j, 1]
        for k in range(len(q)):
            a += 0.5 * hessian[j, k] * x[k, 0]
            b += 0.5 * hessian[j, k] * x[k, 1]
        value += x[j, 0] * a + x[j, 1] * b
    for i in range(count):
        k = rows[i]
        held = normals[i, 0] * x[k, 0] + normals[i, 1] * x[k, 1]
        value += u[i] * (offsets[i] - held)
    return value


@compiled
def _most_violated(x, choice, faces, floor):
    """Return step, normal and offset of the row n . x_k >= b violated most; step -1 if none is."""
    worst, step = OUTSIDE, -1
    a = b = offset = 0.0
    for k in range(len(x)):
        size = np.sqrt(x[k, 0] ** 2 + x[k, 1] ** 2)
        if size - 1.0 > worst:
            worst, step, offset = size - 1.0, k, -1.0
            a, b = -x[k, 0] / size, -x[k, 1] / size
        if choice[k] >= 0:
            face = faces[choice[k]]
            short = floor - face[0] * x[k, 0] - face[1] * x[k, 1]
            if short > worst:
                worst, step, offset = short, k, floor
                a, b = face[0], face[1]
    return step, a, b, offset


@compiled
def _add_row(inverse, rows, normals, offsets, u, count, x, step, a, b, offset):
    """Add a violated row to the active set, dropping those in its way.

    Returns the new count, or -1 if no point satisfies the rows, -2 if they are too close to call.
    """
    size = len(rows)
    system, r = np.empty((size, size)), np.empty(size)
    multiplier = 0.0
    for _ in range(4 * size):
        for i in range(count):
            inner = normals[i, 0] * a + normals[i, 1] * b
            r[i] = inverse[rows[i], step] * inner
            for j in range(i + 1):
                inner = normals[i, 0] * normals[j, 0] + normals[i, 1] * normals[j, 1]
                system[i, j] = inverse[rows[i], rows[j]] * inner
        curvature = inverse[step, step] * (a * a + b * b)
        for i in range(count):
            system[i, i] *= 1.0 + 1e-14
        held = r[:count].copy()
        if not solve_spd(system, r, count):
            return -2
        for i in range(count):
            curvature -= held[i] * r[i]
        gap = offset - a * x[step, 0] - b * x[step, 1]
        blocking, limit = -1, np.inf
        for i in range(count):
            if r[i] > SINGULAR and u[i] < limit * r[i]:
                blocking, limit = i, u[i] / r[i]
        whole = gap / curvature if curvature > SINGULAR else np.inf
        move = min(limit, whole)
        if move == np.inf:
            return -1
        for i in range(count):
            u[i] -= move * r[i]
        multiplier += move
        if curvature > SINGULAR:
            for j in range(len(x)):
                along = inverse[j, step] * move
                x[j, 0] += along * a
                x[j, 1] += along * b
                for i in range(count):
                    back = inverse[j, rows[i]] * move * r[i]
                    x[j, 0] -= back * normals[i, 0]
                    x[j, 1] -= back * normals[i, 1]
        if whole <= limit:
            if count == size:
                return -2
            rows[count], offsets[count], u[count] = step, offset, multiplier
            normals[count, 0], normals[count, 1] = a, b
            return count + 1
        for i in range(blocking, count - 1):
            rows[i], offsets[i], u[i] = rows[i + 1], offsets[i + 1], u[i + 1]
            normals[i, 0], normals[i, 1] = normals[i + 1, 0], normals[i + 1, 1]
        count -= 1
    return -2


@compiled
def _relax(hessian, inverse, q, faces, floor, choice, cutoff, rows, normals, offsets, u, count, x):
    """Solve a node from its parent's active set; return status, bound and the active count."""
    _minimiser(inverse, q, rows, normals, u, count, x)
    bound = _lagrangian(hessian, q, rows, normals, offsets, u, count, x)
    for _ in range(ITERATIONS):
        step, a, b, offset = _most_violated(x, choice, faces, floor)
        if step < 0:
            return SOLVED, bound, count
        added = _add_row(inverse, rows, normals, offsets, u, count, x, step, a, b, offset)
        if added == -1:
            return REFUTED, np.inf, 0
        if added == -2:
            return STALLED, bound, 0
        count = added
        _minimiser(inverse, q, rows, normals, u, count, x)
        bound = max(bound, _lagrangian(hessian, q, rows, normals, offsets, u, count, x))
        if bound >= cutoff:
            return PRUNED, bound, count
    return STALLED, bound, count


@compiled
def branch_and_bound(hessian, inverse, q, constant, faces, floor, tolerance, max_nodes):
    """Search best first; return x, f(x), the least bound, nodes, and whether that is complete.

    ``constant`` only scales the tolerance; values are those of f, without it.
    """
    n_steps, m = len(q), len(faces)
    size = 2 * n_steps + 2
    rows = np.zeros((max_nodes + 1, size), np.int64)
    normals = np.zeros((max_nodes + 1, size, 2))
    offsets, u = np.zeros((max_nodes + 1, size)), np.zeros((max_nodes + 1, size))
    counts = np.zeros(max_nodes + 1, np.int64)
    capacity = 1 + max_nodes * max(m, 1)
    choice = np.empty((capacity, n_steps), np.int64)
    choice[0] = -1
    bounds, parent = np.empty(capacity), np.zeros(capacity, np.int64)
    open_nodes, opened = np.zeros(capacity, np.int64), 1
    bounds[0], made = -np.inf, 1
    best, value, closed = np.zeros((n_steps, 2)), np.inf, np.inf
    x, gains = np.zeros((n_steps, 2)), np.empty(m)
    solved, complete = 0, True
    while opened > 0:
        at = 0
        for i in range(1, opened):
            if bounds[open_nodes[i]] <= bounds[open_nodes[at]]:
                at = i
        node = open_nodes[at]
        cutoff = value - tolerance * max(abs(value + constant), 1e-9)
        if bounds[node] >= cutoff:
            break
        if solved == max_nodes:
            complete = False
            break
        opened -= 1
        open_nodes[at] = open_nodes[opened]
        solved += 1
        # State 0 is empty, for the root; a node's own is its number, copied from its parent's.
        own, from_ = solved, parent[node]
        rows[own], normals[own] = rows[from_], normals[from_]
        offsets[own], u[own] = offsets[from_], u[from_]
        status, bound, count = _relax(
            hessian, inverse, q, faces, floor, choice[node], cutoff,
            rows[own], normals[own], offsets[own], u[own], counts[from_], x,
        )  # fmt: skip
        counts[own] = count
        bound = max(bound, bounds[node])
        if status == REFUTED:
            continue
        if status != SOLVED:
            closed = min(closed, bound)
            complete = complete and status == PRUNED
            continue
        chosen, gain, missed = -1, -1.0, 0.0
        for k in range(n_steps):
            if choice[node, k] >= 0 or m == 0:
                continue
            short, least = np.inf, np.inf
            for i in range(m):
                miss = max(0.0, floor - faces[i, 0] * x[k, 0] - faces[i, 1] * x[k, 1])
                short = min(short, miss)
                least = min(least, miss * miss / (2.0 * inverse[k, k]))
            if short > SATISFIED and (least > gain or (least == gain and short > missed)):
                chosen, gain, missed = k, least, short
        if chosen < 0:
            reached = _lagrangian(hessian, q, rows[0], normals[0], offsets[0], u[0], 0, x)
            closed = min(closed, bound)
            if reached < value:
                best[:], value = x, reached
            continue
        k = chosen
        for i in range(m):
            miss = max(0.0, floor - faces[i, 0] * x[k, 0] - faces[i, 1] * x[k, 1])
            gains[i] = bound + miss * miss / (2.0 * inverse[k, k])
        for i in np.argsort(-gains):
            if gains[i] >= cutoff:
                closed = min(closed, gains[i])
                continue
            choice[made] = choice[node]
            choice[made, k] = i
            bounds[made], parent[made] = gains[i], own
            open_nodes[opened] = made
            opened += 1
            made += 1
    for i in range(opened):
        closed = min(closed, bounds[open_nodes[i]])
    return best, value, min(closed, value), solved, complete
