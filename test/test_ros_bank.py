# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The bank of goal models at work: from messages on ``goal`` to targets, and to ``tick``."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from planners import settings
from stepping import targets

from orbimpc_ros.loop.goal.motion import GoalObservation
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.planner.outputs import values
from orbimpc_ros.tool.offline import EPOCH, OfflinePlanner


class Watched:
    """A planner without its node, at rest, that watches a goal at 10 Hz."""

    def __init__(self, **changes):
        given = settings(step=0.1, horizon=5, **changes)
        self.planner, self.steps = OfflinePlanner(given), 0
        self.inputs = self.planner.inputs

    def watch(self, goal, ticks):
        """Watch a goal, shape (2,) [m] as a function of time [s]; return the last report."""
        still = Odometry(0.0, np.zeros(2), np.eye(2), np.zeros(2), np.zeros(1))
        for _ in range(ticks):
            self.steps += 1
            now = 0.1 * self.steps
            self.planner.sense(now, GoalObservation(now, np.array(goal(now))))
            self.planner.sense(now, still, now)
        return self.planner.report(now)

    def ahead(self):
        """The times of the targets of the last tick [s]."""
        return 0.1 * (self.steps + np.arange(1, 6))


def carried(time):
    return np.array([2.0 + 0.5 * time + np.sin(1.5 * time), 1.0 - 0.2 * time + np.cos(1.5 * time)])


def test_a_swing_on_a_moving_carrier_is_planned_for_and_named():
    watched = Watched(goal_prediction='auto')
    report = watched.watch(carried, 100)
    targets = np.array([carried(time) for time in watched.ahead()])
    np.testing.assert_allclose(report.goals, targets, atol=1e-3)
    assert values(report)['goal_model'] == 'carrier'


def test_another_forecast_begins_with_the_last_goal():
    watched = Watched()
    watched.watch(carried, 10)
    watched.inputs.adopt(settings(step=0.1, goal_prediction='auto'))
    assert watched.inputs.heard['goal_model'] != ''
    held = np.tile(carried(1.0), (5, 1))
    np.testing.assert_allclose(targets(watched.inputs, EPOCH / SECOND + watched.ahead(), 1.0), held)
    watched.inputs.forget()
    assert 'goal_model' not in watched.inputs.heard
