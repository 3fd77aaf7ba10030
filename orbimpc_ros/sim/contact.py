# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Contact with boxes, and with bodies that move, on the way from one place to another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Ball, Box, Hazard


def touched(boxes: Sequence[Box], start: Array, end: Array, grazed: float = 0.0) -> frozenset[int]:
    """Return the numbers of the boxes whose inside a straight way leads through.

    Args:
        boxes: counted from 0.
        start: of the way, shape (n,) [m].
        end: of the way, shape (n,) [m].
        grazed: depth that does not count [m].
    """
    return frozenset(k for k, box in enumerate(boxes) if _crosses(box, start, end, grazed))


def drifter(position: Array, velocity: Array, radius: float) -> Hazard:
    """Return a ball that moves evenly from a position [m] at the start, with a velocity [m/s]."""
    return Hazard.drifting(Ball(position, radius), velocity)


def met(
    traffic: Sequence[Hazard],
    flown: tuple[Array, Array],
    times: tuple[float, float],
    grazed: float = 0.0,
) -> frozenset[int]:
    """Return the numbers of the balls that a straight way leads into while they move on evenly.

    Args:
        traffic: balls, counted from 0.
        flown: the ends of the way, each of shape (n,) [m].
        times: when the vehicle is there, since the start [s].
        grazed: depth that does not count [m].
    """
    if not traffic:
        return frozenset()
    places = np.array([_middle(each) for each in traffic])
    velocities = np.array([each.shifts[1] / each.times[1] for each in traffic])
    radii = np.array([each.body.radius for each in traffic if isinstance(each.body, Ball)])
    radii = np.maximum(0.0, radii - grazed)
    away = flown[0] - places - times[0] * velocities
    drift = flown[1] - flown[0] - (times[1] - times[0]) * velocities
    squared = np.einsum('ji,ji->j', drift, drift)
    share = -np.einsum('ji,ji->j', away, drift) / np.where(squared > 0.0, squared, 1.0)
    nearest = away + np.clip(share, 0.0, 1.0)[:, None] * drift
    return frozenset(np.flatnonzero(np.einsum('ji,ji->j', nearest, nearest) < radii**2).tolist())


def _middle(ball: Hazard) -> Array:
    assert isinstance(ball.body, Ball)
    return ball.body.centre


def _crosses(box: Box, start: Array, end: Array, grazed: float) -> bool:
    """Return whether a way is between both faces of every axis at one and the same time."""
    way, low, high = end - start, box.minimum + grazed, box.maximum - grazed
    moves = way != 0.0
    if not ((low < start) & (start < high))[~moves].all() or (low >= high).any():
        return False
    shares = np.array([low - start, high - start])[:, moves] / way[moves]
    begin, finish = shares.min(axis=0).max(initial=0.0), shares.max(axis=0).min(initial=1.0)
    return bool(begin < finish or not moves.any())
