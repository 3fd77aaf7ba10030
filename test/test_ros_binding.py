# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Binding constraints, as the planner reports them on ``tick``."""

import json

import numpy as np
import pytest
from scenarios import retrieval
from stepping import Stepped

from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.ros.reports import Report, prices, tick_message
from orbimpc_ros.sim.vehicle import measured
from orbimpc_ros.sim.world import departure

pytest.importorskip('rclpy')


def far_away(problem):
    """Return a tick towards a goal far ahead: nothing but full speed is in the way."""
    odometry = measured(departure(retrieval()).vehicle)
    return Stepped(problem).tick(odometry, np.tile([99.0, 0.0], (problem.horizon, 1)))


def test_full_speed_binds_on_the_way_to_a_far_goal():
    assert list(prices(far_away(Problem()))) == ['hull@1', 'hull@2', 'hull@3', 'hull@4']


def test_longer_plans_than_can_be_priced_in_time_have_none():
    assert prices(far_away(Problem(horizon=61))) == {}


def test_a_plan_that_only_stands_in_has_no_prices():
    problem = Problem(horizon=5, terminal='constraint')
    controller = Stepped(problem)
    near, beyond = np.tile([4.0, 0.0], (5, 1)), np.tile([50.0, 0.0], (5, 1))
    odometry = measured(departure(retrieval()).vehicle)
    assert controller.tick(odometry, near).fallback == ''
    tick = controller.tick(odometry, beyond)
    assert tick.fallback
    assert prices(tick) == {}


def test_a_shrinking_horizon_is_priced_as_what_is_left_of_it():
    controller = Stepped(Problem(), shrinking=True)
    odometry = measured(departure(retrieval()).vehicle)
    for left in (5, 4, 3):
        tick = controller.tick(odometry, np.tile([99.0, 0.0], (left, 1)))
        assert list(prices(tick)) == [f'hull@{k}' for k in range(1, left)]


def test_a_tick_message_carries_the_prices_as_json():
    tick = far_away(Problem())
    report = Report(tick, binding=prices(tick))
    told = {pair.key: pair.value for pair in tick_message(0, 'planner', report).status[0].values}
    assert json.loads(told['binding']) == pytest.approx(prices(tick))
