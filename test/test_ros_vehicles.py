# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The vehicles that the documentation sets up, flown with lags, wind and faults."""

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from pages import blocks_of
from planners import settings as settings_of
from problems import needs_machine_code
from stepping import flown, started

from orbimpc_ros.loop.goal.motion import GoalObservation
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.ros.parameters.planner import PLANNER, planner_settings
from orbimpc_ros.ros.planner.outputs import doubts
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.sim.vehicle import Plant, measured
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.offline import OfflinePlanner, closed_loop

PAGE = Path(__file__).parents[1] / 'docs' / 'vehicle.md'


def recipe(name):
    """Return the parameters that the page gives under the heading that contains ``name``."""
    (section,) = (each for each in PAGE.read_text().split('\n## ') if name in each.splitlines()[0])
    (block,) = (each for each in blocks_of(section) if each.language == 'yaml')
    return yaml.safe_load(block.text)['/**/planner']['ros__parameters']


def flight(parameters, plant, vehicle, goal, seconds, band=0.0):
    """Return time, vehicle and command at every tick."""
    planner, log = OfflinePlanner(settings_of(**parameters), clock=time.process_time), []
    source = parameters.get('velocity_source', 'ground')
    for k in range(round(seconds / planner.settings.period)):
        now = k * planner.settings.period
        planner.sense(now, GoalObservation(now, np.array(goal(now))))
        planner.sense(now, replace(measured(vehicle, source), time=now))
        command = planner.report(now).command
        log.append((now, vehicle, command))
        wanted = command.speed_fraction
        held = wanted if wanted * plant.forward >= band else 0.0
        vehicle = flown(plant, vehicle, held, command.body_rate, planner.settings.period)
    return log


@pytest.mark.parametrize('name', ['rover', 'fixed wing', 'multirotor'])
def test_a_recipe_is_a_vehicle_without_doubts(name):
    given = recipe(name)
    settings = planner_settings({row.name: row.default for row in PLANNER} | given)
    assert doubts(settings, given) == []


@needs_machine_code
def test_a_rover_comes_to_rest_at_its_goal_against_a_current():
    craft = Plant(
        forward=1.5, speed_lag=0.3, rate_lag=0.15, gain=0.93, disturbance=(0.15, 0.1), max_rate=1.5
    )
    place = np.array([-6.0, 4.0])
    log = flight(recipe('rover'), craft, started(craft), lambda now: place, 30.0, band=0.1)
    late = [motion.position for now, motion, _ in log if now > 22.0]
    assert np.max(np.linalg.norm(np.array(late) - place, axis=1)) < 0.15


@needs_machine_code
def test_a_fixed_wing_meets_what_drifts_and_never_flies_too_slowly():
    craft = Plant(
        forward=15.0, speed_lag=0.8, rate_lag=0.3, disturbance=(-3.0, 2.0), max_rate=0.4363
    )
    start = started(craft, 2.4, 0.8)
    log = flight(recipe('fixed wing'), craft, start, lambda now: [60.0 + now, 30.0 - now], 28.0)
    away = [np.linalg.norm(motion.position - [60.0 + now, 30.0 - now]) for now, motion, _ in log]
    assert min(away) < 3.0
    assert min(command.speed_fraction for *_, command in log) >= 0.6667
    assert max(abs(command.body_rate[0]) for *_, command in log) <= 0.4363 * (1.0 + 1e-9)


UPRIGHT = exp(np.array([0.0, -0.5 * np.pi, 0.0]))  # thrust is along the first axis


@needs_machine_code
@pytest.mark.parametrize('boxes', [False, True])
def test_a_multirotor_whose_rates_are_clipped_comes_to_rest_far_away(boxes):
    """At most 220 deg/s, twice the configured lags, a fifth heavier: 9 m away, also among boxes."""
    parameters = recipe('multirotor')
    rng, place, around = np.random.default_rng(7), np.array([7.0, -4.0, 3.0]), []
    while boxes and len(around) < 8:
        middle, half = rng.uniform(0.2, 0.8) * place + rng.uniform(-2.0, 2.0, 3), 0.6
        if min(np.abs(middle).max(), np.abs(middle - place).max()) > half + 0.6:
            around.append((middle - half, middle + half))
    margin = 0.2
    wide = [float(x) for low, high in around for x in (*(low - margin), *(high + margin))]
    parameters |= {'obstacles': tuple(wide), 'obstacle_reserve': margin}
    craft = Plant(
        3, 1, 2, forward=19.6, speed_lag=0.1, rate_lag=0.1, gain=1.0 / 1.2,
        disturbance=(0.6, -0.4, -9.81), max_rate=3.84,
    )  # fmt: skip
    start = replace(started(craft, 0.0, 0.6), attitude=UPRIGHT)
    log = flight(parameters, craft, start, lambda now: place, 11.0)
    away = [np.linalg.norm(motion.position - place) for _, motion, *_ in log]
    assert max(away[80:]) < 0.05
    assert max(np.linalg.norm(command.body_rate) for *_, command in log) <= 3.84 * (1.0 + 1e-9)
    for low, high in around:
        assert not any(np.all((m.position > low) & (m.position < high)) for _, m, *_ in log)


@needs_machine_code
@pytest.mark.parametrize(
    ('name', 'seed'), [('multirotor', 7), ('multirotor', 8), ('retrieval3d', 0)]
)
def test_a_scenario_in_space_does_its_job_in_any_gusts_and_touches_no_box(name, seed):
    values = settings.resolve(settings.config(f'{name}.yaml'), [f'seed={seed}'])
    planner = OfflinePlanner(planner_settings(values))
    *_, (flight, _) = closed_loop(planner, sim_settings(settings.of_sim(values)))
    assert (flight.captured, flight.touched) == (True, frozenset())


def test_a_landing_keeps_its_limits_and_every_tick_is_bounded():
    """In continuous time with lags, like the demo over DDS."""
    values = settings.resolve(settings.config('lander.yaml'))
    planner = OfflinePlanner(planner_settings(values))
    flights, ticks = zip(*closed_loop(planner, sim_settings(values)), strict=True)
    flight, vehicles = flights[-1], [each for flight in flights for each in flight.trail]
    assert flight.captured
    assert flight.distance < 0.1
    assert flight.speed < 0.1
    assert min(vehicle.fraction for vehicle in vehicles) >= 0.3 - 1e-6
    leaning = [math.acos(min(1.0, vehicle.attitude[2, 0])) for vehicle in vehicles]
    assert max(leaning) <= 0.2618 + 0.01
    for vehicle in vehicles:
        aside = math.hypot(vehicle.position[0], vehicle.position[1])
        assert vehicle.position[2] >= math.tan(0.8727) * aside - 0.3
    assert all(tick.plan is not None and tick.plan.gap < 1e-3 for tick in ticks[:-1])
    assert sum(tick.status == 'optimal' for tick in ticks[:-1]) >= 25
