# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A vehicle in an engine: its parameters, a flight over DDS, an engine that dies."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy')

from bags import messages_of

from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.sim.engine_vehicle import EnginePlant
from orbimpc_ros.sim.parameters import SIM, sim_settings
from orbimpc_ros.sim.world import departure
from orbimpc_ros.tool import cli, settings
from orbimpc_ros.tool.bags import fields
from orbimpc_ros.tool.offline import aboard, tell
from orbimpc_ros.tool.settings import config

DEFAULTS = {row.name: row.default for row in SIM}
NEARER = 'rope.center=[350.0, 60.0, 0.0]'  # a short flight
DYING = Path(__file__).with_name('dying_engine.py')
needs_speed = pytest.mark.skipif(not COMPILED, reason='takes minutes in plain Python; needs numba')


def test_parameters_make_the_aircraft_that_they_say():
    values = settings.resolve(config('cessna.yaml'))
    told = sim_settings(settings.of_sim(values))
    model = told.scenario.model
    assert isinstance(model, EnginePlant)
    assert (model.engine, model.step, model.forward, model.turbulence) == ('cessna', 0.5, 50.0, 0.7)
    assert model.stall_speed == 27.6
    assert told.scenario.rope_length == 40.0
    assert told.goal_path_steps == 0  # nobody is told of the future
    assert values['wind'] == (0.0, 0.0, 0.0)  # nor of the wind
    assert values['floor.fraction'] * model.forward >= 1.1 * model.stall_speed


@needs_speed
@pytest.mark.parametrize('believed', [True, False])
def test_a_gust_that_turns_the_nose_turns_no_plan(believed):
    """A gust of 2 m/s from the left: the nose is turned into it, and the way over ground is not."""
    values = settings.resolve(config('cessna.yaml')) | {'sideslip': believed}
    planner, slip = aboard(values), 0.04
    turned = np.array([[math.cos(slip), -math.sin(slip)], [math.sin(slip), math.cos(slip)]])
    velocity = turned.T @ [45.0, 0.0]
    for k in range(5):
        place = np.array([0.5 * k * 45.0, 0.0])
        planner.goal(0.5 * k, place + np.array([300.0 - 5.0 * k, 0.0]))
        planner.odometry(0.5 * k, Odometry(0.5 * k, place, turned, velocity, np.zeros(1)))
        report = planner.report(0.5 * k)
    heading = math.atan2(*report.decision.state.attitude[::-1, 0])
    assert heading == pytest.approx(0.0 if believed else slip, abs=1e-6)
    if believed:
        np.testing.assert_allclose(report.decision.disturbance, 0.0, atol=1e-3)
        assert abs(report.decision.command.body_rate[0]) < 1e-3


@pytest.mark.parametrize(
    'change', ['goal_path_steps=3', 'rope.frequency=0.4', 'rope.velocity=[1,0,0]']
)
def test_how_a_goal_moves_is_not_said_where_the_engine_moves_it(change):
    name = change.partition('=')[0]
    with pytest.raises(BadInput, match=f'{name} is .*; allowed: 0 with vehicle: hummingbird'):
        settings.resolve(config('rope.yaml'), [change])


def test_a_demo_without_its_engine_says_how_to_get_it(monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(__import__('sys').modules, 'jsbsim', None)
    monkeypatch.delitem(__import__('sys').modules, 'orbimpc_ros.sim.engines.cessna', raising=False)
    assert cli.main(['demo', 'cessna', '--out', str(tmp_path)]) == 2
    out, err = capsys.readouterr()
    assert err.startswith('orbimpc: vehicle cessna: jsbsim is missing; ')
    assert "pip install 'jsbsim>=1.2'" in err
    assert err.count('\n') == 1
    assert not out
    assert not list(tmp_path.iterdir())


@needs_speed
def test_the_cessna_meets_the_line():
    """No clock runs while its planner thinks: how busy the machine is makes no difference."""
    pytest.importorskip('jsbsim')
    values = settings.resolve(config('cessna.yaml'), [NEARER])
    planner = aboard(values, clock=lambda: 0.0)
    flight = departure(sim_settings(settings.of_sim(values)).scenario)
    while not flight.over:
        tell(planner, flight, 0)
        command = planner.report(flight.vehicle.time).decision.command
        flight = flight.after(command.speed_fraction, command.body_rate)
    assert flight.captured
    assert flight.miss < 5.0


def test_the_cessna_flies_over_dds(capfd, tmp_path):
    """A planner that starves may miss the line. The bag tells of the flight as the engine does."""
    pytest.importorskip('jsbsim')
    changes = (NEARER, 'odom_timeout=60.0', 'goal_timeout=60.0')
    words = [word for each in changes for word in ('--set', each)]
    failed = cli.main(['demo', 'cessna', *words, '--out', str(tmp_path)])
    out, _ = capfd.readouterr()
    assert re.search(r'captured +(?:no|t = \d+\.\d+ s, [0-4]\.\d+ m from the rope)\n', out)
    assert failed == bool(re.search('captured +no', out))
    found = messages_of(tmp_path / 'cessna')
    truths = [fields(each) for each in found['truth'].values()]
    assert min(each['airspeed'] for each in truths) > 1.1 * 27.6
    assert max(abs(each['bank']) for each in truths) < 0.55
    assert max(abs(each['height']) for each in truths) < 30.0
    commands = [each.twist for each in found['cmd_vel'].values()]
    assert min(each.linear.x for each in commands) >= 40.0 - 1e-6
    assert max(abs(each.angular.z) for each in commands) <= 0.09 + 1e-9


@pytest.mark.parametrize('name', ['cessna', 'rope', 'servicer'])
def test_a_planner_is_told_nothing_of_wind_and_swing(name):
    values = settings.resolve(config(f'{name}.yaml'))
    told = sim_settings(settings.of_sim(values))
    assert isinstance(told.scenario.model, EnginePlant)
    assert told.goal_path_steps == 0
    assert values['wind'] == (0.0, 0.0, 0.0)


def test_the_spacecraft_arrives(capfd, tmp_path):
    """Over DDS, on Basilisk's own wheels and thrusters."""
    pytest.importorskip('Basilisk', reason="pip install 'orbimpc_ros[basilisk]' runs this")
    words = ['--set', 'odom_timeout=60.0', '--set', 'goal_timeout=60.0', '--out', str(tmp_path)]
    assert cli.main(['demo', 'servicer', *words]) == 0
    out, _ = capfd.readouterr()
    assert re.search(r'arrived +yes, \d\.\de-0\d m from the goal', out)
    found = messages_of(tmp_path / 'servicer')
    truths = [fields(each) for each in found['truth'].values()]
    assert max(each['pointing'] for each in truths) < 0.1
    forces = [each.wrench.force.x for each in found['cmd_thrust'].values()]
    assert 0.0 <= min(forces) <= max(forces) <= 0.9 + 1e-9
    assert (tmp_path / 'servicer' / 'trajectory.png').is_file()


def test_an_engine_that_fails_ends_the_flight_with_a_line(launch, monkeypatch):
    monkeypatch.setenv('FAILURE', 'Poisoned')
    launch('planner', {'odom_timeout': 60.0, 'goal_timeout': 60.0}, 'cessna')
    sim = launch(DYING, {'odom_rate': 1.0}, 'cessna')
    assert sim.wait() == 1
    (said,) = [line for line in sim.output.splitlines() if 'the engine has failed' in line]
    blame = 'broken: numbers that are not finite, after t = 2.000 s'
    assert said.endswith(f'the engine has failed: {blame}')
    assert 'Traceback' not in sim.output
