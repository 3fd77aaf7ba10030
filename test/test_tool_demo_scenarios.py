# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The demos beside the retrieval, end to end: real processes over DDS, numbers, bags, pictures."""

import re
import subprocess
import sys

import numpy as np
import pytest
import scenarios
from bags import check_pictures, check_rollout, messages_of

from orbimpc_ros.ros.parameters import planner_settings
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.settings import config

pytest.importorskip('rclpy')
NUMBER = r'(\d+\.\d+e[-+]\d+)'


def run(name, out, *words):
    command = [sys.executable, '-m', 'orbimpc_ros.tool.cli', 'demo', name, '--out', str(out)]
    return subprocess.run([*command, *words], capture_output=True, text=True, check=False)


def demo_of(name):
    """Return a fixture of a demo's finished process and its folder."""

    @pytest.fixture(scope='module')
    def fixture(tmp_path_factory):
        out = tmp_path_factory.mktemp(name)
        return run(name, out), out / name

    return fixture


dubins, spacecraft, retrieval3d, multirotor = map(
    demo_of, ('dubins', 'spacecraft', 'retrieval3d', 'multirotor')
)


def check_topics(found, *more):
    """Every odometry was answered on every topic; the last one without a plan to fly."""
    for topic in ('goal', 'cmd_vel', 'rotation', 'tick', *more):
        assert set(found[topic]) == set(found['odom']), topic
    assert set(found['plan']) >= set(sorted(found['odom'])[:-1])
    assert found['captured']


def test_the_dubins_car_arrives_with_and_without_minimum_speed(dubins):
    done, folder = dubins
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count('arrived       yes') == 2
    assert done.stdout.count('fallbacks     0') == 2
    check_pictures(folder, 'trajectory.png')


@pytest.mark.parametrize(('shape', 'floor'), [('none', 0.2), ('polygon', 0.5)])
def test_the_dubins_bags_tell_the_whole_flight(dubins, shape, floor):
    _, folder = dubins
    found = messages_of(folder / shape)
    assert len(found['odom']) == 21
    check_topics(found)
    speeds = [m.twist.twist.linear.x for m in found['odom'].values()]
    assert floor - 1e-6 <= min(speeds) ** 2 < floor + 0.01
    end = found['odom'][max(found['odom'])].pose.pose.position
    assert np.allclose([end.x, end.y], [5.0, 10.0], atol=1e-3)
    check_rollout(folder / shape)


def test_the_spacecraft_arrives_at_rest(spacecraft):
    done, folder = spacecraft
    assert done.returncode == 0, done.stdout + done.stderr
    missed, speed = map(float, re.findall(NUMBER, done.stdout)[:2])
    assert missed <= 0.05
    assert speed <= 0.05
    check_pictures(folder, 'trajectory.png', 'data.png')


def test_the_spacecraft_is_commanded_by_rates_and_thrust(spacecraft):
    _, folder = spacecraft
    found = messages_of(folder)
    assert len(found['odom']) == 21
    check_topics(found, 'cmd_thrust')
    assert all(m.twist.linear.x == 0.0 for m in found['cmd_vel'].values())
    assert max(m.wrench.force.x for m in found['cmd_thrust'].values()) > 0.5
    check_rollout(folder)


def test_the_rope_is_caught_in_space(retrieval3d):
    done, folder = retrieval3d
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'captured      t = 8.5' in done.stdout
    check_pictures(folder, 'trajectory.png', 'data.png')
    found = messages_of(folder)
    check_topics(found)
    check_rollout(folder)
    speeds = [m.twist.linear.x for m in list(found['cmd_vel'].values())]
    assert min(speeds) >= np.sqrt(0.3) - 1e-6


def test_who_does_not_arrive_has_failed(tmp_path):
    done = run('dubins', tmp_path, '--set', 'floor.shape=none', '--set', 'max_ticks=5')
    assert done.returncode == 1
    assert 'arrived       no' in done.stdout
    assert 'Traceback' not in done.stderr
    assert (tmp_path / 'dubins' / 'trajectory.png').is_file()


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
    for part in ('start', 'rope'):
        for field, value in vars(getattr(known, part)).items():
            assert np.allclose(getattr(getattr(found, part), field), value, atol=1e-12), field
    for field in ('capture_radius', 'max_ticks', 'finish', 'arrival_radius', 'arrival_speed'):
        assert getattr(found, field) == getattr(known, field)


def test_the_multirotor_arrives_and_touches_no_box(multirotor):
    done, folder = multirotor
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'arrived       yes' in done.stdout
    assert 'touched       no box' in done.stdout
    check_pictures(folder, 'trajectory.png', 'data.png')
    found = messages_of(folder)
    assert set(found['cmd_thrust']) == set(found['odom'])
    assert all(m.wrench.force.x == 0.0 for m in found['cmd_thrust'].values())  # along z


def test_a_multirotor_through_a_box_has_failed(tmp_path):
    """A box that its planner does not know of, on the way that it takes."""
    unknown = 'sim.obstacles=[4.0, -3.0, -3.0, 4.5, 3.0, 3.0]'
    done = run('multirotor', tmp_path, '--set', unknown, '--set', 'max_ticks=20')
    assert done.returncode == 1, done.stdout + done.stderr
    assert 'touched       box 1' in done.stdout


def test_the_lander_touches_down(tmp_path):
    done = run('lander', tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r'arrived +yes', done.stdout)
    folder = tmp_path / 'lander'
    found = messages_of(folder)
    forces = [message.wrench.force for message in found['cmd_thrust'].values()]
    flown = np.array([(force.x, force.z) for force in forces][:-1])
    assert not flown[:, 0].any()
    assert flown[:, 1].min() >= 0.3 * 3.6 * 500.0 * (1.0 - 1e-6)
    check_pictures(folder, 'trajectory.png', 'data.png')
