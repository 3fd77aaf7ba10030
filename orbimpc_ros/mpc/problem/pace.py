# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Limited changes of speed: the initial speed, and the speeds within reach.

Mathematics: docs/mathematics.md, 3.10.
"""

from __future__ import annotations

import math

from orbimpc_ros.mpc.problem.problem import Problem
from orbimpc_ros.mpc.problem.state import State

WITHIN = 1.0 - 1e-9  # share of the largest change, so that rounding does not exceed it


def entry_speed(problem: Problem, state: State) -> float:
    """Return the share of full speed that the first change starts from, in [0, 1].

    That is the last command, or |R_0 e1| without one, and at least the floor: a vehicle below its
    floor is commanded the least speed at once, since that keeps it in the air.
    """
    before = state.commanded
    if before is None:
        before = math.hypot(*state.rotation[:, 0].tolist())
    least = float(problem.floor.least(state.attitude[:, 0]))
    return min(1.0, max(before, least))


def first_change_is_decided(problem: Problem, state: State) -> bool:
    """Return True if the state decides |R_1 e1|: at rotation order 2 without ``coasted``."""
    return problem.rotation_order == 2 and state.coasted is None


def moved_towards(problem: Problem, before: float, wanted: float, steps: float = 1.0) -> float:
    """Return the share of full speed nearest to a wanted one among those within reach.

    Args:
        problem: gives the limit.
        before: initial share of full speed.
        wanted: share of full speed.
        steps: time available, in steps.
    """
    most = steps * problem.speed_change
    return max(before - most, min(before + most, wanted))
