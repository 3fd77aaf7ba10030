# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Vehicles in continuous time and in engines: parameters, flights over DDS, a failing engine."""

import math
import time
from pathlib import Path

import numpy as np
import pytest
from bags import messages_of
from problems import needs_machine_code

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.loop.goal.motion import GoalObservation
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.parameters.planner import planner_settings
from orbimpc_ros.sim.parameters import SIM, sim_settings
from orbimpc_ros.sim.vehicle import ENGINES, Plant
from orbimpc_ros.tool import cli, settings
from orbimpc_ros.tool.bags import fields
from orbimpc_ros.tool.offline import OfflinePlanner
from orbimpc_ros.tool.settings import config

DEFAULTS = {row.name: row.default for row in SIM}
DYING = Path(__file__).with_name('dying_engine.py')


def test_parameters_make_the_aircraft_that_they_say():
    values = settings.resolve(config('cessna.yaml'))
    told = sim_settings(settings.of_sim(values))
    assert (told.vehicle, told.model.step, told.forward, told.gust) == ('cessna', 0.5, 50.0, 0.7)
    assert told.stall_speed == 27.6
    assert told.rope_length == 40.0
    assert values['floor.fraction'] * told.forward >= 1.1 * told.stall_speed


@pytest.mark.parametrize('name', ['cessna', 'rope', 'servicer'])
def test_a_planner_is_told_nothing_of_wind_and_swing(name):
    values = settings.resolve(config(f'{name}.yaml'))
    told = sim_settings(settings.of_sim(values))
    assert told.vehicle in ENGINES
    assert told.goal_path_steps == 0
    assert values['wind'] == (0.0, 0.0, 0.0)


@needs_machine_code
@pytest.mark.parametrize('believed', [True, False])
def test_a_gust_that_turns_the_nose_turns_no_plan(believed):
    """A gust of 2 m/s from the left turns the nose into it, but not the path over ground."""
    values = settings.resolve(config('cessna.yaml')) | {'sideslip': believed}
    planner = OfflinePlanner(planner_settings(values), clock=time.perf_counter)
    slip = 0.04
    turned = np.array([[math.cos(slip), -math.sin(slip)], [math.sin(slip), math.cos(slip)]])
    velocity = turned.T @ [45.0, 0.0]
    for k in range(5):
        place = np.array([0.5 * k * 45.0, 0.0])
        ahead = place + np.array([300.0 - 5.0 * k, 0.0])
        planner.sense(0.5 * k, GoalObservation(0.5 * k, ahead))
        planner.sense(0.5 * k, Odometry(0.5 * k, place, turned, velocity, np.zeros(1)))
        report = planner.report(0.5 * k)
    heading = math.atan2(*report.state.attitude[::-1, 0])
    assert heading == pytest.approx(0.0 if believed else slip, abs=1e-6)
    if believed:
        np.testing.assert_allclose(report.disturbance, 0.0, atol=1e-3)
        assert abs(report.command.body_rate[0]) < 1e-3


PLANAR = ('sim.dimension=3', 'sim.translation_order=2')
REFUSED = {
    'rope': ['goal_path_steps=3', 'rope.frequency=0.4', 'rope.velocity=[1,0,0]', *PLANAR],
    'cessna': PLANAR,
    'servicer': ['sim.dimension=2', 'sim.translation_order=1'],
}


@pytest.mark.parametrize('task', REFUSED)
def test_an_engine_fixes_how_it_flies_and_one_of_them_how_the_goal_moves(task):
    for change in REFUSED[task]:
        name = change.removeprefix('sim.').partition('=')[0]
        with pytest.raises(BadInput, match=f'{name} is .*; allowed: .* with vehicle: '):
            settings.resolve(config(f'{task}.yaml'), [change])


def test_an_engine_that_fails_ends_the_flight_with_a_line(launch, monkeypatch):
    monkeypatch.setenv('FAILURE', 'Poisoned')
    launch('planner', {'odom_timeout': 60.0, 'goal_timeout': 60.0}, 'cessna')
    sim = launch(DYING, {'odom_rate': 1.0}, 'cessna')
    assert sim.wait() == 1
    (said,) = [line for line in sim.output.splitlines() if 'the engine has failed' in line]
    assert 'the engine has failed: broken: numbers that are not finite at t = ' in said
    assert 'Traceback' not in sim.output


# --- continuous time

WING = {
    'vehicle': 'continuous',
    'response.speed': 0.2,
    'response.rate': 0.1,
    'gust': 0.02,
    'stall_speed': 0.5,
    'seed': 1,
    'capture_radius': 0.3,
    'odom_rate': 5.0,
    'max_ticks': 200,
}


def test_parameters_make_the_plant_that_they_say():
    own = {'step': 0.5, 'forward': 15.0, 'max_rate': 0.4, 'max_acceleration': 3.0, 'gain': 1.03}
    given = {'vehicle': 'continuous', 'odom_rate': 10.0, 'seed': 7, 'wind': (1.0, -2.0, 0.0)}
    given |= {'response.speed': 0.8, 'response.rate': 0.3, 'gust': 0.5, 'gust_time': 2.0}
    told, lags = sim_settings(DEFAULTS | given | own), {'speed_lag': 0.8, 'rate_lag': 0.3}
    own |= {'gust': 0.5, 'gust_time': 2.0, 'seed': 7, 'step': 0.1}  # period of odometry
    assert told.model == Plant(disturbance=(1.0, -2.0), **lags, **own)
    assert told.command_timeout == 0.75  # 1.5 steps of the planner


def test_a_limit_of_the_planner_alone_is_not_the_discrete_vehicles():
    limited = sim_settings(DEFAULTS | {'max_rate': 0.5, 'max_acceleration': 1.0})
    assert not isinstance(limited.model, Plant)


def test_a_vehicle_in_continuous_time_is_caught_over_dds(tmp_path, capsys):
    """With lags and gusts; five times per step the bag records the least airspeed so far."""
    changes = [f'--set={name}={value}' for name, value in WING.items()]
    assert cli.main(['demo', 'retrieval', '--out', str(tmp_path), *changes]) == 0
    found = messages_of(tmp_path / 'retrieval')
    assert np.diff(sorted(found['odom'])).min() == pytest.approx(0.2e9)
    said = [fields(each) for each in found['truth'].values()]
    assert len(said) > 10
    assert len(said[-1]['wind']) == 2
    slowest, stalls = said[-1]['least_airspeed'], said[-1]['stalls']
    assert slowest == min(each['least_airspeed'] for each in said)
    assert (stalls > 0) == (slowest < 0.5)
    assert f'at least {slowest:.2f} m/s, {stalls} stalls' in capsys.readouterr().out
