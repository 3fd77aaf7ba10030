"""Contact with boxes, and with bodies that move, on the way from one place to another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Ball, Box, Hazard
from orbimpc_ros.world.capture import closest_approach


def touched(boxes: Sequence[Box], start: Array, end: Array) -> frozenset[int]:
    """Return the numbers of the boxes whose inside a straight way leads through.

    Args:
        boxes: counted from 0.
        start: of the way, shape (n,) [m].
        end: of the way, shape (n,) [m].
    """
    return frozenset(k for k, box in enumerate(boxes) if _crosses(box, start, end))


def drifter(position: Array, velocity: Array, radius: float) -> Hazard:
    """Return a ball that moves evenly from a position [m] at the start, with a velocity [m/s]."""
    return Hazard.drifting(Ball(position, radius), velocity)


def met(
    traffic: Sequence[Hazard], flown: tuple[Array, Array], times: tuple[float, float]
) -> frozenset[int]:
    """Return the numbers of the balls that a straight way leads into while they move on evenly.

    Args:
        traffic: balls, counted from 0.
        flown: the ends of the way, each of shape (n,) [m].
        times: when the vehicle is there, since the start [s].
    """
    moments = np.array(times)
    found = set()
    for k, each in enumerate(traffic):
        assert isinstance(each.body, Ball)
        begin, end = each.body.centre + each.moved(moments)
        if closest_approach(flown, (begin, end))[0] < each.body.radius:
            found.add(k)
    return frozenset(found)


def _crosses(box: Box, start: Array, end: Array) -> bool:
    """Return whether a way is between both faces of every axis at one and the same time."""
    way = end - start
    moves = way != 0.0
    if not ((box.minimum < start) & (start < box.maximum))[~moves].all():
        return False
    shares = np.array([box.minimum - start, box.maximum - start])[:, moves] / way[moves]
    begin, finish = shares.min(axis=0).max(initial=0.0), shares.max(axis=0).min(initial=1.0)
    return bool(begin < finish or not moves.any())
