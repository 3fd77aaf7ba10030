# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The demos beside the retrieval, end to end: real processes over DDS, numbers, bags, pictures."""

import subprocess
import sys
from typing import NamedTuple

import numpy as np
import pytest
import scenarios
from bags import check_pictures, check_rollout, messages_of

from orbimpc_ros.ros.parameters import planner_settings
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.tool import cli, settings
from orbimpc_ros.tool.settings import config

pytest.importorskip('rclpy')
ONE = ('trajectory.png', 'data.png')


class Flown(NamedTuple):
    """What a demo shows: its end in words, its pictures, its flights, and how these are driven."""

    end: str
    pictures: tuple[str, ...] = ONE
    flights: tuple[str, ...] = ('',)
    thrust: str = ''  # axis of the force
    least: float = 0.0  # speed [m/s] or force [N] commanded
    rolled: bool = True  # whether the vehicle is the discrete model


DEMOS = {
    'dubins': Flown('arrived       yes', ('trajectory.png',), ('no_floor', 'floor')),
    'spacecraft': Flown('arrived       yes', thrust='x'),
    'retrieval3d': Flown('captured      t = 8.5', least=np.sqrt(0.3)),
    'multirotor': Flown('touched       no box', thrust='z', rolled=False),
    'lander': Flown('arrived       yes', thrust='z', least=0.3 * 3.6 * 500.0, rolled=False),
}


def run(name, out, *words):
    command = [sys.executable, '-m', 'orbimpc_ros.tool.cli', 'demo', name, '--out', str(out)]
    return subprocess.run([*command, *words], capture_output=True, text=True, check=False)


def commanded(found, axis):
    """Return the speeds or, along an axis, the forces commanded but the last, shape (K, 3)."""
    if axis:
        vectors = [message.wrench.force for message in found['cmd_thrust'].values()]
    else:
        vectors = [message.twist.linear for message in found['cmd_vel'].values()]
    return np.array([(each.x, each.y, each.z) for each in vectors])[:-1]


@pytest.mark.parametrize('name', DEMOS)
def test_a_demo_does_its_job_and_its_bag_tells_the_whole_flight(name, tmp_path, capsys):
    """Every odometry is answered on every topic; the last one need not have a plan to fly."""
    shown, done = DEMOS[name], run(name, tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(shown.end) == len(shown.flights)
    check_pictures(tmp_path / name, *shown.pictures)
    for flight in shown.flights:
        found = messages_of(tmp_path / name / flight)
        topics = ('goal', 'cmd_vel', 'rotation', 'tick', *(['cmd_thrust'] if shown.thrust else []))
        for topic in topics:
            assert set(found[topic]) == set(found['odom']), topic
        assert found['captured']
        along = 'xyz'.index(shown.thrust or 'x')
        pushed = commanded(found, shown.thrust)
        assert not np.delete(pushed, along, axis=1).any()
        assert pushed[:, along].min() >= shown.least * (1.0 - 1e-6)
        assert pushed[:, along].max() > 0.0
        if shown.rolled:
            assert set(found['plan']) >= set(sorted(found['odom'])[:-1])
            check_rollout(tmp_path / name / flight)
            bag = str(tmp_path / name / flight / 'bag')
            assert cli.main(['replay', bag]) == 0, capsys.readouterr().out


@pytest.mark.parametrize(
    ('name', 'changes', 'end'),
    [
        ('dubins', ('floor.shape=none', 'max_ticks=5'), 'arrived       no'),
        # A box that its planner does not know of, on the way that it takes.
        (
            'multirotor',
            ('sim.obstacles=[4.0, -3.0, -3.0, 4.5, 3.0, 3.0]', 'max_ticks=20'),
            'touched       box 1',
        ),
    ],
)
def test_who_does_not_arrive_or_touches_a_box_has_failed(name, changes, end, tmp_path):
    done = run(name, tmp_path, *(word for each in changes for word in ('--set', each)))
    assert done.returncode == 1, done.stdout + done.stderr
    assert end in done.stdout
    assert 'Traceback' not in done.stderr
    assert (tmp_path / name / 'trajectory.png').is_file()


PROBLEMS = {
    'retrieval': scenarios.retrieval_problem,
    'retrieval3d': scenarios.retrieval3d_problem,
    'dubins': scenarios.dubins_problem,
    'spacecraft': scenarios.spacecraft_problem,
}


@pytest.mark.parametrize('name', PROBLEMS)
def test_configurations_say_what_the_scenarios_say(name):
    values = settings.resolve(config(f'{name}.yaml'))
    assert planner_settings(values).problem == PROBLEMS[name]()
    found, known = sim_settings(settings.of_sim(values)).scenario, getattr(scenarios, name)()
    assert found.model == known.model
    for name in ('position', 'velocity', 'attitude'):
        assert np.allclose(getattr(found.start, name), getattr(known.start, name), atol=1e-12)
    for name, value in vars(known.rope).items():
        assert np.allclose(getattr(found.rope, name), value, atol=1e-12)
    for field in ('capture_radius', 'max_ticks', 'finish', 'arrival_radius', 'arrival_speed'):
        assert getattr(found, field) == getattr(known, field)
