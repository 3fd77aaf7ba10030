# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Branch and bound over the cells of a planar floor, and over none: the hull.

For n = 2, orders (1, any), no length weight and no constraint but orbitope and floor, the problem
is a strictly convex quadratic in z_1..z_N with the same N x N Hessian H for both coordinates. At a
node, disks are kept as tangents, added where the iterate leaves its disk, and the quadratic program
over tangents and chosen cells is solved by a dual active-set method (Goldfarb and Idnani). Each of
its iterates minimises the Lagrangian for multipliers u >= 0, so its value is a lower bound at any
time: a node is given up as soon as the bound says so. A child starts from its parent's active set.

A cell is a half-space n . z >= b: a face of a polygonal floor
(:mod:`orbimpc_ros.mpc.geometry.cells`).

The search keeps all that it knows in a :class:`Tree`, so that it can be interrupted after any row
that is added, and continued. Bounds hold up to rounding: multipliers are kept >= 0, and what is
left of the Lagrangian's gradient, times the way to any point of the disks, counts against them.
Every node has a solution (a cell reaches into the disk, and there is one a step): where arithmetic
finds none, the node stays open at the bound that it has.

Mathematics: docs/mathematics.md, 4.3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.best_first import (
    ACTIVE,
    BOUND,
    CURRENT,
    GOING,
    LEAST,
    MADE,
    NODE,
    NODES,
    OPENED,
    PAUSED,
    PRUNED,
    RESUMED,
    ROWS_ADDED,
    SOLVED,
    STALLED,
    VALUE,
    advance,
    begin,
    close,
    cutoff_of,
    keep,
    set_least,
    worked,
)
from orbimpc_ros.mpc.kernels.linear import quadratic, solve_spd

ITERATIONS = 300
OUTSIDE = 1e-10  # a disk or face violated by less holds
SATISFIED = 1e-8  # a face missed by less need not be branched on
FLAT = 1e-13  # share of a curvature that is taken for none
ROUNDING = 1e-15  # of numbers that cancel


class Quadratic(NamedTuple):
    """The cost 1/2 sum_jk H_jk x_j . x_k + sum_k q_k . x_k of points of the plane.

    Attributes:
        hessian: H, positive definite, shape (N, N).
        inverse: of H, shape (N, N).
        q: shape (N, 2).
    """

    hessian: Array
    inverse: Array
    q: Array


class Tree(NamedTuple):
    """A search: its nodes, each with the active set it ended with, and the best point.

    Attributes:
        rows: the steps of active rows, shape (S, 2N + 2); S - 1 nodes can be solved.
        normals: of active rows, shape (S, 2N + 2, 2).
        offsets: of active rows, shape (S, 2N + 2).
        u: their multipliers, >= 0, shape (S, 2N + 2).
        active: how many there are, shape (S,); the first state is empty, for the root.
        choice: the cell of each step of a node, -1 for none, shape (M, N).
        parent: whose active set a node begins with, shape (M,).
        solved: the nodes in the order in which they were solved, from 1 on, shape (S,).
        split: the steps that they were branched on, -1 for none, shape (S,).
        keys: bounds of the open nodes, a heap, shape (M,).
        heap: their numbers, shape (M,); of equal bounds the latest, the deepest, comes first.
        x: of the last node, shape (N, 2).
        best: the best point found, shape (N, 2).
        counts, numbers: see :mod:`orbimpc_ros.mpc.kernels.best_first`, shapes (8,) and (4,).
    """

    rows: np.ndarray
    normals: Array
    offsets: Array
    u: Array
    active: np.ndarray
    choice: np.ndarray
    parent: np.ndarray
    solved: np.ndarray
    split: np.ndarray
    keys: Array
    heap: np.ndarray
    x: Array
    best: Array
    counts: np.ndarray
    numbers: Array


def tree(steps: int, nodes: int, most: int) -> Tree:
    """Return room for a search over N = ``steps`` steps.

    All of it at once: memory is handed out page by page, as it is first written to, whereas to
    move a large tree to a larger place would keep a tick waiting.

    Args:
        steps: N.
        nodes: that can be solved.
        most: children that a node can have.
    """
    states, made, size = nodes + 1, 1 + nodes * most, 2 * steps + 2
    active = np.empty(states, np.int64)
    active[0] = 0
    return Tree(
        np.empty((states, size), np.int64),
        np.empty((states, size, 2)),
        np.empty((states, size)),
        np.empty((states, size)),
        active,
        np.empty((made, steps), np.int32),
        np.empty(made, np.int64),
        np.empty(states, np.int64),
        np.empty(states, np.int64),
        np.empty(made),
        np.empty(made, np.int64),
        np.zeros((steps, 2)),
        np.zeros((steps, 2)),
        np.zeros(8, np.int64),
        np.zeros(4),
    )


def begin_cells(tree, known):
    """Begin a search, with no cell chosen yet.

    Args:
        tree: updated in place.
        known: a value that is to be undercut, inf for none.
    """
    begin(tree, known)
    tree.choice[0] = -1


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
def lagrangian(quad, rows, normals, offsets, u, count, x):
    """Return a lower bound on f(z) + sum_i u_i (b_i - n_i . z), |z_k| <= 1, expanded about x."""
    hessian, q = quad.hessian, quad.q
    value = magnitude = stray = 0.0
    linear = q.copy()
    for i in range(count):
        value += u[i] * offsets[i]
        magnitude += abs(u[i] * offsets[i])
        linear[rows[i], 0] -= u[i] * normals[i, 0]
        linear[rows[i], 1] -= u[i] * normals[i, 1]
    for j in range(len(q)):
        a = b = 0.0
        for k in range(len(q)):
            a += hessian[j, k] * x[k, 0]
            b += hessian[j, k] * x[k, 1]
        c, d = linear[j, 0], linear[j, 1]
        value += x[j, 0] * (0.5 * a + c) + x[j, 1] * (0.5 * b + d)
        magnitude += abs(x[j, 0] * a) + abs(x[j, 1] * b) + abs(x[j, 0] * c) + abs(x[j, 1] * d)
        size = np.sqrt(x[j, 0] ** 2 + x[j, 1] ** 2)
        stray += np.sqrt((a + c) ** 2 + (b + d) ** 2) * (1.0 + size)
    return value - stray - ROUNDING * magnitude


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

    Returns:
        The new count, or -1 where rounding leaves no row to drop or to add; the multiplications
        that it took.
    """
    size = len(rows)
    system, r = np.empty((size, size)), np.empty(size)
    multiplier = spent = 0.0
    for _ in range(4 * size):
        spent += count * (count * (0.2 * count + 4.0) + 4.0 * len(x))
        for i in range(count):
            inner = normals[i, 0] * a + normals[i, 1] * b
            r[i] = inverse[rows[i], step] * inner
            for j in range(i + 1):
                inner = normals[i, 0] * normals[j, 0] + normals[i, 1] * normals[j, 1]
                system[i, j] = inverse[rows[i], rows[j]] * inner
        curvature = inverse[step, step] * (a * a + b * b)
        for i in range(count):
            system[i, i] *= 1.0 + 1e-14
        held, flat = r[:count].copy(), FLAT * curvature
        if not solve_spd(system, r, count):
            return -1, spent
        for i in range(count):
            curvature -= held[i] * r[i]
        gap = offset - a * x[step, 0] - b * x[step, 1]
        blocking, limit = -1, np.inf
        for i in range(count):
            if r[i] > FLAT and u[i] < limit * r[i]:
                blocking, limit = i, u[i] / r[i]
        whole = gap / curvature if curvature > flat else np.inf
        move = min(limit, whole)
        if move == np.inf:
            return -1, spent
        for i in range(count):
            u[i] = max(0.0, u[i] - move * r[i])
        multiplier += move
        if curvature > flat:
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
                return -1, spent
            rows[count], offsets[count], u[count] = step, offset, multiplier
            normals[count, 0], normals[count, 1] = a, b
            return count + 1, spent
        for i in range(blocking, count - 1):
            rows[i], offsets[i], u[i] = rows[i + 1], offsets[i + 1], u[i + 1]
            normals[i, 0], normals[i, 1] = normals[i + 1, 0], normals[i + 1, 1]
        count -= 1
    return -1, spent


@compiled
def _relax(quad, cells, bounds, choice, cutoff, rows, normals, offsets, u, count, x, added, work):
    """Solve a node on from an active set and its minimiser x.

    Returns what becomes of it, the bound, the active count, the rows added by now, the work left.
    """
    bound = lagrangian(quad, rows, normals, offsets, u, count, x)
    while added < ITERATIONS:
        step, a, b, offset = _most_violated(x, choice, cells, bounds)
        if step < 0:
            return SOLVED, bound, count, added, work
        if work <= 0.0:
            return GOING, bound, count, added, work
        following, spent = _add_row(
            quad.inverse, rows, normals, offsets, u, count, x, step, a, b, offset
        )
        work -= spent + 4.0 * count * len(x) + 4.0 * len(x) ** 2 + NODE
        if following < 0:
            return STALLED, bound, 0, added, work
        count, added = following, added + 1
        _minimiser(quad.inverse, quad.q, rows, normals, u, count, x)
        bound = max(bound, lagrangian(quad, rows, normals, offsets, u, count, x))
        if bound >= cutoff:
            return PRUNED, bound, count, added, work
    return STALLED, bound, count, added, work


@compiled
def _miss(cells, bounds, cell, point):
    """Return by how much a point misses a cell; 0 inside."""
    return max(0.0, bounds[cell] - cells[cell, 0] * point[0] - cells[cell, 1] * point[1])


@compiled
def _branching(x, choice, cells, bounds, inverse):
    """Return the step to branch on, -1 if there is none."""
    chosen, gain = -1, -1.0
    for k in range(len(x)):
        if choice[k] >= 0 or len(cells) == 0:
            continue
        short = np.inf
        for cell in range(len(cells)):
            short = min(short, _miss(cells, bounds, cell, x[k]))
        raised = short * short / (2.0 * inverse[k, k])
        if short > SATISFIED and raised > gain:
            chosen, gain = k, raised
    return chosen


@compiled
def _branch(quad, table, tree, node, cutoff):
    """Open the children of a node that is solved, or note that it has none."""
    choice, counts, numbers = tree.choice, tree.counts, tree.numbers
    bound, count = numbers[BOUND], len(table.bounds)
    k = _branching(tree.x, choice[node], table.normals, table.bounds, quad.inverse)
    if k < 0:
        close(numbers, bound)
        reached = quadratic(quad.hessian, quad.q, tree.x)
        if reached < numbers[VALUE]:
            tree.best[:], numbers[VALUE] = tree.x, reached
        return
    tree.split[counts[NODES]] = k
    gains = np.empty(count)
    for cell in range(count):
        miss = _miss(table.normals, table.bounds, cell, tree.x[k])
        gains[cell] = bound + miss * miss / (2.0 * quad.inverse[k, k])
    for cell in np.argsort(-gains):
        if gains[cell] >= cutoff:
            close(numbers, gains[cell])
            continue
        made = counts[MADE]
        choice[made] = choice[node]
        choice[made, k] = cell
        keep(tree, gains[cell])


@compiled
def _search(quad, table, constant, tolerance, tree, room, work):
    """Do as :func:`search`, but for the bound of the whole."""
    counts, numbers = tree.counts, tree.numbers
    while True:
        cutoff = cutoff_of(numbers[VALUE], constant, tolerance)
        coming = advance(tree, cutoff, room, work)
        if coming not in (OPENED, RESUMED):
            return coming
        node, own = counts[CURRENT], counts[NODES]
        rows, normals = tree.rows[own], tree.normals[own]
        if coming == OPENED:
            tree.solved[own], tree.split[own] = node, -1
            _minimiser(quad.inverse, quad.q, rows, normals, tree.u[own], counts[ACTIVE], tree.x)
            work -= NODE + 2.0 * len(tree.x) ** 2
        status, bound, count, counts[ROWS_ADDED], work = _relax(
            quad, table.normals, table.bounds, tree.choice[node], cutoff, rows, normals,
            tree.offsets[own], tree.u[own], counts[ACTIVE], tree.x, counts[ROWS_ADDED], work,
        )  # fmt: skip
        worked(counts, numbers, tree.active, status, bound, count)
        if status == GOING:
            return PAUSED
        if status == SOLVED:
            _branch(quad, table, tree, node, cutoff)
        else:
            close(numbers, numbers[BOUND])


@compiled
def search(quad, table, constant, tolerance, tree, room, work):
    """Search best first (branch and bound), on from where the tree is.

    Args:
        quad: what to minimise, over points of shape (N, 2).
        table: the cells of the floor, :class:`orbimpc_ros.mpc.geometry.cells.Table`.
        constant: what values lack; it only scales the tolerance.
        tolerance: relative gap at which to stop.
        tree: begun by :func:`begin_cells`; updated in place.
        room: nodes to solve in all, at most; no more than the tree has room for.
        work: multiplications to do at most, though no less than one row takes.

    Returns:
        ``DONE``; ``FULL``, where all nodes that there is room for are solved; ``PAUSED``, where
        the work has run out.
    """
    status = _search(quad, table, constant, tolerance, tree, room, work)
    set_least(tree)
    return status


@compiled
def splits_of(quad, table, tree):
    """Return the tree of a search; see :class:`orbimpc_ros.mpc.solve.split_tree.Splits`.

    A node that was solved has its Lagrangian's minimiser for a point. One that was not has its
    parent's, one dual step along its own row farther: what its bound was taken from.

    Args:
        quad: what was minimised.
        table: the cells of the floor.
        tree: of a search that has begun.

    Returns:
        Splits, parts and points; the splits are by cells, and nothing is bent.
    """
    solved, count, steps = tree.counts[NODES], len(table.bounds), len(tree.x)
    total = 1
    for own in range(1, solved + 1):
        total += count * (tree.split[own] >= 0)
    splits, parts = np.full(total, -1), np.zeros(total, np.int64)
    points, place = np.zeros((total, steps, 2)), np.empty(tree.counts[MADE], np.int64)
    place[0], following, child = 0, 1, 1
    for own in range(1, solved + 1):
        at, k, x = place[tree.solved[own]], tree.split[own], points[place[tree.solved[own]]]
        if own == 1 or tree.active[own] > 0:
            _minimiser(
                quad.inverse, quad.q, tree.rows[own], tree.normals[own], tree.u[own],
                tree.active[own], x,
            )  # fmt: skip
        if k < 0:
            continue
        splits[at], parts[at] = k, following
        for cell in range(count):
            normal, moved = table.normals[cell], points[following + cell]
            share = _miss(table.normals, table.bounds, cell, x[k]) / quad.inverse[k, k]
            for j in range(steps):
                along = share * quad.inverse[j, k]
                moved[j, 0], moved[j, 1] = x[j, 0] + along * normal[0], x[j, 1] + along * normal[1]
        while child < len(place) and tree.parent[child] == own:
            place[child] = following + tree.choice[child, k]
            child += 1
        following += count
    return splits, parts, points


@compiled
def _set_nearest(table, tree, own, x, choice):
    """Set the cell of each step: one that already holds it, otherwise the one nearest to x."""
    for k in range(len(x)):
        least, choice[k] = np.inf, -1
        for cell in range(len(table.bounds)):
            miss = table.bounds[cell] - table.normals[cell, 0] * x[k, 0]
            miss -= table.normals[cell, 1] * x[k, 1]
            if miss < least:
                least, choice[k] = miss, cell
    for i in range(tree.active[own]):
        for cell in range(len(table.bounds)):
            if (
                tree.offsets[own, i] == table.bounds[cell]
                and tree.normals[own, i, 0] == table.normals[cell, 0]
                and tree.normals[own, i, 1] == table.normals[cell, 1]
            ):
                choice[tree.rows[own, i]] = cell


@compiled
def dive(quad, table, tree, work):
    """Look for headings on the floor near those of the last relaxation, to be the tree's best.

    That relaxation is solved on with a cell held at every step; where that fails, or takes longer
    than it may, the headings that it came to are put onto these cells one by one.

    Args:
        quad: what to minimise.
        table: the cells of the floor.
        tree: of a search that has begun; updated in place if this finds better headings.
        work: multiplications to do at most.
    """
    numbers = tree.numbers
    own = tree.counts[NODES]
    x, count, choice = tree.x.copy(), tree.active[own], np.empty(len(tree.x), np.int32)
    _set_nearest(table, tree, own, x, choice)
    rows, normals = tree.rows[own].copy(), tree.normals[own].copy()
    offsets, u = tree.offsets[own].copy(), tree.u[own].copy()
    _minimiser(quad.inverse, quad.q, rows, normals, u, count, x)
    status = _relax(
        quad, table.normals, table.bounds, choice, np.inf, rows, normals, offsets, u, count, x, 0,
        work,
    )[0]  # fmt: skip
    if status != SOLVED:
        if status == STALLED:
            x[:] = tree.x
        for k in range(len(x)):
            if choice[k] >= 0:
                _put_on(table.normals[choice[k]], table.bounds[choice[k]], x[k])
            else:
                x[k] /= max(1.0, np.sqrt(x[k, 0] ** 2 + x[k, 1] ** 2))
    reached = quadratic(quad.hessian, quad.q, x)
    if reached < numbers[VALUE]:
        tree.best[:], numbers[VALUE] = x, reached
        numbers[LEAST] = min(numbers[LEAST], reached)


@compiled
def _put_on(normal, bound, point):
    """Take a point to the part of the disk beyond n . z = b, along the normal, then the line."""
    across = normal[0] * point[1] - normal[1] * point[0]
    along = max(bound, normal[0] * point[0] + normal[1] * point[1])
    size = np.sqrt(along * along + across * across)
    if size > 1.0:
        if along / size >= bound:
            along, across = along / size, across / size
        else:
            along, across = bound, np.copysign(np.sqrt(1.0 - bound * bound), across)
    point[0] = along * normal[0] - across * normal[1]
    point[1] = along * normal[1] + across * normal[0]
