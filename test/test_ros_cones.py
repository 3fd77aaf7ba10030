# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Tilt and glide slope as parameters, what a planner says of them, and the lander's flight."""

import math

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2, or pip install orbimpc_ros[ros]')

from open_loop import open_loop
from stepping import Stepped

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.parameters import PLANNER, planner_settings
from orbimpc_ros.ros.planner.description import summary
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.sim.vehicle import measured
from orbimpc_ros.sim.world import departure
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.settings import config

CRAFT = {
    'dimension': 3,
    'translation_order': 2,
    'forward': 3.6,
    'gravity': 1.62,
    'tilt': 0.2618,
    'glide_slope': 0.8727,
}


def made(**changes):
    return planner_settings({**{row.name: row.default for row in PLANNER}, **CRAFT, **changes})


def said(**changes):
    return summary(made(**changes), simulated=False)


def test_both_cones_come_into_the_problem_and_may_change_in_flight():
    problem = made().problem
    assert (problem.tilt, problem.glide_slope) == (0.2618, 0.8727)
    rows = {row.name: row for row in PLANNER}
    for name in ('tilt', 'glide_slope'):
        assert rows[name].live
        assert rows[name].unit == 'rad'
        assert rows[name].descriptor.floating_point_range[0].to_value < 1.6


def test_what_they_cannot_be_is_refused_in_a_line():
    with pytest.raises(BadInput, match='tilt'):
        made(tilt=15.0)
    with pytest.raises(BadInput, match=r'glide_slope is 0\.8727; allowed: 0 when dimension is 2'):
        made(dimension=2, gravity=0.0, tilt=0.0)
    with pytest.raises(BadInput, match=r'tilt is 0\.2618; allowed: 0 at translation_order 1'):
        made(translation_order=1, gravity=0.0)
    with pytest.raises(BadInput, match='below the full thrust of forward'):
        made(gravity=3.7)


def test_the_start_up_line_says_what_they_allow():
    line = said()
    assert 'tilted by at most 15 deg' in line
    assert 'above a glide slope of 50 deg' in line
    assert 'to hold a goal takes' not in line
    assert 'takes a tilt of 20.32 deg: more than is allowed' in said(wind=(0.6, 0.0, 0.0))
    assert 'tilted' not in said(tilt=0.0)


def test_the_lander_lands_by_its_first_plan():
    values = settings.resolve(config('lander.yaml'))
    problem, scenario = planner_settings(values).problem, sim_settings(values).scenario
    found = open_loop(problem, scenario, 'thrust_aligned')
    assert found.plan.status == 'optimal'
    assert max(found.relaxed[:2]) < 1e-6
    assert max(found.flown[:2]) < 1e-3


def test_a_landing_keeps_its_limits_and_every_tick_is_bounded():
    """On the vehicle in continuous time with its lags; what a demo does over DDS."""
    values = settings.resolve(config('lander.yaml'))
    chosen, flight = planner_settings(values), departure(sim_settings(values).scenario)
    controller = Stepped(
        chosen.problem,
        shrinking=True,
        gap_tolerance=chosen.gap_tolerance,
        disturbance=chosen.disturbance,
        response=chosen.response,
    )
    ticks, vehicles = [], []
    while not flight.over:
        odometry = measured(flight.vehicle)
        goals = np.tile(flight.goal, (len(controller.ends(odometry.time)), 1))
        ticks.append(controller.tick(odometry, goals))
        command = ticks[-1].command
        flight = flight.after(command.speed_fraction, command.body_rate)
        vehicles += flight.trail
    assert flight.captured
    assert flight.distance < 0.1
    assert flight.speed < 0.1
    assert min(vehicle.fraction for vehicle in vehicles) >= 0.3 - 1e-6
    leaning = [math.acos(min(1.0, vehicle.attitude[2, 0])) for vehicle in vehicles]
    assert max(leaning) <= 0.2618 + 0.01
    for vehicle in vehicles:
        aside = math.hypot(vehicle.position[0], vehicle.position[1])
        assert vehicle.position[2] >= math.tan(0.8727) * aside - 0.3
    assert all(tick.plan is not None and tick.plan.gap < 1e-3 for tick in ticks)
    assert sum(tick.status == 'optimal' for tick in ticks) >= 25
