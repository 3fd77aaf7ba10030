# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planning problem: weights, floor, obstacles, approach and state."""

from orbimpc_ros.mpc.problem.floor import Floor
from orbimpc_ros.mpc.problem.obstacle import MAX_HAZARDS, Ball, Box, MovingObstacle
from orbimpc_ros.mpc.problem.problem import (
    MAX_HORIZON,
    TERMINALS,
    Approach,
    Problem,
    State,
    Weights,
)

__all__ = [
    'MAX_HAZARDS',
    'MAX_HORIZON',
    'TERMINALS',
    'Approach',
    'Ball',
    'Box',
    'Floor',
    'MovingObstacle',
    'Problem',
    'State',
    'Weights',
]
