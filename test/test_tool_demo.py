# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The demos as a newcomer runs them: real processes over DDS, one vehicle or a fleet."""

import itertools
import resource
import signal
import subprocess
from functools import cache
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from bags import check_pictures, messages_of, read
from harness import TOOL, alive, children_of, orbimpc, ran_here, wait_for
from rosbags.rosbag2 import Reader

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.entry import PACKAGES
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.sim.fleet import vehicles
from orbimpc_ros.tool import bags, cli, demo, files, history, settings

LISTED = ('captured', 'cmd_thrust', 'goal_path', 'odom')  # even without messages


class Flown(NamedTuple):
    """Expected results of a demo: its outcome in words, flights, and their commands."""

    end: str
    flights: tuple[str, ...] = ('',)
    thrust: str = ''  # axis of the force
    least: float = 0.0  # least speed [m/s] or force [N] commanded
    rolled: bool = True  # True if the vehicle is the discrete model


DEMOS = {
    'retrieval': Flown('captured at t = ', ('', 'first_pass'), least=np.sqrt(0.3)),
    'dubins': Flown(' arrived at t = ', ('no_floor', 'floor')),
    'spacecraft': Flown(' arrived at t = ', thrust='x'),
    'lander': Flown(' arrived at t = ', thrust='z', least=0.3 * 3.6 * 500.0, rolled=False),
}


def commanded(found, axis):
    """Return the commanded speeds or, along an axis, forces, except the last, shape (K, 3)."""
    if axis:
        vectors = [message.wrench.force for message in found['cmd_thrust'].values()]
    else:
        vectors = [message.twist.linear for message in found['cmd_vel'].values()]
    return np.array([(each.x, each.y, each.z) for each in vectors])[:-1]


def numbers(pose):
    place, turned = pose.position, pose.orientation
    return place.x, place.y, place.z, turned.w, turned.x, turned.y, turned.z


@pytest.fixture(scope='module')
def demo_of(tmp_path_factory):
    """Return a function that runs a demo once, and returns what it returned and its folder.

    The retrieval runs as a user starts it; the others spare a process its imports.
    """
    out = tmp_path_factory.mktemp('demo')

    def fly(name):
        run = orbimpc if name == 'retrieval' else ran_here
        return run('demo', name, '--out', out), out / name

    return cache(fly)


@pytest.fixture
def flown(demo_of):
    return demo_of('retrieval')


@pytest.mark.parametrize('name', DEMOS)
def test_a_demo_does_its_job_and_its_bag_tells_the_whole_flight(name, demo_of, capsys):
    """Each odometry is answered on every topic; only the last one may be without a plan."""
    shown, (done, folder) = DEMOS[name], demo_of(name)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(shown.end) == len(shown.flights)
    assert f'picture       {folder / "trajectory.png"}' in done.stdout
    check_pictures(folder, 'trajectory.png', *['data.png'][: shown.flights == ('',)])
    for flight in shown.flights:
        assert f'bag           {folder / flight / "bag"}' in done.stdout
        with Reader(folder / flight / 'bag') as reader:
            assert {f'/{each}' for each in LISTED} <= set(reader.topics)
        found = messages_of(folder / flight)
        topics = ('goal', 'cmd_vel', 'rotation', 'tick', 'clock', 'cmd_thrust')
        topics = topics if shown.thrust else topics[:-1]
        for topic in topics:
            assert set(found[topic]) == set(found['odom']), topic
        assert found['captured']
        along = 'xyz'.index(shown.thrust or 'x')
        pushed = commanded(found, shown.thrust)
        assert not np.delete(pushed, along, axis=1).any()
        assert pushed[:, along].min() >= shown.least * (1.0 - 1e-6)
        assert pushed[:, along].max() > 0.0
        if shown.rolled:
            for topic in ('plan', 'plan_markers'):
                assert set(found[topic]) >= set(sorted(found['odom'])[:-1]), topic
            for now, then in itertools.pairwise(sorted(found['odom'])):
                planned, there = found['plan'][now].poses[1].pose, found['odom'][then].pose.pose
                assert np.allclose(numbers(planned), numbers(there), atol=1e-6)
            bag = str(folder / flight / 'bag')
            assert cli.main(['replay', bag]) == 0, capsys.readouterr().out


def test_who_does_not_arrive_and_touches_a_box_has_failed(tmp_path, monkeypatch):
    """There is a bag, a picture and a log nevertheless; no home folder is needed."""
    monkeypatch.setenv('HOME', '/proc/nobody')
    for variable in ('ROS_LOG_DIR', 'ROS_HOME'):
        monkeypatch.delenv(variable, raising=False)
    # A box in its way that its planner does not have.
    changes = ('sim.obstacles=[4.0, -3.0, -3.0, 4.5, 3.0, 3.0]', 'max_ticks=20')
    words = [word for each in changes for word in ('--set', each)]
    done = orbimpc('demo', 'multirotor', '--out', tmp_path, *words)
    assert done.returncode == 1, done.stdout + done.stderr
    assert 'not arrived by' in done.stdout
    assert 'touched box 1' in ' '.join(done.stdout.split())
    assert 'Traceback' not in done.stderr
    assert (tmp_path / 'multirotor' / 'trajectory.png').is_file()
    (bag,) = tmp_path.rglob('bag')
    assert len([m for m in read(bag) if m.topic == '/tick']) > 2
    assert list(bag.with_name('log').iterdir())


def test_the_same_rope_is_intercepted_on_the_first_pass(flown):
    _, folder = flown
    paper, other = (history.of_bag(folder / name / 'bag') for name in ('.', 'first_pass'))
    np.testing.assert_array_equal(other.ropes[:5], paper.ropes[:5])
    assert not len(other.near_misses)
    assert np.ptp(other.times) < 0.5 * np.ptp(paper.times)


def test_a_retrieval_that_is_not_the_papers_is_flown_alone():
    assert len(demo.variants('retrieval', [])) == 2
    assert len(demo.variants('retrieval', ['rope.frequency=0.2'])) == 1


TICK = {
    'status', 'reason', 'objective', 'lower_bound', 'gap', 'bound_checked', 'infeasible_checked',
    'nodes', 'solve_time_ms', 'speed_fraction', 'projection_distance', 'fallback', 'cause',
    'binding', 'advanced', 'goal_stamps', 'goal_counts', 'disturbance', 'innovation',
    'earliest_catch', 'catch_bound', 'catch_checked', 'obstacles', 'obstacles_left_out',
    'clearance', 'traffic_stamps', 'margins', 'sent',
}  # fmt: skip


def test_frames_stamps_and_values_are_as_documented(flown):
    done, folder = flown
    assert 'tick' in done.stderr
    found = messages_of(folder)
    for topic, frame in (('goal', 'odom'), ('rotation', 'odom'), ('plan', 'odom')):
        assert {each.header.frame_id for each in found[topic].values()} == {frame}
    assert {each.header.frame_id for each in found['cmd_vel'].values()} == {'base_link'}
    assert {each.child_frame_id for each in found['odom'].values()} == {'base_link'}
    for stamp, plan in found['plan'].items():
        times = [each.header.stamp.sec * SECOND for each in plan.poses]
        assert times == [stamp + k * SECOND for k in range(6)]
        assert plan.poses[0].pose.position == found['odom'][stamp].pose.pose.position
    for stamp, told in ((stamp, bags.fields(each)) for stamp, each in found['tick'].items()):
        assert set(told) == TICK
        assert told['goal_stamps'] == {'goal': stamp}
        assert (told['status'], told['fallback']) == ('optimal', '')
        assert told['lower_bound'] <= told['objective']
        assert told['gap'] <= 1e-4
        assert told['solve_time_ms'] > 0.0
        assert len(told['speed_fraction']) == 6
        assert min(told['speed_fraction'][1:]) >= np.sqrt(0.3) - 1e-6
        assert set(told['margins']) == {'hull', 'floor'}
        assert min(told['margins'].values()) >= -1e-6
    caught = [each.content.data for each in read(folder / 'bag') if each.topic == '/caught']
    assert caught[-1:] == [True]  # earlier ones may be False


def test_an_interrupted_demo_leaves_a_readable_bag_and_no_process(tmp_path):
    # In real time the flight takes many seconds, enough to interrupt it.
    words = [*TOOL, 'demo', '--out', str(tmp_path), '--set', 'clock=wall']
    child = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    wait_for(lambda: (tmp_path / 'retrieval' / 'bag').exists() and len(children_of(child.pid)) == 2)
    nodes = children_of(child.pid)
    child.send_signal(signal.SIGTERM)
    _, err = child.communicate(timeout=20)
    assert child.returncode != 0
    assert b'Traceback' not in err
    assert isinstance(list(read(tmp_path / 'retrieval' / 'bag')), list)
    assert not [pid for pid in nodes if alive(pid)]


def test_a_node_that_fails_is_shown(tmp_path, monkeypatch):
    monkeypatch.setitem(PACKAGES, 'planner', 'orbimpc_ros.none')
    done = ran_here('demo', '--out', tmp_path)
    assert done.returncode == 1
    assert 'No module named orbimpc_ros.none' in done.stderr
    assert done.stderr.splitlines()[-1].startswith('orbimpc: ')
    assert 'tool/cli.py' not in done.stderr  # the node's own traceback, not the tool's


def test_a_disk_that_is_full_fails_the_job_in_one_line(tmp_path):
    """A limit on file sizes, below the size of the bag, stands in for a full disk."""
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, usual[1]))
    try:
        done = ran_here('demo', 'retrieval', '--out', tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == 'orbimpc: output: file too large'
    assert 'Traceback' not in done.stderr


def test_results_are_never_overwritten(tmp_path):
    names = [demo.new_folder(str(tmp_path / 'new'), 'retrieval').name for _ in range(3)]
    assert names == ['retrieval', 'retrieval-2', 'retrieval-3']


# --- a fleet: two processes per namespace, with one clock, in one bag


NAMES = ('/uav1', '/uav2')


@pytest.fixture(scope='module')
def fleet(tmp_path_factory):
    """Return the result of a fleet of two, at twice the usual speed, and its folder."""
    out = tmp_path_factory.mktemp('fleet')
    words = ('--vehicles', 2, '--set=forward=2', '--set=autostart=false', '--out', out)
    return ran_here('demo', 'fleet', *words), out / 'fleet'


def test_the_clock_of_a_fleet_waits_for_every_command():
    """A slow planner only makes the flight take longer: no vehicle flies without a command."""
    sent: list = []
    node = SimpleNamespace(
        create_publisher=lambda *_: SimpleNamespace(publish=sent.append),
        create_timer=lambda *_: None,
    )
    recorder = SimpleNamespace(latest={}, node=node)
    clock = demo.Pacer(recorder, 10.0, 0.5)
    for uav1, uav2 in ((None, None), (10.0, None), (10.0, None), (10.0, 10.0), (10.5, 10.0)):
        stamps = {'/uav1/cmd_vel': uav1, '/uav2/cmd_vel': uav2}
        recorder.latest |= {k: round(v * SECOND) for k, v in stamps.items() if v is not None}
        clock.look(NAMES)
    clock.look(NAMES[:1])  # the other vehicle has landed
    assert demo._progress(72, {'max_ticks': 60}, {}) == 'tick 60 of at most 60'
    stamps = [bags.seconds(each) for each in sent]
    assert stamps == [10.0, 10.5, 11.0]


def test_every_rope_is_caught(fleet):
    done, folder = fleet
    assert done.returncode == 0, done.stdout + done.stderr
    rows = dict(line.split(maxsplit=1) for line in done.stdout.splitlines()[1:])
    for name in ('uav1', 'uav2'):
        assert rows[name].startswith('captured at t = ')
    check_pictures(folder, 'trajectory.png')


def test_one_bag_holds_every_vehicle_from_its_first_step_on(fleet):
    _, folder = fleet
    for name in NAMES:
        seen = history.of_bag(folder / 'bag', name)
        start = vehicles('fleet', 2)[name]['start.position']
        assert np.allclose(seen.positions[0], start)
        assert seen.values['forward'] == 2.0
        assert seen.values['rope.center'] == vehicles('fleet', 2)[name]['rope.center']
        assert np.ptp(np.diff(seen.times)) < 1.0
        assert seen.captured


def test_bodies_of_a_fleet_have_frames_of_their_own_in_one_world(fleet):
    """They share one /tf; planners take odometry in their vehicle's frame, and command in it."""
    found = {}
    for topic, content in ((each.topic, each.content) for each in read(fleet[1] / 'bag')):
        if topic.endswith(('/odom', '/cmd_vel')):
            frame = getattr(content, 'child_frame_id', content.header.frame_id)
            found.setdefault(topic, set()).add(frame)
    topics = ('odom', 'cmd_vel')
    assert found == {f'{ns}/{topic}': {f'{ns[1:]}/base_link'} for ns in NAMES for topic in topics}


def test_ropes_are_drawn_from_the_seed_alone():
    assert vehicles('fleet', 3) != vehicles('fleet', 3, seed=1)
    with pytest.raises(BadInput):
        vehicles('fleet', 3, seed=-1)
    few, many = vehicles('fleet', 3), vehicles('fleet', 8)
    assert all(few[n][p] == many[n][p] for n in few for p in ('rope.frequency', 'rope.phase'))
    frequencies = {each['rope.frequency'] for each in many.values()}
    assert len(frequencies) == 8
    assert vehicles('fleet', 2, 2**31 - 1)['/uav1']['seed'] == 0  # the seed after the largest one
    assert all(0.02 <= frequency <= 0.3 for frequency in frequencies)


def test_what_is_set_holds_for_every_vehicle_and_the_rest_is_read_back_by_namespace():
    values, own = demo.fleet(3, ['rope.frequency = 0.25', 'seed=7'])
    assert values['rope.frequency'] == 0.25
    text = settings.text(values, own)
    for name, drawn in vehicles('fleet', 3, 7).items():
        assert own[name] == {k: each for k, each in drawn.items() if k != 'rope.frequency'}
        assert settings.read(files.parse(text, name), name, name) == values | own[name]


def test_a_collision_is_called_one(capsys):
    ways = {'/uav1': [[-1.0, 0.0], [1.0, 0.0]], '/uav2': [[0.0, -1.0], [0.0, 1.1]]}
    fleet = {
        name: SimpleNamespace(
            values={'avoid_radius': 1.0}, times=np.array([0.0, 2.0]), positions=np.array(way)
        )
        for name, way in ways.items()
    }
    assert not demo.clearance(fleet)
    assert 'COLLISION     /uav1 and /uav2 within 0.0' in capsys.readouterr().out
    fleet['/uav2'].times += 5.0
    assert demo.clearance(fleet)
