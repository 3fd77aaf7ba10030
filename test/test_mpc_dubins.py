# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Catches against closed forms: minimum-time interception by a Dubins vehicle in wind.

The chases and their earliest ends are those of others (reference/interception.json): constant
airspeed, a tightest turn, a constant wind, a goal that moves straight on.
"""

import json
import math

import numpy as np
import pytest
from problems import REFERENCE, floor, needs_machine_code
from stepping import Stepped

from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Approach, Problem

CHASES = json.loads((REFERENCE / 'interception.json').read_text())['cases']
HEADED = [known for known in CHASES if known['prescribed']['time'] < 15.0]
NEAR = 0.1  # radius of a catch, a share of what is flown in a step


def catch(chase, step, horizon, approach=None, *, between=False):
    """The catch of a controller's first tick, at ends of steps or ``between`` them."""
    speed, start = chase['airspeed'], chase['start']
    problem = Problem(
        horizon=horizon, step=step, forward=speed, floor=floor('circle', 1.0),
        max_rate=speed / chase['turn_radius'], discretisation='exact',
    )  # fmt: skip
    known = {'disturbance': np.array(chase['wind']), 'velocity_source': 'air'}
    controller = Stepped(problem, capture_radius=NEAR * step * speed, approach=approach, **known)
    attitude, along = exp(np.array([start['heading']])), np.array([speed, 0.0])
    odometry = Odometry(0.0, np.array(start['position']), attitude, along, np.zeros(1))

    def ahead(times):
        moved = np.outer(times, chase['target']['velocity'])
        return np.array(chase['target']['position']) + moved

    goals = ahead(step * np.arange(1, horizon + 1))
    return controller.tick(odometry, goals, None, ahead if between else None).catch


@needs_machine_code
@pytest.mark.parametrize('chase', CHASES, ids=lambda chase: chase['free']['word'])
def test_the_earliest_catch_is_at_the_first_step_that_ends_after_the_closed_form(chase):
    time = chase['free']['time']
    step = next(step for step in (0.2, 0.4, 0.8) if time < 29.0 * step)
    found = catch(chase, step, 30)
    sooner = 2.0 * NEAR * step  # what a radius may save, should the goal go along
    assert time - sooner <= found.time <= time + 1.5 * step
    assert time - step <= found.bound <= found.time


@needs_machine_code
@pytest.mark.parametrize('chase', HEADED, ids=lambda chase: chase['prescribed']['word'])
def test_a_catch_in_a_cone_is_no_later_than_the_closed_form_of_its_axis(chase):
    step, given = 0.8, chase['prescribed']
    axis = (math.cos(given['heading']), math.sin(given['heading']))
    found = catch(chase, step, 20, Approach(0.2, axis))
    assert chase['free']['time'] - step <= found.bound <= found.time
    assert found.time <= given['time'] + 1.5 * step


@needs_machine_code
@pytest.mark.parametrize('number', range(3))
def test_a_catch_between_ends_of_steps_is_at_the_time_of_the_closed_form(number):
    """Within 2 %, where it is known where the goal is between the ends of steps."""
    short = [chase for chase in CHASES if chase['free']['time'] < 5.5]
    chase = short[number % len(short)]
    time, found = chase['free']['time'], catch(chase, 0.2, 30, between=True)
    assert time - 0.2 <= found.bound <= found.time
    assert found.time == pytest.approx(time, rel=0.02)
