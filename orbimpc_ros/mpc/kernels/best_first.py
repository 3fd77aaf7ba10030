# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The order of a best-first search: a heap of the bounds of its open nodes.

Mathematics: docs/mathematics.md, 4.3.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import compiled

DONE, FULL, PAUSED = range(3)  # what a search ends with
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
def push(keys, heap, count, key, node):
    """Put a node into a heap of ``count``; of equal bounds the latest, the deepest, comes first.

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
