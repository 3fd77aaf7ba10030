# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The order of a best-first search: a heap of the bounds of its open nodes.

A tree has ``keys``, the bounds of its open nodes, and ``heap``, the numbers of these, both of shape
(M,); and ``counts`` and ``numbers``, the first entries of which are named here.

Mathematics: docs/mathematics.md, 4.3.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import compiled

DONE, FULL, PAUSED = range(3)  # what a search ends with
MADE, OPEN, NODES = range(3)  # in counts: nodes that there are; that are open; that were solved
VALUE, CLOSED, LEAST = range(3)  # in numbers: best cost; least bound given up; of the search
NEGLIGIBLE = 1e-7  # of the unit of costs: the gap of smaller objectives is relative to it


@compiled
def cutoff_of(value, constant, tolerance):
    """Return the bound from which on nodes are of no use.

    Args:
        value: the one to beat.
        constant: what values lack; it only scales the tolerance.
        tolerance: relative gap at which to stop.
    """
    if value == np.inf:
        return value
    return value - tolerance * max(abs(value + constant), NEGLIGIBLE)


@compiled
def close(tree, key):
    """Note a bound that is not raised any more."""
    tree.numbers[CLOSED] = min(tree.numbers[CLOSED], key)


@compiled
def leave_open(tree, node, key, cutoff):
    """Leave a node open, unless its bound says that it is of no use.

    Of equal bounds the latest, the deepest, comes first.
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
    """Take out the open node of the least bound; see :func:`leave_open`."""
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
    """Return the least bound of the nodes that are open or were given up."""
    closed = tree.numbers[CLOSED]
    return min(closed, tree.keys[0]) if tree.counts[OPEN] > 0 else closed
