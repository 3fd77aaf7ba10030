"""Contact with boxes on the way from one place to another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Box


def touched(boxes: Sequence[Box], start: Array, end: Array) -> frozenset[int]:
    """Return the numbers of the boxes whose inside a straight way leads through.

    Args:
        boxes: counted from 0.
        start: of the way, shape (n,) [m].
        end: of the way, shape (n,) [m].
    """
    return frozenset(k for k, box in enumerate(boxes) if _crosses(box, start, end))


def _crosses(box: Box, start: Array, end: Array) -> bool:
    """Return whether a way is between both faces of every axis at one and the same time."""
    way = end - start
    moves = way != 0.0
    if not ((box.minimum < start) & (start < box.maximum))[~moves].all():
        return False
    shares = np.array([box.minimum - start, box.maximum - start])[:, moves] / way[moves]
    begin, finish = shares.min(axis=0).max(initial=0.0), shares.max(axis=0).min(initial=1.0)
    return bool(begin < finish or not moves.any())
