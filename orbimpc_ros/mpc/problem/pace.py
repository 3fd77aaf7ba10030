# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Changes of speed where they are limited: from which speed on, and how far they get.

Mathematics: docs/mathematics.md, 3.10.
"""

from __future__ import annotations

import math

from orbimpc_ros.mpc.problem.problem import Problem
from orbimpc_ros.mpc.problem.state import State

WITHIN = 1.0 - 1e-9  # of the largest change, which rounding is not to exceed


def entry_speed(problem: Problem, state: State) -> float:
    """Return the share of full speed that the first change counts from, in [0, 1].

    What was commanded last, or else |R_0 e1|. A vehicle below its floor counts as at it: it is told
    to be at its least speed at once, for that is what keeps it in the air.
    """
    before = state.commanded
    if before is None:
        before = math.hypot(*state.rotation[:, 0].tolist())
    least = float(problem.floor.least(state.attitude[:, 0]))
    return min(1.0, max(before, least))


def first_change_is_decided(problem: Problem, state: State) -> bool:
    """Return whether the state decides |R_1 e1|, as at rotation order 2 without ``coasted``."""
    return problem.rotation_order == 2 and state.coasted is None


def moved_towards(problem: Problem, before: float, wanted: float, steps: float = 1.0) -> float:
    """Return the share of full speed nearest to a wanted one that a vehicle gets to from another.

    Args:
        problem: gives the limit.
        before: share of full speed that it sets out from.
        wanted: share of full speed.
        steps: time that it has, in steps.
    """
    most = steps * problem.speed_change
    return max(before - most, min(before + most, wanted))
