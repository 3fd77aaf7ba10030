# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bodies on tracks: the hazard that one is, seen from a moment on."""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Ball, Box, Hazard

SOON = 1e-6  # [s] a point of a track that is due sooner adds nothing to it


def centre(body: Box | Ball) -> Array:
    """Return the middle of a body, shape (n,) [m]."""
    if isinstance(body, Ball):
        return body.centre
    return np.asarray(0.5 * (body.minimum + body.maximum))


def placed(body: Box | Ball, at: Array) -> Box | Ball:
    """Return a body with its middle at a position, shape (n,) [m]."""
    if isinstance(body, Ball):
        return Ball(at, body.radius)
    way = at - centre(body)
    return Box(body.minimum + way, body.maximum + way)


def position(times: Array, positions: Array, at: float) -> Array:
    """Return where a track is at a time [s], shape (n,) [m]; beyond its ends it goes straight on.

    Args:
        times: of the track, increasing, shape (K,) [s].
        positions: shape (K, n) [m].
        at: the time [s].
    """
    if len(times) == 1:
        return np.asarray(positions[0])
    leg = int(np.clip(np.searchsorted(times, at, side='right') - 1, 0, len(times) - 2))
    share = (at - times[leg]) / (times[leg + 1] - times[leg])
    return np.asarray(positions[leg] + share * (positions[leg + 1] - positions[leg]))


def along(body: Box | Ball, times: Array, positions: Array, at: float) -> Hazard:
    """Return the hazard that a body on a track is from a time on.

    Args:
        body: wherever it is.
        times: of the track, increasing, shape (K,) [s].
        positions: of the body's middle, shape (K, n) [m].
        at: when the hazard's own time begins [s].
    """
    start, later = position(times, positions, at), times > at + SOON
    ahead, points = times[later] - at, positions[later]
    if not len(ahead):
        ahead, points = np.array([1.0]), position(times, positions, at + 1.0)[None]
    shifts = np.concatenate([np.zeros((1, len(start))), points - start])
    return Hazard(placed(body, start), np.concatenate([[0.0], ahead]), shifts)
