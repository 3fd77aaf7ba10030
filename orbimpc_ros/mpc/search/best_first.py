# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The order of a best-first search: a heap of the bounds of its open nodes.

A tree has ``keys``, the bounds of its open nodes, and ``heap``, the indices of these, both of shape
(M,); and ``counts`` and ``numbers``, the first entries of which are named here.

Mathematics: docs/mathematics.md, 4.3.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import compiled

DONE, FULL, PAUSED, EMPTY = range(4)  # outcomes of a search; the last: of the root
MADE, OPEN, NODES = range(3)  # in counts: nodes created; nodes open; nodes solved
VALUE, CLOSED, LEAST = range(3)  # in numbers: incumbent's cost; least bound of closed nodes; bound
NEGLIGIBLE = 1e-7  # in units of cost: the gap of smaller objectives is relative to it


@compiled
def cutoff_of(value, constant, tolerance):
    """Return the bound from which on nodes are pruned.

    Args:
        value: cost of the incumbent.
        constant: omitted from costs; it only scales the tolerance.
        tolerance: relative gap at which to stop.
    """
    if value == np.inf:
        return value
    return value - tolerance * max(abs(value + constant), NEGLIGIBLE)


@compiled
def close(tree, key):
    """Record the bound of a node that is closed."""
    tree.numbers[CLOSED] = min(tree.numbers[CLOSED], key)


@compiled
def leave_open(tree, node, key, cutoff):
    """Add a node to the heap, or close it if its bound reaches the cutoff.

    Among equal bounds the latest node, the deepest one, comes first.
    """
    if key >= cutoff:
        close(tree, key)
        return
    keys, heap, i = tree.keys, tree.heap, tree.counts[OPEN]
    tree.counts[OPEN] += 1
    while i > 0:
        up = (i - 1) // 2
        if keys[up] < key or (keys[up] == key and heap[up] > node):
            break
        keys[i], heap[i] = keys[up], heap[up]
        i = up
    keys[i], heap[i] = key, node


@compiled
def take(tree):
    """Remove and return the open node of the least bound; see :func:`leave_open`."""
    tree.counts[OPEN] -= 1
    keys, heap, count = tree.keys, tree.heap, tree.counts[OPEN]
    first, key, node, i = heap[0], keys[count], heap[count], 0
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
    return first


@compiled
def least_left(tree):
    """Return the least bound of the open and closed nodes."""
    closed = tree.numbers[CLOSED]
    return min(closed, tree.keys[0]) if tree.counts[OPEN] > 0 else closed
