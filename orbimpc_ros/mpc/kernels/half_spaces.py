# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Branch and bound over half-spaces on positions and thrust axes, for rotations in conv SO(3).

A *choice* is a group of places that must all be beyond one of a list of half-spaces: the sides of a
box for two consecutive positions, or the faces of a floor for a thrust axis. A node of the tree has
chosen for some groups, and its relaxation is solved by the method of multipliers
(:mod:`orbimpc_ros.mpc.kernels.augmented_lagrangian`), from its parent's multipliers. It is given up
as soon as its bound says so. Only what a solution misses is branched on.

Best first, but for *plunges*, which go on from a child at once until they reach a trajectory:
without one to beat, and now and then. The first plunge follows a guide, such as the previous plan,
through the sides that this passes on.

No trajectory costs more than a ceiling: a node whose bound is above that has no solution.

Mathematics: docs/mathematics.md, 4.10.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.augmented_lagrangian import minimise
from orbimpc_ros.mpc.kernels.best_first import DONE, FULL, cutoff_of, pop, push
from orbimpc_ros.mpc.kernels.penalty import BEST, PROVED, SETTLED, Iterate
from orbimpc_ros.mpc.kernels.penalty_terms import Multipliers, Terms

OPEN, MADE, NODES, NEXT, STALLS, PLUNGING = range(6)  # in SideTree.counts
VALUE, CLOSED, LEAST, PENDING, CEILING = range(5)  # in SideTree.numbers
PRECISION = 1e-7  # on constraints
SHARE = 0.2  # of the tolerance: the gap that a node may leave
LARGEST = 1e6  # of sigma, in its first values
MISSED = 4e-7  # a choice missed by more is branched on
EVERY = 64  # nodes from one plunge to the next
INERT = -1.0  # offset of a row that is always satisfied
UNREACHED = np.inf  # the bound of a child that cannot be


class Space(NamedTuple):
    """The quadratic, and where vehicles get to.

    Attributes:
        inverse: see :class:`orbimpc_ros.mpc.kernels.penalty_terms.Terms`, with all N positions.
        reach: what R_1 e1..R_N e1 add to s_1..s_N, shape (N, N).
        start: the minimiser of the quadratic, shape (N, 9).
        coasting: s_1..s_N less what R_1 e1..R_N e1 add, shape (N, 3).
        farthest: what these add at most, shape (N,).
        scale: of the forces at work, shape (1,).
    """

    inverse: Array
    reach: Array
    start: Array
    coasting: Array
    farthest: Array
    scale: Array


class Choices(NamedTuple):
    """What is to be chosen: one of some half-spaces n . v >= b for the places of each group.

    Places are counted from 0: R_1 e1..R_N e1, then s_1..s_N.

    Attributes:
        first: half-space of each group, shape (G,).
        sizes: how many half-spaces each group has, shape (G,).
        places: of each group, -1 for none, shape (G, 2).
        normals: of the half-spaces, shape (C, 3).
        offsets: shape (C,).
    """

    first: np.ndarray
    sizes: np.ndarray
    places: np.ndarray
    normals: Array
    offsets: Array


class SideTree(NamedTuple):
    """A search: its nodes, the multipliers of those that were branched on, the best point.

    Attributes:
        orbitopes: multipliers of the orbitopes, shape (S, N, 4, 4); the first are zero.
        held: those of the choices' rows, shape (S, G, 2).
        choice: the half-space of each group at a node, -1 for none, shape (K, G).
        parent: whose multipliers a node begins with, shape (K,).
        made: which node each solve was of, shape (S,).
        split: the group that it was branched on, -1 for none, shape (S,).
        bounds: what each solve has proved, shape (S,).
        lowest: where the Lagrangian is least by what proves that, shape (S, N, 9).
        pressed: multipliers of the choices' rows by which it is, shape (S, G, 2).
        keys: bounds of the open nodes, a heap, shape (K,).
        heap: their numbers, shape (K,).
        x: the solution of the last node, shape (N, 9).
        best: the best point found, shape (N, 9).
        counts: open nodes; nodes made; nodes solved; the node to go on with, -1 for none; nodes
            that could not be settled; whether a plunge is under way, shape (6,).
        numbers: the value to beat; the least bound given up; that of the whole search; that of the
            node to go on with; what no point exceeds, shape (5,).
    """

    orbitopes: Array
    held: Array
    choice: np.ndarray
    parent: np.ndarray
    made: np.ndarray
    split: np.ndarray
    bounds: Array
    lowest: Array
    pressed: Array
    keys: Array
    heap: np.ndarray
    x: Array
    best: Array
    counts: np.ndarray
    numbers: Array


def tree(steps: int, groups: int, nodes: int, most: int) -> SideTree:
    """Return room for a search; memory is handed out page by page, as it is first written to.

    Args:
        steps: N.
        groups: to be chosen for.
        nodes: that can be solved.
        most: children that a node can have.
    """
    made = 1 + nodes * most
    orbitopes, held = np.empty((nodes + 1, steps, 4, 4)), np.empty((nodes + 1, groups, 2))
    orbitopes[0], held[0] = 0.0, 0.0
    return SideTree(
        orbitopes,
        held,
        np.empty((made, groups), np.int32),
        np.empty(made, np.int64),
        np.zeros(nodes + 1, np.int64),
        np.empty(nodes + 1, np.int64),
        np.empty(nodes + 1),
        np.empty((nodes + 1, steps, 9)),
        np.empty((nodes + 1, groups, 2)),
        np.empty(made),
        np.empty(made, np.int64),
        np.zeros((steps, 9)),
        np.zeros((steps, 9)),
        np.zeros(6, np.int64),
        np.zeros(5),
    )


def begin(tree: SideTree, ceiling: float) -> None:
    """Begin a search.

    Args:
        tree: updated in place.
        ceiling: that no point's value exceeds.
    """
    counts, numbers = tree.counts, tree.numbers
    counts[:] = 0
    counts[OPEN], counts[MADE], counts[NEXT] = 1, 1, -1
    numbers[:] = np.inf, np.inf, -np.inf, np.inf, ceiling
    tree.choice[0], tree.parent[0] = -1, 0
    tree.keys[0], tree.heap[0] = -np.inf, 0


# --- the relaxation of a node


@compiled
def _is_double(choices, choice, g):
    """Return whether the group before has chosen the same for the first place of this one."""
    return (
        g > 0
        and choice[g - 1] == choice[g]
        and choices.places[g, 1] >= 0
        and choices.places[g - 1, 1] == choices.places[g, 0]
    )


@compiled
def _rows_on_positions(steps, choices, choice, g, i):
    """Return whether a place of a group adds a row on a position."""
    place = choices.places[g, i]
    return choice[g] >= 0 and place >= steps and not (i == 0 and _is_double(choices, choice, g))


@compiled
def _set_terms(space, choices, choice, stored, held):
    """Return what comes to the quadratic at a node, and set the multipliers of rows on headings.

    Args:
        space: gives the quadratic.
        choices: to be made.
        choice: of the node.
        stored: multipliers by group and place, shape (G, 2).
        held: its ``rows`` are set.
    """
    n, m = len(space.start), 0
    for g in range(len(choice)):
        for i in range(2):
            m += _rows_on_positions(n, choices, choice, g, i)
    rows, offsets = np.zeros((n, 3)), np.full(n, INERT)
    steps, sides, heights = np.empty(m, np.int64), np.empty((m, 3)), np.empty(m)
    at = 0
    for g in range(len(choice)):
        cell = choice[g]
        for i in range(2):
            place = choices.places[g, i]
            if cell < 0 or place < 0:
                continue
            if place < n:
                rows[place], offsets[place] = choices.normals[cell], choices.offsets[cell]
                held[place] = stored[g, i]
            elif _rows_on_positions(n, choices, choice, g, i):
                steps[at], sides[at] = place - n, choices.normals[cell]
                heights[at] = choices.offsets[cell] - (sides[at] * space.coasting[place - n]).sum()
                at += 1
    return Terms(
        space.inverse, np.zeros((2 * n, 9)), np.zeros(n), rows, offsets, False, space.reach, steps,
        sides, heights,
    )  # fmt: skip


@compiled
def _pick_up(steps, choices, choice, stored, held):
    """Set the multipliers of rows on positions; those of a place that is there twice add up."""
    at = 0
    for g in range(len(choice)):
        for i in range(2):
            if _rows_on_positions(steps, choices, choice, g, i):
                held[at] = stored[g, i]
                at += 1
            elif choice[g] >= 0 and i == 0 and _is_double(choices, choice, g):
                held[at - 1] += stored[g, i]


@compiled
def _put_down(steps, choices, choice, rows, sides, stored):
    """Store the multipliers of a node's rows, on headings and positions, by group and place."""
    at = 0
    for g in range(len(choice)):
        for i in range(2):
            stored[g, i] = 0.0
            place = choices.places[g, i]
            if _rows_on_positions(steps, choices, choice, g, i):
                stored[g, i] = sides[at]
                at += 1
            elif choice[g] >= 0 and 0 <= place < steps:
                stored[g, i] = rows[place]


@compiled
def _relax(space, choices, choice, tree, kept, limits, work, budget):
    """Solve a node from stored multipliers; store its own, to be kept if it is branched on.

    Returns:
        What becomes of it, its value and its bound.
    """
    n, own = len(space.start), tree.counts[NODES]
    rows = np.zeros(n)
    terms = _set_terms(space, choices, choice, tree.held[kept], rows)
    sides = np.zeros(len(terms.steps))
    _pick_up(n, choices, choice, tree.held[kept], sides)
    held = Multipliers(tree.orbitopes[kept].copy(), np.zeros((n, 3)), rows, np.zeros(1), sides)
    numbers = np.array([space.scale[0], -np.inf, np.inf])
    progress = Iterate(tree.x, np.zeros((n, 9)), numbers, np.zeros(2, np.int64))
    value, status = minimise(terms, space.start, held, limits, work, progress, budget)
    tree.orbitopes[own] = held.orbitopes
    _put_down(n, choices, choice, held.rows, held.sides, tree.held[own])
    if numbers[BEST] > tree.bounds[own]:
        tree.bounds[own], tree.lowest[own] = numbers[BEST], work.lowest
        _put_down(n, choices, choice, work.rows, work.sides, tree.pressed[own])
    return status, value, numbers[BEST]


# --- branching


@compiled
def _set_places(space, x, places):
    """Set R_1 e1..R_N e1 and s_1..s_N, shape (2N, 3), of a point."""
    n = len(x)
    for k in range(n):
        for c in range(3):
            places[k, c] = x[k, c]
            total = space.coasting[k, c]
            for j in range(n):
                total += space.reach[k, j] * x[j, c]
            places[n + k, c] = total


@compiled
def _short(choices, g, i, cell, places):
    """Return by how much the i-th place of a group misses a half-space; -inf without one."""
    place = choices.places[g, i]
    if place < 0:
        return -np.inf
    short = choices.offsets[cell]
    for c in range(3):
        short -= choices.normals[cell, c] * places[place, c]
    return short


@compiled
def _gain(space, choices, g, cell, places):
    """Return by how much a half-space raises the bound at least; inf where it is out of reach."""
    gain, n = 0.0, len(space.start)
    for i in range(2):
        short = _short(choices, g, i, cell, places)
        if short <= 0.0:
            continue
        place = choices.places[g, i]
        curvature = space.inverse[0, place, place]
        if curvature > 0.0:  # not where the state decides
            gain = max(gain, 0.5 * short * short / curvature)
        if place >= n:
            left = choices.offsets[cell] - space.farthest[place - n]
            for c in range(3):
                left -= choices.normals[cell, c] * space.coasting[place - n, c]
            if left > PRECISION:
                return UNREACHED
    return gain


@compiled
def _branching(space, choices, choice, places):
    """Return the group to branch on, -1 if none is missed: the one that raises the bound most."""
    chosen, most = -1, -1.0
    for g in range(len(choice)):
        if choice[g] >= 0:
            continue
        missed = promise = np.inf
        for cell in range(choices.first[g], choices.first[g] + choices.sizes[g]):
            short = max(_short(choices, g, 0, cell, places), _short(choices, g, 1, cell, places))
            missed = min(missed, short)
            if missed <= MISSED:
                break
            promise = min(promise, _gain(space, choices, g, cell, places))
        if missed > MISSED and promise > most:
            chosen, most = g, promise
    return chosen


@compiled
def _preferred(choices, guide, g, bounds):
    """Return which child a plunge goes on with: the guide's side, or that of the least bound."""
    if len(guide):
        near, nearest = np.inf, 0
        for i in range(len(bounds)):
            cell = choices.first[g] + i
            short = max(_short(choices, g, 0, cell, guide), _short(choices, g, 1, cell, guide))
            if short < near:
                near, nearest = short, i
        if bounds[nearest] < np.inf:
            return nearest
    return np.argmin(bounds)


@compiled
def _branch(space, choices, guide, tree, node, g, places, bound, cutoff, settled):
    """Open the children of a node; a plunge goes on with one of them.

    Where the node is not settled, its point shows where to branch, and not what that gains.
    """
    counts, numbers, first = tree.counts, tree.numbers, choices.first[g]
    tree.split[counts[NODES]] = g
    bounds = np.empty(choices.sizes[g])
    for i in range(len(bounds)):
        gain = _gain(space, choices, g, first + i, places)
        bounds[i] = bound + (gain if settled or gain == UNREACHED else 0.0)
        if bounds[i] >= cutoff:
            numbers[CLOSED] = min(numbers[CLOSED], bounds[i])
            bounds[i] = np.inf
    taken = _preferred(choices, guide, g, bounds) if counts[PLUNGING] else -1
    for i in np.argsort(-bounds):
        if bounds[i] == np.inf:
            continue
        made = counts[MADE]
        counts[MADE] += 1
        tree.choice[made] = tree.choice[node]
        tree.choice[made, g] = first + i
        tree.parent[made] = counts[NODES]
        if i == taken:
            counts[NEXT], numbers[PENDING] = made, bounds[i]
        else:
            push(tree.keys, tree.heap, counts[OPEN], bounds[i], made)
            counts[OPEN] += 1


# --- the search


@compiled
def _take(tree):
    """Return the node to solve next, and its bound."""
    counts, numbers = tree.counts, tree.numbers
    node, key = counts[NEXT], numbers[PENDING]
    if node < 0:
        node, key = tree.heap[0], tree.keys[0]
        pop(tree.keys, tree.heap, counts[OPEN])
        counts[OPEN] -= 1
        counts[PLUNGING] = numbers[VALUE] == np.inf or counts[NODES] % EVERY == EVERY - 1
    counts[NEXT], numbers[PENDING] = -1, np.inf
    counts[NODES] += 1
    tree.made[counts[NODES]], tree.split[counts[NODES]] = node, -1
    tree.bounds[counts[NODES]] = -np.inf
    return node, key


@compiled
def _solve(space, choices, guide, tree, limits, work, budget):
    """Solve a node, and branch on it or take its solution."""
    counts, numbers = tree.counts, tree.numbers
    node, key = _take(tree)
    cutoff = limits[5]
    choice, kept = tree.choice[node], tree.parent[node]
    status, value, bound = _relax(space, choices, choice, tree, kept, limits, work, budget)
    key = max(key, bound)
    if (
        status != SETTLED and status != PROVED and kept > 0
    ):  # what was held misled: once more without
        status, value, bound = _relax(space, choices, choice, tree, 0, limits, work, budget)
        key = max(key, bound)
    # A root that is not settled has children that may be.
    if (status == SETTLED or (status != PROVED and node == 0)) and key < cutoff:
        places = np.empty((2 * len(tree.x), 3))
        _set_places(space, tree.x, places)
        g = _branching(space, choices, choice, places)
        if g >= 0:
            settled = status == SETTLED
            _branch(space, choices, guide, tree, node, g, places, key, cutoff, settled)
            return
        if status == SETTLED and value < numbers[VALUE]:
            numbers[VALUE], tree.best[:] = value, tree.x
    numbers[CLOSED] = min(numbers[CLOSED], key)
    counts[STALLS] += status != SETTLED and status != PROVED


@compiled
def _cutoff(numbers, constant, tolerance):
    """Return the bound from which on a node cannot improve on the best point by enough."""
    if numbers[VALUE] == np.inf:
        return numbers[CEILING]
    return cutoff_of(numbers[VALUE], constant, tolerance)


@compiled
def search(space, choices, guide, known, tolerance, tree, work, room, budget):
    """Search on from where the tree is, until it is complete or as many nodes are solved as may be.

    Args:
        space: the quadratic.
        choices: to be made.
        guide: places of a point for the first plunge, shape (2N, 3), or (0, 3) for none.
        known: what values lack, and what rounding may make of them.
        tolerance: relative gap at which to stop.
        tree: begun by :func:`begin`; updated in place.
        work: room to work in.
        room: nodes to solve in all, at most; no more than the tree has room for.
        budget: multiplications that a node may take.

    Returns:
        ``DONE``; or ``FULL``, where there is no room for more nodes.
    """
    counts, numbers = tree.counts, tree.numbers
    status = DONE
    while counts[OPEN] > 0 or counts[NEXT] >= 0:
        cutoff = _cutoff(numbers, known[0], tolerance)
        if counts[NEXT] >= 0 and numbers[PENDING] >= cutoff:
            numbers[CLOSED] = min(numbers[CLOSED], numbers[PENDING])
            counts[NEXT], numbers[PENDING] = -1, np.inf
            continue
        if counts[NEXT] < 0 and tree.keys[0] >= cutoff:
            break
        if counts[NODES] >= room:
            status = FULL
            break
        largest = LARGEST * space.scale[0]
        limits = (PRECISION, SHARE * tolerance, known[0], known[1], largest, cutoff)
        _solve(space, choices, guide, tree, limits, work, budget)
    least = min(numbers[CLOSED], numbers[VALUE], numbers[PENDING])
    numbers[LEAST] = min(least, tree.keys[0]) if counts[OPEN] > 0 else least
    return status
