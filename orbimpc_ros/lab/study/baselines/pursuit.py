# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Pure pursuit: straight towards where the goal will be, as fast as need be."""

from __future__ import annotations

import numpy as np

from orbimpc_ros.lab.study.baselines.baseline import Baseline
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import State


class Pursuit(Baseline):
    """Steers to where the goal will be at the end of the first step that a command can change.

    The next step is flown as decided a tick ago. So the vehicle will be at s_1, and heads for g_2
    from there: at the speed that takes it there in time, within the floor and full speed. The plan
    holds that course.
    """

    def axes(self, state: State, goals: Array) -> Array:
        """Return the axis towards the goal, shape (N, 2), N times the same."""
        step = self.problem.step * self.problem.forward
        away = goals[min(1, len(goals) - 1)] - state.position - step * state.rotation[:, 0]
        if not np.any(away):
            return self.shifted(state)
        return np.tile(away / step, (self.problem.horizon, 1))
