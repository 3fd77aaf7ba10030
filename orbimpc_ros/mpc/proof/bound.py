# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The bound that a tree proves, for any numbers in it; one source for both arithmetics.

At a leaf, F is the cost without lengths, less sum_k b_k |z_k|^2 / 2, plus multiplier terms of the
leaf's constraints, which are at most zero. If F is convex, its tangent at any point x' is below it,
so that every trajectory of the leaf costs at least

    F(x') - g . x' + sum_k min (g_k . x_k + l_k |z_k| + b_k |z_k|^2 / 2),  g = grad F(x'),

with each minimum over the stage set of x_k.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.proof.arithmetic import as_fractions, coarse, generic, slack
from orbimpc_ros.mpc.proof.flight import DECIDED, FIRST, WANTED, pulled_back, rolled
from orbimpc_ros.mpc.proof.rows import counted, pressed, pulled, slid, towed
from orbimpc_ros.mpc.proof.sets import dot, over_orbitope, over_speeds, over_stage, size_of
from orbimpc_ros.mpc.proof.splits import HELD, WRONG, begin, part_of
from orbimpc_ros.mpc.proof.tree import CHILD, CHILDREN, EMPTY, KIND, LEAF, ROW

# The walk has ended; the tree is invalid; the walk has paused, or needs a row for another depth.
ENDED, UNSOUND, PAUSED, DEEP = range(4)
DEPTH, PARENT = range(2)  # rows of a walk


class Units(NamedTuple):
    """Work arrays of N trajectories along one axis, each with one unit heading, from zeros.

    Their slopes are the Hessian of the cost, and the ends of their paths the rows of an arrival.

    Attributes:
        nothing: zeros for start and goals, shape (6 + N, N).
        point: ones on the diagonal, shape (N, N).
        flown: shape (4, N + 1, N).
        slopes: shape (N, N).
    """

    nothing: Any
    point: Any
    flown: Any
    slopes: Any


class Work(NamedTuple):
    """Work arrays.

    Attributes:
        flown: positions relative to s_0, velocities, and forces on both, shape (4, N + 1, n).
        slopes: shape (N, d).
        total: the bound of a leaf, and the size of the terms it is summed from, shape (2,).
        vectors: a normal, and the remainder of a slope, shape (2, d or 3).
        matrix: shape (4, 4).
        squares: what is left of the Hessian of the cost, and two rows, shape (N + 2, N).
        ends: the ends of the last sectors in the plane, as :func:`rim` sets them, shape (N, 2, 5).
        convex: curvatures without which the cost is convex, shape (N,).
        units: for the Hessian.
    """

    flown: Any
    slopes: Any
    total: Any
    vectors: Any
    matrix: Any
    squares: Any
    ends: Any
    convex: Any
    units: Units


@generic
def _turned(stated, start, point, slopes):
    """Add the slopes of the costs of turns and of the final attitude; return these costs."""
    count, weight, order = len(point), stated.turned, stated.order
    value = 0 * weight
    for c in range(point.shape[1]):
        before, moved = start[FIRST, c], 0 * weight
        for k in range(count if weight != 0 else 0):
            last, moved = moved, point[k, c] - before
            before, turned = point[k, c], moved - (order - 1) * last
            if k < order - 1:
                continue
            push = 2 * weight * turned
            value, slopes[k, c] = value + weight * turned * turned, slopes[k, c] + push
            if k > 0:
                slopes[k - 1, c] = slopes[k - 1, c] - order * push
            if order == 2 and k > 1:
                slopes[k - 2, c] = slopes[k - 2, c] + push
        off = point[count - 1, c] - start[WANTED, c]
        value = value + stated.aimed * off * off
        slopes[count - 1, c] = slopes[count - 1, c] + 2 * stated.aimed * off
    return value


@generic
def _flown(stated, goals, point, flown):
    """Add forces of the costs of positions and of the last velocity; return these costs."""
    count, value = len(point), 0 * stated.turned
    for c in range(flown.shape[2]):
        for k in range(1, count + 1):
            weight, miss = stated.weights[0, k], flown[0, k, c] - goals[k - 1, c]
            value = value + weight * miss * miss
            flown[2, k, c] = flown[2, k, c] + 2 * weight * miss
        fast = flown[1, count, c]
        value = value + stated.braked * fast * fast
        flown[3, count, c] = flown[3, count, c] + 2 * stated.braked * fast
    return value


@generic
def _of_decided(stated, span, g, length, shor, total):
    """Add the least cost of the first step if R_1 is decided up to a factor."""
    decided = stated.start[DECIDED]
    size, speed, along = abs(length) + abs(shor), size_of(decided, stated.n), 0 * length
    for c in range(len(g)):
        along, size = along + g[c] * decided[c], size + abs(g[c] * decided[c])
    slope, curve = along + length * speed, shor * speed * speed
    counted(total, over_speeds(slope, curve, span[0], span[1]), size * (1 + speed * speed))


@generic
def _of_step(stated, region, k, tree, leaf, length, shor, work):
    """Add the least contribution of a step to a bound.

    If a share of the slope is bounded by the limits on R e1 alone, the share and the remainder are
    minimised separately.

    Args:
        stated: the problem.
        region: of the leaf, as in :func:`over_stage`.
        k: the step, from 0 on.
        tree: whose shares are used.
        leaf: its row.
        length: weight of its length.
        shor: its own curvature.
        work: work arrays, with the slopes.
    """
    n, g, zero, orbitope = stated.n, work.slopes[k], 0 * length, len(work.slopes[k]) == 9
    own, rest, split, shared = work.vectors[0], work.vectors[1], orbitope, tree.share.size > 0
    for c in range(n if shared else 0):
        split = split or tree.share[leaf, k, c] != 0
    size = abs(length) + abs(shor)
    for c in range(len(g)):
        part = tree.share[leaf, k, c] if shared and c < n else zero
        own[c] = part if split else g[c]
        rest[c] = g[c] - own[c]
        size = size + abs(own[c]) + 2 * abs(rest[c])
    counted(work.total, over_orbitope(rest, work.matrix) if orbitope else zero, size)
    for i in range(2 if split and not orbitope else 1):
        size_weight, curve = (length, shor) if i == 0 else (zero, zero)
        least = over_stage(stated, region, k, work.vectors[i], size_weight, curve)
        counted(work.total, least, zero)


@generic
def _at_point(stated, start, goals, point, flown, slopes):
    """Set the trajectory of a point, and slopes and forces of its cost, which is returned."""
    rolled(stated.motion, start, point, flown)
    slopes[:] = 0 * stated.full
    turned = _turned(stated, start, point, slopes)
    return turned + _flown(stated, goals, point, flown)


@generic
def _tangent(n, point, shor, total, slopes):
    """Subtract a leaf's curvature from slopes, and add the tangent's value at 0."""
    value = size = 0 * shor[0]
    for k in range(len(point)):
        for c in range(point.shape[1]):
            bent = shor[k] * point[k, c] if c < n else 0 * shor[k]
            along, kept = slopes[k, c] * point[k, c], bent * point[k, c] / 2
            slopes[k, c] = slopes[k, c] - bent
            value, size = value + kept - along, size + abs(along) + abs(kept)
    counted(total, value, size)


@generic
def _held(stated, region, depth, tree, leaf, work):
    """Add a leaf's multipliers and their forces; return whether they are valid."""
    begun, end = tree.press_end[leaf - 1] if leaf > 0 else 0, tree.press_end[leaf]
    held = 0 <= begun <= end <= len(tree.press)
    if held and begun < end:
        held = pressed(stated, region, depth, tree, begun, leaf, work)
    if held and tree.tether.size > 0:
        held = towed(stated, tree.tether[leaf], tree.point[leaf], work.total, work.slopes)
    if held and tree.slide.size > 0 and stated.n == 3:
        held = slid(stated, tree.slide[leaf], work.total, work.flown)
    if tree.pull.size > 0:
        pulled(stated, tree.pull[leaf], work.total, work.flown)
    return held


@generic
def leaf_bound(stated, region, depth, tree, node, work):
    """Return the bound that a leaf proves, and whether it is sound.

    That of an empty leaf has no cost, and must be positive.

    Args:
        stated: the problem.
        region: restrictions of choices from the root to the leaf.
        depth: of the leaf.
        tree: whose arrays fit the problem.
        node: of the leaf, shape (5,).
        work: work arrays.
    """
    empty, leaf, zero, total = node[KIND] == EMPTY, node[ROW], 0 * stated.full, work.total
    if not 0 <= leaf < len(tree.point):
        return zero, False
    point, shor, slopes, count = tree.point[leaf], tree.shor[leaf], work.slopes, len(work.slopes)
    at_leaf = region.part[depth], region.span[depth], region.corners[depth], work.ends
    total[:] = zero
    if empty:
        rolled(stated.motion, stated.start, point, work.flown)
        slopes[:] = zero
    else:
        cost = _at_point(stated, stated.start, stated.goals, point, work.flown, slopes)
        cost = cost + stated.weights[1, 0] * size_of(stated.start[FIRST], stated.n)
        counted(total, cost, cost)
    if not _held(stated, region, depth, tree, leaf, work):
        return zero, False
    pulled_back(stated.motion, work.flown, slopes)
    _tangent(0 if empty else stated.n, point, shor, total, slopes)
    if not (empty or _is_bound(stated, shor, point, work)):
        return zero, False
    for k in range(count):
        length, kept = (zero, zero) if empty else (stated.weights[1, k + 1], shor[k])
        if k < stated.order - 1:
            _of_decided(stated, at_leaf[1][count], slopes[0], length, kept, total)
        else:
            _of_step(stated, at_leaf, k, tree, leaf, length, kept, work)
    value = total[0] - slack(total[1]) * (count + 4)
    return value, abs(value) >= 0 and (value > 0 or not empty)


@generic
def tree_bound(stated, tree, walk, region, work, least, leaves, t, most):
    """Return the least bound of a tree's leaves, the number of these, and the outcome.

    The tree is walked in depth-first order. The walk may pause: another call with the returned
    values resumes it.

    Args:
        stated: the problem.
        tree: whose arrays fit the problem.
        walk: depth of each node, -1 before it is reached, and its parent; shape (2, M).
        region: to be written, a row for each depth.
        work: to be written.
        least: of the bounds so far.
        leaves: number of leaves with a bound so far.
        t: next node; 0 before the walk begins.
        most: leaves after which it pauses.

    Returns:
        The least bound; the number of leaves with one; the next node; ``ENDED``, ``UNSOUND``,
        ``PAUSED``, or ``DEEP`` if the region has too few rows. A tree that ends without any bound
        refutes.
    """
    nodes, seen, status = tree.nodes, 0, HELD
    if t == 0:
        walk[DEPTH], walk[DEPTH, 0] = -1, 0
        status = begin(stated, tree.origins, region.part[0], region.span[0])
    while True:
        if t > 0:
            depth, above = walk[DEPTH, t], walk[PARENT, t]
            if seen == most or depth == len(region.part):
                return least, leaves, t, PAUSED if seen == most else DEEP
            parent = nodes[above]
            status = part_of(stated, parent, tree.at[above], t - parent[CHILD], depth, region)
        node = nodes[t]
        splits = status == HELD and node[KIND] != LEAF and node[KIND] != EMPTY
        sound = status != WRONG and not (splits and not _entered(nodes, walk, t))
        if sound and status == HELD and not splits:
            seen += 1
            value, sound = leaf_bound(stated, region, walk[DEPTH, t], tree, node, work)
            if node[KIND] == LEAF:
                least = value if leaves == 0 else min(least, value)
                leaves += 1
        if not sound:
            return least, 0, 0, UNSOUND
        t = node[CHILD] if splits else _next(nodes, walk, t)
        if t == 0:
            return least, leaves, 0, ENDED


@generic
def _entered(nodes, walk, t):
    """Set depths and parent of a node's children; return whether they may be its children.

    They may not if there are none, or if they have another parent or are before theirs.
    """
    first, parts = nodes[t, CHILD], nodes[t, CHILDREN]
    if parts < 1 or first <= t or first > len(nodes) - parts:
        return False
    for child in range(first, first + parts):
        if walk[DEPTH, child] >= 0:
            return False
        walk[DEPTH, child], walk[PARENT, child] = walk[DEPTH, t] + 1, t
    return True


@generic
def _next(nodes, walk, t):
    """Return the first node after a node's descendants, in depth-first order; 0 without one."""
    while t > 0:
        above = walk[PARENT, t]
        if t + 1 < nodes[above, CHILD] + nodes[above, CHILDREN]:
            return t + 1
        t = above
    return 0


# --- convexity of the cost less the curvature that is assigned to single steps


@generic
def _is_within(shor, most):
    """Return whether a leaf assigns no more curvature to each step than given."""
    within = True
    for k in range(len(shor)):
        within = within and shor[k] <= most[k]
    return within


@generic
def _is_bound(stated, shor, point, work):
    """Return whether the cost less a leaf's curvature is convex, so that its tangent is a bound.

    If plans must arrive, convex on the null space of the arrival's rows. The tangent has an error,
    which is subtracted, if its point misses the arrival by rounding. Without any curvature the cost
    is convex, and with less than was found to be convex it is convex, too.

    Args:
        stated: the problem.
        shor: curvature assigned to steps, shape (N,).
        point: tangent point, shape (N, d).
        work: positions and velocities there, and work arrays.
    """
    units, zero = work.units, 0 * stated.full
    if _is_within(shor, work.convex) or _is_within(shor, units.nothing[0]):
        return True
    if units.slopes[0, 0] == 0:  # not set yet: its columns are the gradients at unit headings
        nothing = units.nothing
        _at_point(stated, nothing, nothing, units.point, units.flown, units.slopes)
        pulled_back(stated.motion, units.flown, units.slopes)
    count, m, top, longest = len(shor), work.squares[: len(shor)], zero, zero + 1
    for k in range(count):
        top = max(top, units.slopes[k, k], abs(shor[k]))
    for i in range(count):
        for j in range(count):
            m[i, j] = units.slopes[i, j] / top
        m[i, i] = m[i, i] - shor[i] / top
    off = _arrived(stated, m, work) if stated.arrives > 0 else zero
    for k in range(count):
        for c in range(stated.n):
            longest = max(longest, abs(point[k, c]))
    lost = 2 * top * count * off * (2 * stated.n * count * (1 + longest) + off)
    counted(work.total, -lost, zero)
    convex = _is_convex(m, 8 * count * slack(1 + zero))
    for k in range(count if convex and stated.arrives == 0 else 0):
        work.convex[k] = shor[k]
    return convex


@generic
def _arrived(stated, m, work):
    """Make a matrix steep across the rows of an arrival, and leave it as it is along them.

    With a a row, orthogonal to the one before, and P the projection onto its null space, M becomes
    P M P + a a' / a'a.

    Returns:
        How far the point misses the arrival.
    """
    flown, arrival, count = work.flown, work.units.flown[:, len(m)], len(m)
    a, u = work.squares[count], work.squares[count + 1]
    off = ratio = 0 * stated.full
    for r in range(stated.arrives):
        largest = square = 0 * off
        for i in range(count):
            a[i] = arrival[r, i] - ratio * arrival[0, i]
            largest, square = max(largest, abs(a[i])), square + a[i] * a[i]
        if largest == 0:
            continue
        for c in range(flown.shape[2]):
            missed = flown[0, count, c] - stated.goals[count - 1, c]
            if r == 1:
                missed = flown[1, count, c] - ratio * missed
            off = off + 4 * abs(missed / largest)
        for i in range(count):
            u[i] = coarse(dot(m[i], a, count) / square)
        bent = (dot(a, u, count) + 1) / square
        for i in range(count):
            for j in range(count):
                m[i, j] = coarse(m[i, j] - u[i] * a[j] - a[i] * u[j] + bent * a[i] * a[j])
        ratio = dot(arrival[1], a, count) / square
    return off


@generic
def _is_convex(m, margin):
    """Return whether a matrix is positive definite, by elimination in its upper triangle."""
    for k in range(len(m)):
        pivot = m[k, k] - margin
        if not pivot > 0:
            return False
        for i in range(k + 1, len(m)):
            share = coarse(m[k, i] / pivot)
            for j in range(i, len(m)):
                m[i, j] = coarse(m[i, j] - share * m[k, j])
    return True


def work_of(stated: Any, kind: Any) -> Work:
    """Return the work arrays for the bounds of leaves of a problem."""
    count, n, width = len(stated.goals), stated.n, stated.start.shape[1]

    def zeros(*shape: int) -> Any:
        return np.zeros(shape, kind)

    one = as_fractions(np.eye(count)) if kind is object else np.eye(count)
    units = Units(zeros(6 + count, count), one, zeros(4, count + 1, count), zeros(count, count))
    flown, slopes, vectors = zeros(4, count + 1, n), zeros(count, width), zeros(2, width)
    matrix, squares, ends = zeros(4, 4), zeros(count + 2, count), zeros(count, 2, 5)
    return Work(flown, slopes, zeros(2), vectors, matrix, squares, ends, zeros(count), units)
