"""Branch and bound over the cells of a planar floor, and over none: the hull.

For n = 2, orders (1, any), no length weight and no constraint but orbitope and floor, the problem
is a strictly convex quadratic in z_1..z_N with the same N x N Hessian H for both coordinates. At a
node, disks are kept as tangents, added where the iterate leaves its disk, and the quadratic program
over tangents and chosen cells is solved by a dual active-set method (Goldfarb and Idnani). Each of
its iterates minimises the Lagrangian for multipliers u >= 0, so its value is a lower bound at any
time: a node is given up as soon as the bound says so. A child starts from its parent's active set.

A cell is a half-space n . z >= b: a face of a polygonal floor, or what lies beyond the chord of an
arc of a round one (:mod:`orbimpc_ros.mpc.floors.cells`). Arcs have halves, and a step that slips
below the circle is branched on the halves of its arc.
"""

from __future__ import annotations

import heapq

import numpy as np

from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.linear import SINGULAR, quadratic, solve_spd

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
    value = quadratic(hessian, q, x)
    for i in range(count):
        k = rows[i]
        held = normals[i, 0] * x[k, 0] + normals[i, 1] * x[k, 1]
        value += u[i] * (offsets[i] - held)
    return value


@compiled
def _most_violated(x, choice, cells, bounds):
    """Return step, normal and offset of the row n . x_k >= b violated most; step -1 if none is."""
    worst, step = OUTSIDE, -1
    a = b = offset = 0.0
    for k in range(len(x)):
        size = np.sqrt(x[k, 0] ** 2 + x[k, 1] ** 2)
        if size - 1.0 > worst:
            worst, step, offset = size - 1.0, k, -1.0
            a, b = -x[k, 0] / size, -x[k, 1] / size
        if choice[k] >= 0:
            cell, bound = cells[choice[k]], bounds[choice[k]]
            short = bound - cell[0] * x[k, 0] - cell[1] * x[k, 1]
            if short > worst:
                worst, step, offset = short, k, bound
                a, b = cell[0], cell[1]
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
def _relax(hessian, inverse, q, cells, bounds, choice, cutoff, rows, normals, offsets, u, count, x):
    """Solve a node from its parent's active set; return status, bound and the active count."""
    _minimiser(inverse, q, rows, normals, u, count, x)
    bound = _lagrangian(hessian, q, rows, normals, offsets, u, count, x)
    for _ in range(ITERATIONS):
        step, a, b, offset = _most_violated(x, choice, cells, bounds)
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
def _options(chosen, roots, halves):
    """Return the first of the cells that a step can be branched on, and their number."""
    if chosen < 0:
        return 0, roots
    return halves[chosen], 2 if halves[chosen] > 0 else 0


@compiled
def _miss(cells, bounds, cell, point):
    """Return by how much a point misses a cell; 0 inside."""
    return max(0.0, bounds[cell] - cells[cell, 0] * point[0] - cells[cell, 1] * point[1])


@compiled
def _shortfall(cells, bounds, roots, radius, point):
    """Return by how much a point misses the floor."""
    if radius > 0.0:
        return radius - np.sqrt(point[0] ** 2 + point[1] ** 2)
    least = np.inf
    for cell in range(roots):
        least = min(least, _miss(cells, bounds, cell, point))
    return least


@compiled
def _branching(x, choice, cells, bounds, halves, roots, radius, inverse):
    """Return the step to branch on, -1 if there is none, and whether one misses its finest arc."""
    chosen, gain, stuck = -1, -1.0, False
    for k in range(len(x)):
        _, count = _options(choice[k], roots, halves)
        if count == 0 and radius == 0.0:
            continue
        short = _shortfall(cells, bounds, roots, radius, x[k])
        if short <= SATISFIED:
            continue
        if count == 0:
            stuck = True
            continue
        # Of an arc's halves the nearer one often holds already, and tells nothing: what the step
        # misses of the floor is what finer arcs will ask of it.
        raised = short * short / (2.0 * inverse[k, k])
        if raised > gain:
            chosen, gain = k, raised
    return chosen, stuck


@compiled
def branch_and_bound(
    hessian, inverse, q, constant, cells, bounds, halves, roots, radius, known, tolerance, max_nodes
):
    """Search best first; return x, f(x), the least bound, nodes, and whether that is complete.

    A search that is not complete and found nothing better than what is known returns the last
    relaxation's x, with f of what is known: x is a start for a local search.

    Args:
        hessian: H, shape (N, N).
        inverse: of H.
        q: shape (N, 2).
        constant: what values lack; it only scales the tolerance.
        cells: unit normals n, shape (M, 2); those of the whole floor come first.
        bounds: b of n . z >= b, shape (M,).
        halves: the first of the two halves of each cell, 0 where it has none, shape (M,).
        roots: how many cells are those of the whole floor.
        radius: of a round floor, 0 for a polygon.
        known: value of a trajectory that is known; only better ones are looked for.
        tolerance: relative gap at which to stop.
        max_nodes: relaxations to solve at most.
    """
    n_steps, most = len(q), max(roots, 2)
    size = 2 * n_steps + 2
    # State 0 is empty, for the root; that of a node is its number, copied from its parent's.
    rows = np.zeros((max_nodes + 1, size), np.int64)
    normals = np.zeros((max_nodes + 1, size, 2))
    offsets, u = np.zeros((max_nodes + 1, size)), np.zeros((max_nodes + 1, size))
    counts = np.zeros(max_nodes + 1, np.int64)
    capacity = 1 + max_nodes * most
    choice = np.empty((capacity, n_steps), np.int64)
    choice[0] = -1
    parent, made = np.zeros(capacity, np.int64), 1
    open_nodes = [(-np.inf, 0)]  # a heap; of equals the latest, the deepest, comes first
    best, value, closed = np.zeros((n_steps, 2)), known, np.inf
    x, gains = np.zeros((n_steps, 2)), np.empty(most)
    solved, complete = 0, True
    while open_nodes:
        least, node = open_nodes[0][0], -open_nodes[0][1]
        cutoff = value - tolerance * max(abs(value + constant), 1e-9)
        if least >= cutoff:
            break
        if solved == max_nodes:
            complete = False
            break
        heapq.heappop(open_nodes)
        solved += 1
        own, from_ = solved, parent[node]
        rows[own], normals[own] = rows[from_], normals[from_]
        offsets[own], u[own] = offsets[from_], u[from_]
        status, bound, count = _relax(
            hessian, inverse, q, cells, bounds, choice[node], cutoff,
            rows[own], normals[own], offsets[own], u[own], counts[from_], x,
        )  # fmt: skip
        counts[own] = count
        bound = max(bound, least)
        if status == REFUTED:
            continue
        if status != SOLVED:
            closed = min(closed, bound)
            complete = complete and status == PRUNED
            continue
        chosen, stuck = _branching(x, choice[node], cells, bounds, halves, roots, radius, inverse)
        if chosen < 0 and stuck:  # below the circle by less than the finest arcs see
            closed, complete = min(closed, bound), False
            break
        if chosen < 0:
            reached = quadratic(hessian, q, x)
            closed = min(closed, bound)
            if reached < value:
                best[:], value = x, reached
            continue
        k = chosen
        first, count = _options(choice[node, k], roots, halves)
        for i in range(count):
            miss = _miss(cells, bounds, first + i, x[k])
            gains[i] = bound + miss * miss / (2.0 * inverse[k, k])
        for i in np.argsort(-gains[:count]):
            if gains[i] >= cutoff:
                closed = min(closed, gains[i])
                continue
            choice[made] = choice[node]
            choice[made, k] = first + i
            parent[made] = own
            heapq.heappush(open_nodes, (gains[i], -made))
            made += 1
    if not complete and value == known:
        best[:] = x
    if open_nodes:
        closed = min(closed, open_nodes[0][0])
    return best, value, min(closed, value), solved, complete
