# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Vehicles whose ways cross, in lock-step without nodes: nobody comes closer than asked for."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

import crossings

from orbimpc_ros.mpc.command import stop
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.ros.planner.outputs import obeyed

SHORT = ('horizon=4', 'gap_tolerance=0.05', 'max_ticks=15')  # past the middle of the ring
RADIUS = 1.0
SEED = 5


def test_three_vehicles_keep_their_distance_in_the_middle_of_the_ring():
    values = crossings.setup(3, SEED, SHORT)
    flown = crossings.fly(values, crossings.Aboard(values))
    assert flown.apart >= RADIUS
    assert flown.apart <= RADIUS + 0.1  # and take no more room than they need
    assert not any(flown.fallbacks)


def test_without_plans_to_avoid_they_would_not():
    values = crossings.setup(3, SEED, (*SHORT, 'avoid=[]'))
    assert crossings.fly(values, crossings.Aboard(values)).apart < 0.9 * RADIUS


def test_who_has_no_plan_says_where_its_safe_command_leads():
    problem = Problem(horizon=3)
    state = State.at(np.array([1.0, 2.0]), 0.5 * np.eye(2), attitude=np.eye(2))
    flown = obeyed(problem, state, stop(np.eye(2)))
    # As the model has it, this step is still flown at the old speed.
    expected = [[1.0, 2.0], [1.5, 2.0], [1.5, 2.0], [1.5, 2.0]]
    np.testing.assert_allclose([place for place, _ in flown], expected)


def test_a_fleet_is_told_its_own_plans_alone():
    own = crossings.setup(3, SEED)
    assert {each['avoid'] for each in own.values()} == {('/uav1/plan', '/uav2/plan', '/uav3/plan')}
