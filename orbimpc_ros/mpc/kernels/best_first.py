# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Best-first search: a heap of open nodes, and what trees of every kind have in common.

A tree is a tuple with the fields below. A node begins with its parent's active set, and ends with
its own, so that it can be interrupted after any row, and continued.

- ``rows``, ``normals``, ``offsets``, ``u``: the active sets of the nodes solved, and for the root
  an empty one, each of ``active`` rows;
- ``parent``: whose active set a node begins with;
- ``keys``, ``heap``: bounds and numbers of the open nodes, of equal bounds the latest, the deepest,
  first;
- ``best``: the best point found;
- ``counts``, ``numbers``: see the names of their entries.

What is called at every node takes the few arrays that it needs: to pass a tree costs time.

Mathematics: docs/mathematics.md, 4.3 and 5.4.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import compiled

DONE, FULL, PAUSED, OPENED, RESUMED = range(5)  # what comes next in a search
GOING, SOLVED, PRUNED, STALLED = range(4)  # what becomes of a node
NODE = 300.0  # multiplications that a node costs besides those of its rows
# Of counts: open nodes; nodes made; nodes solved; the node at work, -1 for none; rows added to it;
# nodes that could not be settled; rows active in it; local searches.
OPEN, MADE, NODES, CURRENT, ROWS_ADDED, STALLS, ACTIVE, STARTS = range(8)
# Of numbers: the value to beat; the least bound given up; the bound of the node at work; that of
# the whole search.
VALUE, CLOSED, BOUND, LEAST = range(4)


def begin(tree, known):
    """Begin a search at its root, node 0; to pass a tree to machine code would take longer.

    Args:
        tree: updated in place.
        known: a value that is to be undercut, inf for none.
    """
    counts, numbers = tree.counts, tree.numbers
    counts[:] = 0
    counts[OPEN], counts[MADE], counts[CURRENT] = 1, 1, -1
    numbers[:] = known, np.inf, -np.inf, -np.inf
    tree.parent[0] = 0
    tree.keys[0], tree.heap[0] = -np.inf, 0


@compiled
def cutoff_of(value, constant, tolerance):
    """Return the bound from which on nodes are of no use.

    Args:
        value: the one to beat.
        constant: what values lack; it only scales the tolerance.
        tolerance: relative gap at which to stop.
    """
    return value - tolerance * max(abs(value + constant), 1e-9)


@compiled
def advance(tree, cutoff, room, work):
    """Return what comes next, and make the most promising open node the current one where it does.

    Args:
        tree: updated in place.
        cutoff: bound from which on nodes are of no use.
        room: nodes to solve in all, at most.
        work: multiplications left.

    Returns:
        ``RESUMED``, where a node is at work; ``OPENED``, where another has come to be; ``DONE``;
        ``FULL``, where all nodes that there is room for are solved; ``PAUSED``, where the work has
        run out.
    """
    counts = tree.counts
    if counts[CURRENT] >= 0:
        return RESUMED
    if counts[OPEN] == 0 or tree.keys[0] >= cutoff:
        return DONE
    if counts[NODES] >= room:
        return FULL
    if work <= 0.0:
        return PAUSED
    tree.numbers[BOUND], counts[CURRENT] = tree.keys[0], tree.heap[0]
    pop(tree.keys, tree.heap, counts[OPEN])
    counts[OPEN] -= 1
    counts[NODES] += 1
    counts[ROWS_ADDED] = 0
    _inherit(tree, counts[NODES], tree.parent[counts[CURRENT]])
    return OPENED


@compiled
def _inherit(tree, own, from_):
    """Copy the active set that a node begins with."""
    count = tree.active[from_]
    for i in range(count):
        tree.rows[own, i], tree.u[own, i] = tree.rows[from_, i], tree.u[from_, i]
        tree.normals[own, i, 0] = tree.normals[from_, i, 0]
        tree.normals[own, i, 1] = tree.normals[from_, i, 1]
        tree.offsets[own, i] = tree.offsets[from_, i]
    tree.counts[ACTIVE] = count


@compiled
def worked(counts, numbers, active, status, bound, count):
    """Note what work on the current node has led to, which ends unless it is still ``GOING``.

    Args:
        counts: of its tree, updated in place.
        numbers: of its tree, updated in place.
        active: of its tree, updated in place.
        status: what becomes of the node.
        bound: proved of it.
        count: its active rows.
    """
    numbers[BOUND] = max(numbers[BOUND], bound)
    counts[ACTIVE] = active[counts[NODES]] = count
    if status == GOING:
        return
    counts[CURRENT] = -1
    counts[STALLS] += status == STALLED


@compiled
def close(numbers, bound):
    """Give a node up, or a child that is not even made.

    Args:
        numbers: of its tree, updated in place.
        bound: that it has.
    """
    numbers[CLOSED] = min(numbers[CLOSED], bound)


@compiled
def keep(tree, key):
    """Keep the child that is next in the tables of nodes open: one of the node solved last.

    Args:
        tree: updated in place.
        key: bound of the child.
    """
    counts = tree.counts
    tree.parent[counts[MADE]] = counts[NODES]
    push(tree.keys, tree.heap, counts[OPEN], key, counts[MADE])
    counts[OPEN] += 1
    counts[MADE] += 1


@compiled
def set_least(tree):
    """Set the bound of the whole search: the least of what is open, closed or known."""
    counts, numbers = tree.counts, tree.numbers
    least = min(numbers[CLOSED], numbers[VALUE])
    if counts[CURRENT] >= 0:
        least = min(least, numbers[BOUND])
    numbers[LEAST] = min(least, tree.keys[0]) if counts[OPEN] > 0 else least


@compiled
def push(keys, heap, count, key, node):
    """Put a node into a heap of ``count``.

    Args:
        keys: bounds, shape (M,).
        heap: numbers of nodes, shape (M,).
        count: nodes in the heap.
        key: bound of the new one.
        node: its number.
    """
    i = count
    while i > 0:
        up = (i - 1) // 2
        if keys[up] < key or (keys[up] == key and heap[up] > node):
            break
        keys[i], heap[i] = keys[up], heap[up]
        i = up
    keys[i], heap[i] = key, node


@compiled
def pop(keys, heap, count):
    """Take the first node out of a heap of ``count``; see :func:`push`."""
    count -= 1
    key, node, i = keys[count], heap[count], 0
    while True:
        down = 2 * i + 1
        if down >= count:
            break
        other = down + 1
        if other < count and (
            keys[other] < keys[down] or (keys[other] == keys[down] and heap[other] > heap[down])
        ):
            down = other
        if key < keys[down] or (key == keys[down] and node > heap[down]):
            break
        keys[i], heap[i] = keys[down], heap[down]
        i = down
    keys[i], heap[i] = key, node
