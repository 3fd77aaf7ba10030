# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The parameters of a catch within a cone of headings: the same for planner and simulator."""

from __future__ import annotations

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem.approach import WIDEST_APPROACH, Approach
from orbimpc_ros.ros.parameters.parameter import FAR, Row, Values, vector

APPROACH: tuple[Row, ...] = (
    Row('approach.cone', 0.0, 'A catch counts only with the pushing axis within this angle of '
        'approach.direction; 0 for any. Headings only: velocities have no part in it',
        'rad', 0.0, WIDEST_APPROACH, live=True),
    Row('approach.direction', (), 'Where to be headed at a catch, in the world frame: x, y, z; '
        "empty for the goal's own pushing axis, by its orientation", '', -FAR, FAR, live=True),
)  # fmt: skip


def approach_of(values: Values) -> Approach:
    """Return the cone of approach.

    Raises:
        BadInput: a direction of another dimension, or none at all.
    """
    if not len(values['approach.direction']):
        return Approach(values['approach.cone'])
    direction = vector(values, 'approach.direction', values['dimension'])
    if not direction.any():
        raise BadInput('approach.direction', direction.tolist(), 'empty, or not all of it 0')
    return Approach(values['approach.cone'], tuple(direction.tolist()))
