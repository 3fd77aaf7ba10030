"""The demos beside the retrieval, end to end: real processes over DDS, numbers, bags, pictures."""

import itertools
import re
import subprocess
import sys
from collections import defaultdict

import numpy as np
import pytest

from orbimpc_ros.mpc.rotations import exp, from_quaternion
from orbimpc_ros.ros.parameters import planner_settings, sim_settings
from orbimpc_ros.tool import bag, settings
from orbimpc_ros.tool.share import config
from orbimpc_ros.world import scenario as scenarios
from orbimpc_ros.world.vehicle import advance, launched

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


dubins, spacecraft, retrieval3d = map(demo_of, ('dubins', 'spacecraft', 'retrieval3d'))


def check_pictures(folder, *names):
    assert {f.name for f in folder.glob('*.png')} == set(names)
    for name in names:
        picture = (folder / name).read_bytes()
        assert picture[:8] == b'\x89PNG\r\n\x1a\n'
        assert len(picture) > 50_000
        width, height = (int.from_bytes(picture[k : k + 4], 'big') for k in (16, 20))
        assert min(width, height) >= 1000


def messages_of(folder):
    """Return the messages in a bag by topic and stamp [ns]; the first under each."""
    found = defaultdict(dict)
    for message in bag.read(folder / 'bag'):
        found[message.topic[1:]].setdefault(message.stamp, message.content)
    return found


def check_topics(found, *more):
    """Every odometry was answered on every topic; the last one without a plan to fly."""
    for topic in ('goal', 'cmd_vel', 'rotation', 'tick', *more):
        assert set(found[topic]) == set(found['odom']), topic
    assert set(found['plan']) >= set(sorted(found['odom'])[:-1])
    assert found['captured']


def vector(message):
    return np.array([message.x, message.y, message.z])


def attitude(message):
    return from_quaternion(np.array([message.w, message.x, message.y, message.z]), 3)


def values_of(folder):
    return settings.read(bag.notes(folder / 'bag')['parameters'])


def check_rollout(folder, tolerance=1e-6):
    """What was commanded, flown by the vehicle's model, is the plan's and odometry's next pose.

    Flown in space; in the plane z stays zero and turning is about z.
    """
    found, values = messages_of(folder), values_of(folder)
    model = sim_settings(values | {'dimension': 3}).scenario.model
    fraction = values['start.speed_fraction']
    for now, then in itertools.pairwise(sorted(found['odom'])):
        vehicle = vehicle_of(found['odom'][now], model, fraction)
        fraction, rate = command_of(found, now, model)
        flown = advance(model, vehicle, fraction, rate)
        for pose in (found['plan'][now].poses[1].pose, found['odom'][then].pose.pose):
            assert np.allclose(vector(pose.position), flown.position, atol=tolerance)
            assert np.allclose(attitude(pose.orientation), flown.attitude, atol=tolerance)
        # At rotation order 2 a rate is taken over at the end of the step and turns in the next.
        turned = flown.attitude if model.rotation_order == 1 else flown.attitude @ exp(rate)
        commanded = attitude(found['rotation'][now].quaternion)
        assert np.allclose(commanded, turned, atol=tolerance)


def vehicle_of(odometry, model, fraction):
    """Return what is flown on from; odometry does not show the thrust, but it does the speed."""
    pose, twist = odometry.pose.pose, odometry.twist.twist
    if model.translation_order == 1:
        fraction = min(1.0, twist.linear.x / model.forward)
    body = attitude(pose.orientation)
    return launched(
        model,
        vector(pose.position),
        body,
        fraction=fraction,
        velocity=body @ vector(twist.linear),
        body_rate=vector(twist.angular),
    )


def command_of(found, stamp, model):
    """Return the share of speed or thrust, and the body rate [rad/s]."""
    twist = found['cmd_vel'][stamp].twist
    if model.translation_order == 1:
        return twist.linear.x / model.forward, vector(twist.angular)
    force = found['cmd_thrust'][stamp].wrench.force.x
    return force / (model.mass * model.forward), vector(twist.angular)


def arrivals(text):
    """Return the numbers of the table of errors at arrival, by row."""
    lines = text[text.index('error at arrival') :].splitlines()[1:]
    rows = [re.split(r'\s{3,}', line, maxsplit=1) for line in lines if re.search(NUMBER, line)]
    return {name: [float(n) for n in re.findall(NUMBER, rest)] for name, rest in rows}


WAYS = ['relaxed plan', 'open loop, nearest', 'open loop, thrust_aligned', 'closed loop']


def test_the_dubins_car_arrives_with_and_without_minimum_speed(dubins):
    done, folder = dubins
    assert done.returncode == 0, done.stdout + done.stderr
    found = arrivals(done.stdout)
    assert list(found) == WAYS
    assert [len(found[way]) for way in WAYS] == [3, 3, 3, 2]  # the circle is not flown
    assert max(max(numbers) for numbers in found.values()) <= 1e-3
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
    found = arrivals(done.stdout)
    assert list(found) == WAYS
    assert [len(numbers) for numbers in found.values()] == [2, 2, 2, 2]
    assert max(found['closed loop']) <= 0.05
    assert max(found['relaxed plan']) <= 1e-6
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
    check_pictures(folder, 'trajectory.png')
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
    found, known = sim_settings(values).scenario, getattr(scenarios, name)()
    assert found.model == known.model
    for part in ('start', 'rope'):
        for field, value in vars(getattr(known, part)).items():
            assert np.allclose(getattr(getattr(found, part), field), value, atol=1e-12), field
    for field in ('capture_radius', 'max_ticks', 'finish', 'arrival_radius', 'arrival_speed'):
        assert getattr(found, field) == getattr(known, field)
