# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Branch and bound over headings within sectors: a floor together with a turn rate.

Headings are unwrapped: a node holds theta_k in [low_k, high_k] at every step. The first heading is
known and turns are limited, so the root's sectors are narrow to begin with, and what is learnt of
one step narrows its neighbours. At a node, a sector narrower than half a turn is a convex set: the
disk, both edges, and what lies beyond the chord between the least speeds along the edges. The
quadratic program over these rows is solved by a dual active-set method, as in
:mod:`orbimpc_ros.mpc.kernels.active_set`, whose bounds hold at any time and whose children start
from their parent's active set.

Where changes of speed are limited, a node holds a range of speeds for every step as well, narrowed
in the same way: its greatest is the radius of the disk, its least that of an arc in the sector.

Every node's headings are also rounded to a trajectory that holds floor and turn rate, from which
:mod:`orbimpc_ros.mpc.kernels.steering` descends.

Mathematics: docs/mathematics.md, 4.10.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.active_set import FLAT, lagrangian
from orbimpc_ros.mpc.kernels.best_first import (
    ACTIVE,
    BOUND,
    CURRENT,
    GOING,
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
    STARTS,
    VALUE,
    advance,
    begin,
    close,
    cutoff_of,
    keep,
    set_least,
    worked,
)
from orbimpc_ros.mpc.kernels.linear import (
    SINGULAR,
    add_product,
    extend_factor,
    quadratic,
    solve_factored,
)
from orbimpc_ros.mpc.kernels.steering import (
    least_speed,
    set_headings,
    set_paced,
    set_rounded,
    steer,
)

ITERATIONS = 400
OUTSIDE = 3e-6  # a row violated by less holds: what a node lacks for it, its bound lacks as well
SATISFIED = 1e-8  # a floor or turn missed by less need not be branched on
MARGIN = 0.15  # of a sector: no part is narrower
HALF = np.pi - 1e-9
NARROWEST = 1e-6  # a sector [rad], or a range of speeds, that is not cut
SURE = 1.0 - 1e-6  # of a gain
PULLS = (1.0, 30.0, 1000.0)  # on the last heading, in curvatures of the cost


class Sectors(NamedTuple):
    """A search: its nodes, each with the active set it ended with, and the best trajectory.

    Attributes:
        rows: the steps of active rows, shape (S, 2N + 2).
        normals: of rows n.z_k >= offset, shape (S, 2N + 2, 2).
        offsets: shape (S, 2N + 2).
        u: multipliers, >= 0, shape (S, 2N + 2).
        active: how many there are, shape (S,); the first state is empty, for the root.
        low: least headings of a node [rad], shape (M, N).
        high: greatest, shape (M, N).
        slow: least speeds of a node, shape (M, N).
        fast: greatest, shape (M, N).
        parent: whose active set a node begins with, shape (M,).
        splits: the step k by whose heading a node was split, N + k by whose speed, -1 where it was
            not, shape (M,).
        parts: the first of its two children, which have what is below and above, shape (M,).
        angles: that heading [rad], or speed, shape (M,).
        points: the minimiser of the Lagrangian that a node's bound is of, shape (M, N, 2).
        keys: bounds of the open nodes, a heap, shape (M,).
        heap: their numbers, shape (M,).
        chords: rows of the sectors at the node at work, normals and offsets, shape (N, 3).
        edges: normals of their edges, zero where there are none, shape (N, 2, 2).
        gram: n_i.H^-1 n_j of its active rows, the lower triangle, shape (2N + 2, 2N + 2).
        factor: of Cholesky, of the same shape.
        along: n_i.H^-1 n of another row, shape (2N + 2,).
        image: H^-1 n, shape (N, 2).
        row: n, shape (2,).
        images: H^-1 n_i, shape (2N + 2, N, 2).
        free: -H^-1 q, shape (N, 2).
        x: headings of the last node, shape (N, 2).
        best: the best trajectory, shape (N, 2).
        speeds: of a trajectory being made, shape (N,).
        turns: shape (N,).
        z: shape (N, 2).
        counts, numbers: see :mod:`orbimpc_ros.mpc.kernels.best_first`, shapes (8,) and (4,).
    """

    rows: np.ndarray
    normals: Array
    offsets: Array
    u: Array
    active: np.ndarray
    low: Array
    high: Array
    slow: Array
    fast: Array
    parent: np.ndarray
    splits: np.ndarray
    parts: np.ndarray
    angles: Array
    points: Array
    keys: Array
    heap: np.ndarray
    chords: Array
    edges: Array
    gram: Array
    factor: Array
    along: Array
    image: Array
    row: Array
    images: Array
    free: Array
    x: Array
    best: Array
    speeds: Array
    turns: Array
    z: Array
    counts: np.ndarray
    numbers: Array


def sectors(steps: int, nodes: int) -> Sectors:
    """Return room for a search over N = ``steps`` steps and so many nodes."""
    states, size = nodes + 1, 2 * steps + 2
    made = 2 * nodes + steps + 2  # of which there may be as many roots as ways to wind round
    return Sectors(
        np.empty((states, size), np.int64),
        np.empty((states, size, 2)),
        np.empty((states, size)),
        np.empty((states, size)),
        np.zeros(states, np.int64),
        np.empty((made, steps)),
        np.empty((made, steps)),
        np.empty((made, steps)),
        np.empty((made, steps)),
        np.zeros(made, np.int64),
        np.empty(made, np.int64),
        np.empty(made, np.int64),
        np.empty(made),
        np.empty((made, steps, 2)),
        np.empty(made),
        np.empty(made, np.int64),
        np.zeros((steps, 3)),
        np.zeros((steps, 2, 2)),
        np.zeros((size, size)),
        np.zeros((size, size)),
        np.zeros(size),
        np.zeros((steps, 2)),
        np.zeros(2),
        np.zeros((size, steps, 2)),
        np.zeros((steps, 2)),
        np.zeros((steps, 2)),
        np.zeros((steps, 2)),
        np.zeros(steps),
        np.zeros(steps),
        np.zeros((steps, 2)),
        np.zeros(8, np.int64),
        np.zeros(4),
    )


def begin_sectors(quad, ring, tree):
    """Begin a search: all headings that can be reached.

    Args:
        quad: what to minimise.
        ring: floor, turn rate and last heading.
        tree: updated in place.

    Returns:
        Whether there are any.
    """
    begin(tree, np.inf)
    return _set_root(quad, ring, tree)


@compiled
def _set_root(quad, ring, tree):
    """Set the minimiser without rows, and the sectors of the roots; return whether there are any.

    Where the last heading is limited, there is a root for each way to wind round to it.
    """
    tree.free[:] = 0.0
    add_product(quad.inverse, quad.q, -1.0, tree.free)
    for k in range(len(tree.x)):
        reach = (k + 1) * ring.widest if ring.widest < HALF else np.pi
        tree.low[0, k], tree.high[0, k] = ring.first - reach, ring.first + reach
    _set_speeds(ring, tree.slow[0], tree.fast[0])
    tree.splits[0], tree.points[0] = -1, tree.free
    return ring.within >= HALF or _wind(ring, tree)


@compiled
def _set_speeds(ring, slow, fast):
    """Set the speeds that can be reached."""
    for k in range(len(slow)):
        changed = (k + 1) * ring.change
        slow[k] = max(ring.fraction, ring.entry - changed)
        fast[k] = min(1.0, ring.entry + changed)


@compiled
def _wind(ring, tree):
    """Make a root of each way round to the last heading; return whether there are any."""
    steps = len(tree.x)
    away, reach = ring.last - ring.first, steps * ring.widest + ring.within
    least, most = np.ceil((-reach - away) / (2.0 * np.pi)), np.floor((reach - away) / (2.0 * np.pi))
    for made in range(int(most - least) + 1):
        _set_way(ring, least + made, tree.low[made], tree.high[made])
        _set_speeds(ring, tree.slow[made], tree.fast[made])
        if made:
            tree.splits[made], tree.points[made] = -1, tree.free
            keep(tree, -np.inf)
    return most >= least


@compiled
def _set_way(ring, turns, low, high):
    """Set what can be reached on the way to the last heading, so many full turns away from it."""
    end = len(low) - 1
    for k in range(end + 1):
        reach = (k + 1) * ring.widest
        low[k], high[k] = ring.first - reach, ring.first + reach
    middle = ring.last + 2.0 * np.pi * turns
    low[end], high[end] = max(low[end], middle - ring.within), min(high[end], middle + ring.within)
    _narrow(ring, low, high, end)


@compiled
def _minimiser(tree, own, count):
    """Set x to the minimiser of the Lagrangian: H x + q - sum_i u_i n_i = 0."""
    x, u, images = tree.x, tree.u[own], tree.images
    x[:] = tree.free
    for i in range(count):
        for j in range(len(x)):
            x[j, 0] += u[i] * images[i, j, 0]
            x[j, 1] += u[i] * images[i, j, 1]


@compiled
def _set_image(inverse, step, row, image):
    """Set H^-1 n, shape (N, 2), of a row over a step."""
    for j in range(len(image)):
        image[j, 0], image[j, 1] = inverse[j, step] * row[0], inverse[j, step] * row[1]


@compiled
def _drop(tree, own, i, count):
    """Take a row out of the active set, and what is kept of it."""
    rows, normals, offsets, u = tree.rows[own], tree.normals[own], tree.offsets[own], tree.u[own]
    gram, images = tree.gram, tree.images
    for j in range(i, count - 1):
        rows[j], offsets[j], u[j] = rows[j + 1], offsets[j + 1], u[j + 1]
        normals[j, 0], normals[j, 1] = normals[j + 1, 0], normals[j + 1, 1]
        for k in range(len(tree.x)):
            images[j, k, 0], images[j, k, 1] = images[j + 1, k, 0], images[j + 1, k, 1]
        for k in range(i):
            gram[j, k] = gram[j + 1, k]
        for k in range(i, j + 1):
            gram[j, k] = gram[j + 1, k + 1]


@compiled
def _add_row(inverse, tree, own, count, step, row, offset):
    """Add a violated row to the active set, dropping those in its way; x stays as it is.

    Returns:
        The new count, or -1 where rounding leaves no row to drop or to add; the multiplications
        that it took.
    """
    rows, normals, offsets, u = tree.rows[own], tree.normals[own], tree.offsets[own], tree.u[own]
    gram, images = tree.gram, tree.images
    size, steps = len(rows), len(tree.x)
    r, held, image = np.empty(size), np.empty(size), np.empty((steps, 2))
    _set_image(inverse, step, row, image)
    own_curvature = row[0] * image[step, 0] + row[1] * image[step, 1]
    flat, multiplier, spent = FLAT * own_curvature, 0.0, 0.0
    gap = offset - row[0] * tree.x[step, 0] - row[1] * tree.x[step, 1]
    for _ in range(4 * size):
        spent += count * (2.0 * count + 4.0)
        for i in range(count):
            held[i] = r[i] = normals[i, 0] * image[rows[i], 0] + normals[i, 1] * image[rows[i], 1]
        curvature = own_curvature - solve_factored(tree.factor, r, count)
        blocking, limit = -1, np.inf
        for i in range(count):
            if r[i] > FLAT and u[i] < limit * r[i]:
                blocking, limit = i, u[i] / r[i]
        whole = gap / curvature if curvature > flat else np.inf
        move = min(limit, whole)
        if move == np.inf:
            return -1, spent
        multiplier += move
        for i in range(count):
            u[i] = max(0.0, u[i] - move * r[i])
        gap -= move * max(0.0, curvature)
        if whole <= limit:
            if count == size:
                return -1, spent
            rows[count], offsets[count], u[count] = step, offset, multiplier
            normals[count], images[count], gram[count, count] = row, image, own_curvature
            for i in range(count):
                gram[count, i] = held[i]
            if not extend_factor(gram, tree.factor, count, count + 1, SINGULAR):
                return -1, spent
            return count + 1, spent
        _drop(tree, own, blocking, count)
        count -= 1
        spent += (count - blocking) * count * (0.5 * count + 4.0 * steps)
        if not extend_factor(gram, tree.factor, blocking, count, SINGULAR):
            return -1, spent
    return -1, spent


@compiled
def _set_sectors(ring, low, high, slow, fast, chords, edges):
    """Set the rows of each sector: beyond its chord, n.z_k >= b, and between its edges.

    Where the arc of the least speed is farther out in the middle, the chord is that arc's.
    """
    for k in range(len(low)):
        width = high[k] - low[k]
        edges[k] = 0.0
        if width >= 2.0 * np.pi - 1e-9:
            chords[k] = 0.0, 0.0, -1.0
        elif width >= HALF:
            middle = 0.5 * (low[k] + high[k])
            chords[k] = np.cos(middle), np.sin(middle), np.cos(0.5 * width) * fast[k]
        else:
            first, last = least_speed(ring, low[k])[0], least_speed(ring, high[k])[0]
            ax, ay = first * np.cos(low[k]), first * np.sin(low[k])
            bx, by = last * np.cos(high[k]), last * np.sin(high[k])
            nx, ny = by - ay, ax - bx
            size = np.sqrt(nx * nx + ny * ny)
            if size > 1e-9:
                nx, ny = nx / size, ny / size
            else:
                nx, ny = np.cos(low[k]), np.sin(low[k])
            chords[k] = nx, ny, min(nx * ax + ny * ay, nx * bx + ny * by)
            mx, my = np.cos(low[k] + 0.5 * width), np.sin(low[k] + 0.5 * width)
            arc = slow[k] * np.cos(0.5 * width)
            if slow[k] > ring.fraction and arc * (nx * mx + ny * my) > chords[k, 2]:
                chords[k] = mx, my, arc
            edges[k, 0, 0], edges[k, 0, 1] = -np.sin(low[k]), np.cos(low[k])
            edges[k, 1, 0], edges[k, 1, 1] = np.sin(high[k]), -np.cos(high[k])


@compiled
def _most_violated(x, chords, edges, fast, row):
    """Set the row over one step that is violated most; return its step, -1 if none is, and offset.

    The rows are tangents of the disk, chords, and edges of sectors narrower than half a turn.
    """
    worst, step, offset = OUTSIDE, -1, 0.0
    for k in range(len(x)):
        square = x[k, 0] * x[k, 0] + x[k, 1] * x[k, 1]
        if square > fast[k] * fast[k]:
            size = np.sqrt(square)
            if size - fast[k] > worst:
                worst, step, offset = size - fast[k], k, -fast[k]
                row[0], row[1] = -x[k, 0] / size, -x[k, 1] / size
        short = chords[k, 2] - chords[k, 0] * x[k, 0] - chords[k, 1] * x[k, 1]
        if short > worst:
            worst, step, offset = short, k, chords[k, 2]
            row[0], row[1] = chords[k, 0], chords[k, 1]
        for side in range(2):  # all zero where the sector has no edges
            short = -edges[k, side, 0] * x[k, 0] - edges[k, side, 1] * x[k, 1]
            if short > worst:
                worst, step, offset = short, k, 0.0
                row[0], row[1] = edges[k, side, 0], edges[k, side, 1]
    return step, offset


@compiled
def _value(tree, own, count, least):
    """Return the Lagrangian's minimum where its active rows hold, given that without any rows."""
    rows, normals, offsets, u = tree.rows[own], tree.normals[own], tree.offsets[own], tree.u[own]
    value = least
    for i in range(count):
        free = tree.free[rows[i]]
        short = offsets[i] - normals[i, 0] * free[0] - normals[i, 1] * free[1]
        value += 0.5 * u[i] * short
    return value


@compiled
def _relax(quad, tree, node, own, cutoff, count, added, work):
    """Solve a node on from an active set and its minimiser.

    The bound that is safe from rounding takes longer than the value that it is a bound of: it is
    evaluated where it may end the node, and at the end.

    Returns what becomes of it, the bound, the active count, the rows added by now, the work left.
    """
    rows, normals, offsets, u = tree.rows[own], tree.normals[own], tree.offsets[own], tree.u[own]
    x, row, begun, status = tree.x, np.zeros(2), added, STALLED
    least = quadratic(quad.hessian, quad.q, tree.free)
    while added < ITERATIONS:
        if _value(tree, own, count, least) >= cutoff:
            bound = lagrangian(quad, rows, normals, offsets, u, count, x)
            if bound >= cutoff:
                return PRUNED, bound, count, added, work
        step, offset = _most_violated(x, tree.chords, tree.edges, tree.fast[node], row)
        if step < 0:
            status = SOLVED
            break
        if work <= 0.0 and added > begun:
            status = GOING
            break
        following, spent = _add_row(quad.inverse, tree, own, count, step, row, offset)
        work -= spent + 2.0 * len(x) ** 2 + NODE
        if following < 0:
            return STALLED, -np.inf, 0, added, work
        count, added = following, added + 1
        _minimiser(tree, own, count)
        work -= 4.0 * count * len(x)
    bound = lagrangian(quad, rows, normals, offsets, u, count, x)
    return status, bound, count, added, work


@compiled
def _narrow_rows(tree, node, own, count):
    """Exchange the chords and edges of a parent's active set for those of a node's own sectors.

    Tangents of the disk, as far out as the parent was allowed to be fast, still hold.
    """
    for i in range(count):
        k, normal = tree.rows[own, i], tree.normals[own, i]
        if tree.offsets[own, i] == 0.0:
            edges = tree.edges[k]
            left = edges[0, 0] * normal[0] + edges[0, 1] * normal[1]
            right = edges[1, 0] * normal[0] + edges[1, 1] * normal[1]
            normal[:] = edges[0] if left > right else edges[1]
        elif tree.offsets[own, i] > -tree.fast[node, k]:
            normal[:], tree.offsets[own, i] = tree.chords[k, :2], tree.chords[k, 2]


@compiled
def _set_multipliers(tree, own, count):
    """Set the multipliers with which all active rows hold, dropping those that would pull.

    Returns:
        The new count; 0 where rows depend on each other, and nothing is lost but a start.
    """
    rows, normals, offsets, u = tree.rows[own], tree.normals[own], tree.offsets[own], tree.u[own]
    while count > 0:
        for i in range(count):
            free = tree.free[rows[i]]
            u[i] = offsets[i] - normals[i, 0] * free[0] - normals[i, 1] * free[1]
        solve_factored(tree.factor, u, count)
        least = 0
        for i in range(count):
            if u[i] < u[least]:
                least = i
        if u[least] >= 0.0:
            break
        _drop(tree, own, least, count)
        count -= 1
        if not extend_factor(tree.gram, tree.factor, least, count, SINGULAR):
            return 0
    return count


@compiled
def _open(quad, ring, tree, node):
    """Begin to work on the current node: set up what its active set and sectors lead to."""
    own, count = tree.counts[NODES], tree.counts[ACTIVE]
    _set_node(ring, tree, node)
    _narrow_rows(tree, node, own, count)
    for i in range(count):
        row = tree.normals[own, i]
        _set_image(quad.inverse, tree.rows[own, i], row, tree.images[i])
        for j in range(i + 1):
            step, other = tree.rows[own, j], tree.normals[own, j]
            tree.gram[i, j] = (
                other[0] * tree.images[i, step, 0] + other[1] * tree.images[i, step, 1]
            )
    if extend_factor(tree.gram, tree.factor, 0, count, SINGULAR):
        count = _set_multipliers(tree, own, count)
    else:
        count = 0
    tree.counts[ACTIVE] = count
    _minimiser(tree, own, count)


@compiled
def _set_node(ring, tree, node):
    """Set the rows of a node's sectors."""
    low, high, slow, fast = tree.low[node], tree.high[node], tree.slow[node], tree.fast[node]
    _set_sectors(ring, low, high, slow, fast, tree.chords, tree.edges)


@compiled
def _cut_at(ring, angle, low, high):
    """Return where to cut a sector: at a corner of the floor inside it, else near an angle."""
    middle, width = 0.5 * (low + high), high - low
    if width > HALF:
        angle = middle
    angle = angle + 2.0 * np.pi * np.round((middle - angle) / (2.0 * np.pi))
    angle = min(high - MARGIN * width, max(low + MARGIN * width, angle))
    if ring.faces > 0:
        share = 2.0 * np.pi / ring.faces
        corner = share * (np.round(angle / share - 0.5) + 0.5)
        if low + 1e-9 < corner < high - 1e-9:
            return corner
        above, below = corner + share, corner - share
        if low + 1e-9 < above < high - 1e-9:
            return above
        if low + 1e-9 < below < high - 1e-9:
            return below
    return angle


@compiled
def _gain(quad, tree, own, count, step, row, offset, point):
    """Return by how much one dual step along a row raises the bound of the node at work.

    The minimiser of the Lagrangian, ``point``, is taken along.
    """
    short = offset - row[0] * tree.x[step, 0] - row[1] * tree.x[step, 1]
    if short <= 0.0:
        return 0.0
    rows, normals, u, r = tree.rows[own], tree.normals[own], tree.u[own], tree.along
    _set_image(quad.inverse, step, row, tree.image)
    for i in range(count):
        image = tree.image[rows[i]]
        r[i] = normals[i, 0] * image[0] + normals[i, 1] * image[1]
    curvature = quad.inverse[step, step] - solve_factored(tree.factor, r, count)
    limit = np.inf
    for i in range(count):
        if r[i] > FLAT and u[i] < limit * r[i]:
            limit = u[i] / r[i]
    move = min(limit, short / max(curvature, FLAT * quad.inverse[step, step]))
    for j in range(len(point)):
        for c in range(2):
            along = tree.image[j, c]
            for i in range(count):
                along -= r[i] * tree.images[i, j, c]
            point[j, c] += move * along
    return move * (short - 0.5 * move * max(0.0, curvature))


@compiled
def _branching(ring, inverse, x, low, high, slow):
    """Return the step to branch on, -1 if there is none, where to cut its sector, and the gain.

    What a step misses of the floor, finer sectors will ask of it. Where a turn is too wide, the
    wider of its two sectors is cut such that either part leaves the one heading or the other out.
    Late turns come first, in proportion to their number: what a late step has to be headed for
    narrows all before it, whereas an early turn leaves those after it nearly as free as they were.
    """
    chosen, cut, gain = -1, 0.0, -1.0
    before, last = ring.first, 1.0
    for k in range(len(x)):
        size = np.sqrt(x[k, 0] ** 2 + x[k, 1] ** 2)
        angle = np.arctan2(x[k, 1], x[k, 0])
        width, wider = high[k] - low[k], -1.0
        short = max(slow[k], least_speed(ring, angle)[0]) - size
        if short > SATISFIED and width > NARROWEST:
            raised = short * short / (2.0 * inverse[k, k])
            if raised > gain:
                chosen, gain, cut = k, raised, _cut_at(ring, angle, low[k], high[k])
        turn = angle - before - 2.0 * np.pi * np.round((angle - before) / (2.0 * np.pi))
        excess = abs(turn) - ring.widest
        if excess > SATISFIED:
            half, away = np.sin(0.5 * excess), np.copysign(0.5 * excess, turn)
            raised = (size * half) ** 2 / (2.0 * inverse[k, k])
            if k > 0:
                raised = min(raised, (last * half) ** 2 / (2.0 * inverse[k - 1, k - 1]))
                wider = high[k - 1] - low[k - 1]
            raised *= k + 1.0
            if wider > max(NARROWEST, width) and raised > gain:
                chosen, gain = k - 1, raised
                cut = _cut_at(ring, before + away, low[k - 1], high[k - 1])
            elif width > NARROWEST and raised > gain:
                chosen, gain, cut = k, raised, _cut_at(ring, angle - away, low[k], high[k])
        before, last = angle, size
    return chosen, cut, gain


@compiled
def _speed_branching(ring, inverse, x, slow, fast):
    """Return what :func:`_branching` does, of the ranges of speeds.

    Where the speed changes too much, the wider of both ranges is cut such that either part leaves
    the one speed or the other out.
    """
    chosen, cut, gain, last, held = -1, 0.0, -1.0, ring.entry, False
    for k in range(len(x)):
        size = np.sqrt(x[k, 0] ** 2 + x[k, 1] ** 2)
        half, holds = 0.5 * (abs(size - last) - ring.change), size > slow[k] - OUTSIDE
        if half > SATISFIED and held and holds:
            away = np.copysign(half, size - last)
            j, at = k, size - away
            if fast[k - 1] - slow[k - 1] > fast[k] - slow[k]:
                j, at = k - 1, last + away
            width = fast[j] - slow[j]
            raised = half * half / (2.0 * max(inverse[k, k], inverse[k - 1, k - 1])) * (k + 1.0)
            if width > NARROWEST and raised > gain:
                edge = MARGIN * width
                chosen, gain = j, raised
                cut = min(fast[j] - edge, max(slow[j] + edge, at))
        last, held = size, holds
    return chosen, cut, gain


@compiled
def _narrow(ring, low, high, chosen):
    """Carry what is known of a step's sector to its neighbours."""
    if ring.widest < HALF:
        _carry(low, high, chosen, ring.widest)


@compiled
def _carry(low, high, chosen, most):
    """Narrow the ranges of all steps to what one of them leaves, a change of so much at a time."""
    for k in range(chosen + 1, len(low)):
        low[k] = max(low[k], low[k - 1] - most)
        high[k] = min(high[k], high[k - 1] + most)
    for k in range(chosen - 1, -1, -1):
        low[k] = max(low[k], low[k + 1] - most)
        high[k] = min(high[k], high[k + 1] + most)


@compiled
def _is_empty(ring, low, high, slow, fast):
    """Return whether no speed is left of a range, or none that the floor allows in the sector."""
    for k in range(len(slow)):
        if slow[k] > fast[k] + SATISFIED:
            return True
        if ring.faces > 0:
            share = 2.0 * np.pi / ring.faces
            nearest = share * np.round(0.5 * (low[k] + high[k]) / share)
            nearest = min(high[k], max(low[k], nearest))
            if least_speed(ring, nearest)[0] > fast[k] + SATISFIED:
                return True
    return False


@compiled
def _set_child(ring, tree, node, cut, side):
    """Set the sectors and ranges of speeds of a child; return whether any heading is left."""
    k, at, of_speeds = cut
    made = tree.counts[MADE]
    low, high, slow, fast = tree.low[made], tree.high[made], tree.slow[made], tree.fast[made]
    low[:], high[:] = tree.low[node], tree.high[node]
    slow[:], fast[:] = tree.slow[node], tree.fast[node]
    below, above = (slow, fast) if of_speeds else (low, high)
    if side:
        below[k] = at
    else:
        above[k] = at
    if of_speeds:
        _carry(slow, fast, k, ring.change)
    else:
        _narrow(ring, low, high, k)
    return ring.change == np.inf or not _is_empty(ring, low, high, slow, fast)


@compiled
def _cut_of(quad, ring, tree, node):
    """Return the step to branch on, -1 if there is none, where, and whether on its speeds."""
    slow, fast = tree.slow[node], tree.fast[node]
    low, high = tree.low[node], tree.high[node]
    k, at, gain = _branching(ring, quad.inverse, tree.x, low, high, slow)
    if ring.change < np.inf:
        j, speed, more = _speed_branching(ring, quad.inverse, tree.x, slow, fast)
        if more > gain:
            return j, speed, True
    return k, at, False


@compiled
def _branch(quad, ring, tree, node, own, cutoff, dual):
    """Open the two children of a node, or note that it has none.

    What a child's own row gains it gains on the dual value of the node's minimiser, which may be
    less than the node's bound: ranges of speeds can exchange a row that the bound is of.
    """
    counts, numbers = tree.counts, tree.numbers
    bound, cut = numbers[BOUND], _cut_of(quad, ring, tree, node)
    if cut[0] < 0:
        close(numbers, bound)
        return
    tree.splits[node] = cut[0] + len(tree.x) if cut[2] else cut[0]
    tree.parts[node], tree.angles[node] = counts[MADE], cut[1]
    for side in range(2):
        made = counts[MADE]
        tree.splits[made], tree.points[made] = -1, tree.points[node]
        if not _set_child(ring, tree, node, cut, side):
            counts[MADE] += 1  # it is a leaf of nothing
            continue
        _set_node(ring, tree, made)
        step, offset = _most_violated(tree.x, tree.chords, tree.edges, tree.fast[made], tree.row)
        key = bound
        if step >= 0:
            known, tree.z[:] = (tree.active[own], step, tree.row, offset), tree.x
            raised = dual + SURE * _gain(quad, tree, own, *known, tree.z)
            if raised > key:
                key, tree.points[made] = raised, tree.z
        if key >= cutoff:
            close(numbers, key)
            counts[MADE] += 1  # it is a leaf
        else:
            keep(tree, key)


@compiled
def offer(quad, ring, constant, tree, x, low, high, share):
    """Round headings to a trajectory and descend from it where it is promising.

    Where the last heading is limited, the trajectory itself counts as well.

    Args:
        quad: what to minimise.
        ring: floor and turn rate.
        constant: what costs lack.
        tree: whose best is replaced by a better one.
        x: headings, shape (N, 2).
        low: least headings, shape (N,).
        high: greatest, shape (N,).
        share: of the best cost that the rounded one may be worse by, to be worth a descent.

    Returns:
        The multiplications that it took.
    """
    numbers = tree.numbers
    set_rounded(ring, x, low, high, tree.speeds, tree.turns)
    if ring.change < np.inf and not set_paced(ring, tree.speeds, tree.turns):
        return 0.0
    set_headings(ring, tree.speeds, tree.turns, tree.z)
    rounded = quadratic(quad.hessian, quad.q, tree.z)
    if rounded > numbers[VALUE] + share * abs(numbers[VALUE] + constant):
        return 0.0
    if (ring.change < np.inf or ring.within < HALF) and rounded < numbers[VALUE]:
        # A descent may end where no trajectory is legal.
        numbers[VALUE], tree.best[:] = rounded, tree.z
    cost, taken = steer(quad.hessian, quad.q, ring, constant, tree.speeds, tree.turns, tree.z)
    tree.counts[STARTS] += 1
    if ring.within < HALF:
        cost, more = _steer_home(quad, ring, constant, tree, cost)
        taken += more
    if cost < numbers[VALUE]:
        numbers[VALUE], tree.best[:] = cost, tree.z
    return taken * (2.0 * len(x)) ** 3


@compiled
def _steer_home(quad, ring, constant, tree, cost):
    """Descend on to a trajectory with a last heading that is allowed, if this one's is not.

    The nearest that is allowed pulls the last heading, ever harder; then it is taken for it.

    Returns:
        The cost, and the Newton steps taken.
    """
    steps, taken = len(tree.x), 0
    hessian, q = quad.hessian.copy(), quad.q.copy()
    for pull in PULLS:
        angle = ring.first + tree.turns.sum()
        turns = np.round((angle - ring.last) / (2.0 * np.pi))
        off = angle - ring.last - 2.0 * np.pi * turns
        if abs(off) <= ring.within:
            break
        edge, size = ring.last + np.copysign(ring.within, off), np.sqrt((tree.z[-1] ** 2).sum())
        weight = pull * np.abs(quad.hessian).max()
        hessian[-1, -1] = quad.hessian[-1, -1] + weight
        q[-1, 0] = quad.q[-1, 0] - weight * size * np.cos(edge)
        q[-1, 1] = quad.q[-1, 1] - weight * size * np.sin(edge)
        pulled = steer(hessian, q, ring, constant, tree.speeds, tree.turns, tree.z)
        taken += pulled[1]
    if taken == 0:
        return cost, taken
    low, high, x = np.empty(steps), np.empty(steps), tree.z.copy()
    angle = ring.first + tree.turns.sum()
    _set_way(ring, np.round((angle - ring.last) / (2.0 * np.pi)), low, high)
    if low[0] > high[0]:
        return np.inf, taken
    set_rounded(ring, x, low, high, tree.speeds, tree.turns)
    if ring.change < np.inf and not set_paced(ring, tree.speeds, tree.turns):
        return np.inf, taken
    set_headings(ring, tree.speeds, tree.turns, tree.z)
    return quadratic(quad.hessian, quad.q, tree.z), taken


@compiled
def _search(quad, ring, constant, tolerance, tree, room, work):
    """Do as :func:`search`, but for the bound of the whole."""
    counts, numbers = tree.counts, tree.numbers
    while True:
        cutoff = cutoff_of(numbers[VALUE], constant, tolerance)
        coming = advance(tree, cutoff, room, work)
        if coming not in (OPENED, RESUMED):
            return coming
        node, own = counts[CURRENT], counts[NODES]
        if coming == OPENED:
            _open(quad, ring, tree, node)
            work -= NODE + 2.0 * len(tree.x) ** 2
        status, bound, count, counts[ROWS_ADDED], work = _relax(
            quad, tree, node, own, cutoff, counts[ACTIVE], counts[ROWS_ADDED], work
        )
        if bound > numbers[BOUND]:
            tree.points[node] = tree.x
        worked(counts, numbers, tree.active, status, bound, count)
        if status == GOING:
            return PAUSED
        if status == PRUNED:
            close(numbers, numbers[BOUND])
            continue
        if status == SOLVED:
            # Where the search is young, and ever less often later.
            share = 0.5 if counts[NODES] & (counts[NODES] - 1) == 0 else 0.0
            low, high = tree.low[node], tree.high[node]
            work -= offer(quad, ring, constant, tree, tree.x, low, high, share)
        else:  # what arithmetic cannot settle, its parts may
            counts[ACTIVE] = tree.active[own] = 0
            tree.x[:], bound = tree.points[node], numbers[BOUND]
        _branch(quad, ring, tree, node, own, cutoff, bound)


@compiled
def search(quad, ring, constant, tolerance, tree, room, work):
    """Search best first, on from where the tree is.

    Args:
        quad: what to minimise, over headings of shape (N, 2).
        ring: floor and turn rate.
        constant: what values lack; it only scales the tolerance.
        tolerance: relative gap at which to stop.
        tree: begun by :func:`begin_sectors`; updated in place.
        room: nodes to solve in all, at most.
        work: multiplications to do at most, though no less than one row takes.

    Returns:
        ``DONE``; ``FULL``, where all nodes that there is room for are solved; ``PAUSED``, where
        the work has run out.
    """
    status = _search(quad, ring, constant, tolerance, tree, room, work)
    set_least(tree)
    return status
