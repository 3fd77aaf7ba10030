# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Tilt and glide slope in flight: the lander's limits."""

import math

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2, or pip install orbimpc_ros[ros]')

from stepping import Stepped

from orbimpc_ros.ros.parameters import planner_settings
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.sim.vehicle import measured
from orbimpc_ros.sim.world import departure
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.settings import config


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
