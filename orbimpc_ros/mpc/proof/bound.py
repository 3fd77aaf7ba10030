# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The bound that a tree proves, whatever its numbers are; one source for both arithmetics.

At a leaf, F is the cost without lengths, less sum_k b_k |z_k|^2 / 2, with multipliers of what holds
there, which come to no more than nothing. Where F is convex its tangent at any point is below it;
so every trajectory of the leaf costs at least

    F(x') - g . x' + sum_k min (g_k . x_k + l_k |z_k| + b_k |z_k|^2 / 2),  g = grad F(x'),

with each x_k anywhere in its stage set.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.proof.arithmetic import generic, slack
from orbimpc_ros.mpc.proof.convex import is_bent, lost, set_hessian
from orbimpc_ros.mpc.proof.flight import DECIDED, FIRST, WANTED, pulled_back, rolled
from orbimpc_ros.mpc.proof.rows import pressed, slid, towed, with_ends
from orbimpc_ros.mpc.proof.sets import over_orbitope, over_speeds, over_stage, size_of
from orbimpc_ros.mpc.proof.splits import (
    CHILD,
    CHILDREN,
    GONE,
    HELD,
    ICOSAHEDRON,
    KIND,
    ROW,
    Allowed,
    Order,
    begin,
    part_of,
)
from orbimpc_ros.mpc.proof.stated import FREE, SEGMENT, Stated
from orbimpc_ros.mpc.proof.tree import EMPTY, LEAF, ProofTree

# The least of the leaves' bounds, nothing is in any, none, or not all leaves have been seen.
PROVED, REFUTED, UNSOUND, PAUSED = range(4)


class Leaves(NamedTuple):
    """What the leaves of a tree have: see :class:`orbimpc_ros.mpc.proof.tree.ProofTree`.

    Attributes:
        point: shape (L, N, d).
        shor: shape (L, N).
        press_end: shape (L,).
        press_row: shape (P,).
        press: shape (P,).
        forces: multipliers that are vectors, one sort after another, shape (L, R, n).
    """

    point: Any
    shor: Any
    press_end: np.ndarray
    press_row: np.ndarray
    press: Any
    forces: Any


class Sections(NamedTuple):
    """Where each sort of multipliers begins among the forces of leaves; -1 where there are none."""

    pull: int
    slide: int
    tether: int
    share: int
    meet: int


class Walk(NamedTuple):
    """How far a walk through the M nodes of a tree is; new with zeros.

    Attributes:
        waiting: nodes to be seen, shape (M,).
        parent: of each node, shape (M,).
        counts: how many wait, and how many leaves have a bound, shape (2,).
        least: of their bounds, shape (1,).
    """

    waiting: Any
    parent: Any
    counts: Any
    least: Any


class Work(NamedTuple):
    """Arrays to be written.

    Attributes:
        flown: positions less s_0, velocities, and forces on both, shape (4, N + 1, n).
        slopes: shape (N, d).
        vectors: a normal, and what is left of a slope, shape (2, d or 3).
        matrix: shape (4, 4).
        squares: the Hessian of the cost, what is left of it, and the rows of an arrival,
            shape (2 N + 2, N).
        gone: which steps an arrival has eliminated, shape (N,).
    """

    flown: Any
    slopes: Any
    vectors: Any
    matrix: Any
    squares: Any
    gone: np.ndarray


@generic
def _turned(order, costs, start, point, slopes):
    """Add the slopes of what turns and the attitude cost; return that."""
    count, weight = len(point), costs.turned
    value = 0 * weight
    for c in range(point.shape[1]):
        for k in range(count + 1 - order if weight != 0 else 0):
            before = start[FIRST, c] if k == 0 else point[k - 1, c]
            turned = point[k, c] - before
            if order == 2:
                turned = point[k + 1, c] - 2 * point[k, c] + before
            value = value + weight * turned * turned
            push = 2 * weight * turned
            if order == 2:
                slopes[k + 1, c] = slopes[k + 1, c] + push
                slopes[k, c] = slopes[k, c] - 2 * push
                push = -push
            else:
                slopes[k, c] = slopes[k, c] + push
            if k > 0:
                slopes[k - 1, c] = slopes[k - 1, c] - push
        off = point[count - 1, c] - start[WANTED, c]
        value = value + costs.aimed * off * off
        slopes[count - 1, c] = slopes[count - 1, c] + 2 * costs.aimed * off
    return value


@generic
def _flown(costs, goals, point, shor, work):
    """Add forces of what positions cost, less a leaf's own curvature; return that, and its size."""
    flown, slopes, count, n = work.flown, work.slopes, len(point), goals.shape[1] - 1
    value, size = 0 * costs.turned, 0 * costs.turned
    for c in range(n):
        for k in range(count):
            z, weight = point[k, c], costs.weights[0, k + 1]
            miss, kept = flown[0, k + 1, c] - goals[k, c], shor[k] * z * z / 2
            value = value + weight * miss * miss - kept
            size = size + weight * miss * miss + abs(kept)
            flown[2, k + 1, c] = flown[2, k + 1, c] + 2 * weight * miss
            slopes[k, c] = slopes[k, c] - shor[k] * z
        fast = flown[1, count, c]
        value, size = value + costs.braked * fast * fast, size + costs.braked * fast * fast
        flown[3, count, c] = flown[3, count, c] + 2 * costs.braked * fast
    return value, size


@generic
def _least_decided(n, decided, known, g, length, shor, slowest, fastest):
    """Return the least of a step, and its size, where a rate decides R_1, but for its length."""
    size, speed, along = abs(length) + abs(shor), size_of(known, n), 0 * length
    for c in range(len(g)):
        along, size = along + g[c] * known[c], size + abs(g[c] * known[c])
    if decided != SEGMENT:
        return along + length * speed + shor * speed * speed / 2, size * (1 + speed * speed)
    return over_speeds(along / speed + length, shor, slowest, fastest), 2 * size


@generic
def _of_step(sets, known, corners, k, g, share, shor, length, work):
    """Return the least that a step adds to a bound, and the size of its terms.

    Where a share of the slope is held by the limits on R e1 alone, that and the rest are least
    each for itself.

    Args:
        sets: what stage sets are made of.
        known: of all choices.
        corners: of the step's patch.
        k: the step, from 0 on.
        g: its slope, shape (d,).
        share: shape (n,).
        shor: its own curvature.
        length: weight of that.
        work: arrays to be written.
    """
    n, rest, size, split = len(share), work.vectors[1], abs(length) + abs(shor), len(g) == 9
    for c in range(len(g)):
        size = size + abs(g[c])
        rest[c] = g[c]
    for c in range(n):
        split = split or share[c] != 0
    if not split:
        return over_stage(sets, known, corners, k, g[:n], length, shor, n), size
    for c in range(n):
        rest[c] = g[c] - share[c]
        g[c] = share[c]
        size = size + 2 * abs(share[c])
    if len(g) == 9:
        value = over_orbitope(rest, work.matrix)
    else:
        value = over_stage(sets, known, corners, k, rest[:n], 0 * length, 0 * shor, n)
    return value + over_stage(sets, known, corners, k, g[:n], length, shor, n), size


@generic
def _at_point(stated, leaves, leaf, empty, work):
    """Set slopes and forces of the cost at a leaf's point; return the cost, and its size."""
    start, costs, zero = stated.start, stated.costs, 0 * stated.sets.full
    point = leaves.point[leaf]
    rolled(stated.motion, start, point, work.flown)
    work.flown[2:] = zero
    work.slopes[:] = zero
    if empty:
        return zero, zero
    value = _turned(stated.order, costs, start, point, work.slopes)
    more, terms = _flown(costs, stated.ends.goals, point, leaves.shor[leaf], work)
    first = costs.weights[1, 0] * size_of(start[FIRST], stated.n)
    return value + more + first, value + terms + first


@generic
def _held(stated, region, depth, leaves, sections, leaf, work):
    """Add forces of a leaf's multipliers; return what they come to, its size, and if they hold."""
    ends, count, n = stated.ends, len(work.slopes), stated.n
    point, forces = leaves.point[leaf], leaves.forces[leaf]
    begun = leaves.press_end[leaf - 1] if leaf > 0 else 0
    value = size = 0 * stated.sets.full
    held = 0 <= begun <= leaves.press_end[leaf] <= len(leaves.press)
    if held and begun < leaves.press_end[leaf]:
        known = stated.motion, stated.sets, stated.bodies, region, depth
        value, size, held = pressed(*known, leaves, begun, leaf, work)
    if sections.tether >= 0:
        tether, tied = forces[sections.tether :], stated.start[-1]
        more, terms, sound = towed(ends, tether[:count], point, tied, work.slopes)
        value, size, held = value + more, size + terms, held and sound
    if sections.slide >= 0 and n == 3:
        more, terms, sound = slid(ends, forces[sections.slide :][:count], work.flown)
        value, size, held = value + more, size + terms, held and sound
    if sections.pull >= 0 or sections.meet >= 0:
        more, terms = with_ends(ends, forces, sections.pull, sections.meet, work.flown)
        value, size = value + more, size + terms
    return value, size, held


@generic
def leaf_bound(stated, region, depth, leaves, sections, leaf, empty, work):
    """Return what a leaf proves, and whether its multipliers are sound.

    Args:
        stated: the problem.
        region: what is known of choices from the root to the leaf.
        depth: of the leaf.
        leaves: of the tree.
        sections: of their forces.
        leaf: its row.
        empty: whether nothing costs anything: what holds alone has to come to more than nothing.
        work: arrays to be written; the Hessian is there.
    """
    point, shor, slopes, n = leaves.point[leaf], leaves.shor[leaf], work.slopes, stated.n
    count, zero, sets = len(point), 0 * stated.sets.full, stated.sets
    span, corners = region.span[depth], region.corners[depth]
    known = region.part[depth], span, count
    value, size = _at_point(stated, leaves, leaf, empty, work)
    more, terms, held = _held(stated, region, depth, leaves, sections, leaf, work)
    if not held:
        return value, False
    pulled_back(stated.motion, work.flown, slopes)
    value, size = value + more, size + terms
    for k in range(count):
        for c in range(stated.width):
            along = slopes[k, c] * point[k, c]
            value, size = value - along, size + abs(along)
    if not empty:
        convex, off = lost(stated.motion, stated.ends, shor, point, work)
        value = value - off
        if not convex:
            return value, False
    share = work.vectors[0, :n]
    for k in range(count):
        kept, length = (zero, zero) if empty else (shor[k], stated.costs.weights[1, k + 1])
        if k == 0 and stated.decided != FREE:
            slow, fast, decided = span[count, 0], span[count, 1], stated.start[DECIDED]
            more, terms = _least_decided(
                n, stated.decided, decided, slopes[0], length, kept, slow, fast
            )
        else:
            for c in range(n):
                share[c] = zero
                if sections.share >= 0:
                    share[c] = leaves.forces[leaf, sections.share + k, c]
            patch = corners[k if n == 3 else 0]
            more, terms = _of_step(sets, known, patch, k, slopes[k], share, kept, length, work)
        value, size = value + more, size + terms
    return value - slack(size) * (count + 4), True


@generic
def tree_bound(
    stated, allowed, order, nodes, at, leaves, sections, depth, region, work, walk, most
):
    """Return the least bound of a tree's leaves, how many have one, and what that comes to.

    A walk through the tree may pause: another call with the same arguments takes it on.

    Args:
        stated: the problem.
        allowed: which splits there are.
        order: of steps.
        nodes: of the tree, whose arrays fit the problem, shape (M, 5).
        at: where nodes are cut, shape (M,).
        leaves: of the tree.
        sections: of their forces.
        depth: of nodes, set by :func:`depths_of`, shape (M,).
        region: to be written, a row for each depth.
        work: to be written.
        walk: how far it is through the tree.
        most: leaves after which it pauses.

    Returns:
        The least; how many leaves have one; ``PROVED``, ``REFUTED``, ``UNSOUND`` or ``PAUSED``.
    """
    root, sets, waiting, parent = stated.root, stated.sets, walk.waiting, walk.parent
    least, number, found = walk.least[0], walk.counts[0], walk.counts[1]
    radii, seen = stated.bodies.extents[:, 2 * stated.n], 0
    if number == 0:
        known = begin(root, sets, allowed.is_free, order, region.part[0], region.span[0])
        if known != HELD:
            return least, 0, REFUTED if known == GONE else UNSOUND
        if is_bent(leaves.shor):  # else no leaf's curvature has to be weighed against it
            set_hessian(stated.order, stated.motion, stated.costs, work.squares)
        number, waiting[0] = 1, 0
    while number > 0:
        if seen == most:
            walk.least[0], walk.counts[0], walk.counts[1] = least, number, found
            return least, found, PAUSED
        number -= 1
        t = waiting[number]
        d, node = depth[t], nodes[t]
        if t > 0:
            above = parent[t]
            i, whole = t - nodes[above, CHILD], nodes[above]
            known = part_of(allowed, root, sets, radii, order, whole, at[above], i, d, region)
            if known == GONE:
                continue
            if known != HELD:
                return least, 0, UNSOUND
        if node[KIND] != LEAF and node[KIND] != EMPTY:
            for i in range(node[CHILDREN]):
                waiting[number], parent[node[CHILD] + i] = node[CHILD] + i, t
                number += 1
            continue
        empty, seen = node[KIND] == EMPTY, seen + 1
        if not 0 <= node[ROW] < len(leaves.point):
            return least, 0, UNSOUND
        value, sound = leaf_bound(stated, region, d, leaves, sections, node[ROW], empty, work)
        if not sound or not abs(value) >= 0 or (empty and not value > 0):
            return least, 0, UNSOUND
        if not empty:
            least = value if found == 0 else min(least, value)
            found += 1
    return least, found, PROVED if found > 0 else REFUTED


@generic
def depths_of(nodes, depth):
    """Set the depth of each node, -1 of those that the root does not lead to.

    Args:
        nodes: of a tree, shape (M, 5).
        depth: to be set, shape (M,).

    Returns:
        The greatest; -1 where children are missing, doubled, or not after their parents.
    """
    count, most = len(nodes), 0
    depth[:] = -1
    depth[0] = 0
    for t in range(count):
        if depth[t] < 0 or nodes[t, KIND] == LEAF or nodes[t, KIND] == EMPTY:
            continue
        first, parts = nodes[t, CHILD], nodes[t, CHILDREN]
        if parts < 1 or first <= t or parts > count or first > count - parts:
            return -1
        for child in range(first, first + parts):
            if depth[child] >= 0:
                return -1
            depth[child] = depth[t] + 1
        most = max(most, depth[t] + 1)
    return most


# --- what a bound is worked out of


def parts_of(stated: Stated, tree: Any) -> tuple:
    """Return a tree as its bound takes it."""
    capped = max(0, len(stated.root.patches) - ICOSAHEDRON)
    solid = len(stated.sets.faces)
    count = tree.point.shape[1]
    allowed = Allowed(stated.n, count, stated.decided == FREE, solid, capped)
    sorts = tree.pull, tree.slide, tree.tether, tree.share, tree.meet[:, None]
    begins, number = [], 0
    for each in sorts:
        begins.append(number if each.size else -1)
        number += each.shape[1] if each.size else 0
    known = [each for each in sorts if each.size]
    forces = tree.point[:, :0, : stated.n]
    if known:
        forces = known[0] if len(known) == 1 else np.concatenate(known, axis=1)
    rows = tree.press_end, tree.press_row, tree.press
    leaves = Leaves(tree.point, tree.shor, *rows, np.ascontiguousarray(forces))
    return (
        allowed,
        Order(tree.ordered, tree.origins),
        tree.nodes,
        tree.at,
        leaves,
        Sections(*begins),
    )


def walk_of(tree: ProofTree, kind: Any) -> Walk:
    """Return how far a walk through a tree is before it begins."""
    count = len(tree.nodes)
    waiting, parent = np.zeros(count, np.int64), np.zeros(count, np.int64)
    return Walk(waiting, parent, np.zeros(2, np.int64), np.zeros(1, kind))


def work_of(problem: Problem, width: int, kind: Any) -> Work:
    """Return arrays for the bounds of leaves to be worked out in."""
    count, n = problem.horizon, problem.dimension
    flown, slopes = np.zeros((4, count + 1, n), kind), np.zeros((count, width), kind)
    squares = np.zeros((2 * count + 2, count), kind)
    vectors, matrix = np.zeros((2, width), kind), np.zeros((4, 4), kind)
    return Work(flown, slopes, vectors, matrix, squares, np.zeros(count, np.bool_))
