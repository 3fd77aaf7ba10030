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


STAYS = round(STAY / 0.5) * (0.1,)


@pytest.mark.parametrize(
    ('places', 'step', 'events'),
    [
        ((-1.0, 1.0), 0.5, (True, False)),  # passed in between
        ((-1.0, -0.3), 0.5, (False, False)),
        ((-1.0, 1.0), 2.0 * PATIENCE, (False, False)),  # measured too seldom to know
        ((0.1, 0.1), 2.0 * PATIENCE, (True, False)),
        (STAYS, 0.5, (True, False)),
        ((*STAYS, 0.1), 0.5, (True, True)),  # it stays
        ((*STAYS, 0.1, 0.3), 0.5, (True, False)),
    ],
)
def test_what_is_passed_is_caught_and_where_it_stays_is_reached(places, step, events):
    assert seen(Events(), *places, step=step) == events


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
