# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Capture of the rope: the closest approach of two points that move straight during a step."""

from __future__ import annotations

import math

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Approach


def closest_approach(flown: tuple[Array, Array], swung: tuple[Array, Array]) -> tuple[float, float]:
    """Return the least distance [m] during a step and when, as a share of the step in [0, 1].

    Args:
        flown: the vehicle's positions at the ends of the step, each of shape (n,) [m].
        swung: the goal's.
    """
    apart = flown[0] - swung[0]
    drift = (flown[1] - swung[1]) - apart
    speed = float(drift @ drift)
    share = float(np.clip(-(apart @ drift) / speed, 0.0, 1.0)) if speed > 0.0 else 0.0
    nearest = apart + share * drift
    return math.sqrt(nearest @ nearest), share


def is_headed(approach: Approach, headings: tuple[Array, Array], share: float) -> bool:
    """Return whether a vehicle is within the cone of approach at some moment of a step.

    Args:
        approach: the cone, with its direction.
        headings: where its pushing axis points at the ends of the step, each of shape (n,).
        share: the moment, as a share of the step; headings turn evenly, but for half a turn.
    """
    if not approach.exists:
        return True
    heading = (1.0 - share) * headings[0] + share * headings[1]
    axis = np.array(approach.direction)
    along = float(heading @ axis) / math.hypot(*approach.direction)
    return along >= math.cos(approach.cone) * math.sqrt(heading @ heading)
