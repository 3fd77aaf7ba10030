# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""When a goal counts as caught or reached, and which goal is a new one."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from orbimpc_ros.loop.capture import STAY, Events
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.problem import Approach

RADIUS, PATIENCE = 0.2, 1.5


def at(time, x, turned=0.0):
    cosine, sine = np.cos(turned), np.sin(turned)
    attitude = np.array([[cosine, -sine], [sine, cosine]])
    return Odometry(time, np.array([x, 0.0]), attitude, np.zeros(2), np.zeros(1))


def seen(events, *places, goal=(0.0, 0.0), step=0.5, **given):
    """Return what is told after measurements at places x, one a step."""
    for k, x in enumerate(places):
        events.note(at(step * k, x), np.array(goal), RADIUS, PATIENCE, **given)
    return events.caught, events.arrived


def test_what_is_passed_in_between_is_caught_and_not_reached():
    assert seen(Events(), -1.0, 1.0) == (True, False)
    assert seen(Events(), -1.0, -0.3) == (False, False)


def test_nothing_is_known_between_measurements_that_are_far_apart():
    assert seen(Events(), -1.0, 1.0, step=2.0 * PATIENCE) == (False, False)
    assert seen(Events(), 0.1, 0.1, step=2.0 * PATIENCE) == (True, False)


def test_it_is_reached_by_who_stays_as_long_as_they_stay():
    steps = round(STAY / 0.5)
    assert seen(Events(), *(0.1 for _ in range(steps))) == (True, False)
    assert seen(Events(), *(0.1 for _ in range(steps + 1))) == (True, True)
    assert seen(Events(), *(0.1 for _ in range(steps + 1)), 0.3) == (True, False)


@pytest.mark.parametrize(('turned', 'caught'), [(0.0, True), (0.5, True), (0.7, False)])
def test_a_catch_is_within_the_cone_of_approach(turned, caught):
    events = Events()
    cone = Approach(0.6, (1.0, 0.0))
    for time, x in ((0.0, -1.0), (0.5, 1.0)):
        events.note(at(time, x, turned), np.zeros(2), RADIUS, PATIENCE, cone)
    assert events.caught == caught


@pytest.mark.parametrize(
    ('goals', 'streams', 'new'),
    [
        ([(1.0, 0.0), (2.0, 0.0)], False, True),  # by hand
        ([(1.0, 0.0), (1.0, 0.0)], False, False),  # the same, told again
        ([(1.0, 0.0), (1.1, 0.0), (1.2, 0.0)], True, False),  # it moves on
        ([(1.0, 0.0), (1.0, 0.0), (4.0, 0.0)], True, True),  # the next one, after one that stood
    ],
)
def test_which_goal_is_a_new_one(goals, streams, new):
    events = Events()
    for goal in goals[:-1]:
        events.send(np.array(goal), streams=streams)
    events.caught = True
    events.send(np.array(goals[-1]), streams=streams)
    assert events.caught != new
