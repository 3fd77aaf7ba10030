# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A fleet over DDS: pairs of processes in namespaces, with one clock, in one bag."""

import itertools
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from bags import check_pictures

from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.sim.fleet import vehicles
from orbimpc_ros.tool import bags, demo, history, settings
from orbimpc_ros.tool.run import flying

pytest.importorskip('rclpy')
NAMES = ('/uav1', '/uav2')


def run(*words):
    command = [sys.executable, '-m', 'orbimpc_ros.tool.cli', 'demo', 'fleet', *words]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope='module')
def flown(tmp_path_factory):
    """Return the finished process of a fleet of two, twice as fast as usual, and its folder."""
    out = tmp_path_factory.mktemp('fleet')
    return run('--vehicles', '2', '--set', 'forward=2', '--out', str(out)), out / 'fleet'


def test_the_clock_of_a_fleet_waits_for_every_command(monkeypatch):
    """However long one takes: a slow machine makes a flight long, and nobody flies blind."""
    wall, sent = itertools.count(), []  # a second passes between two looks
    monkeypatch.setattr(flying, 'time', SimpleNamespace(monotonic=lambda: float(next(wall))))
    recorder = SimpleNamespace(latest={}, publish_clock=sent.append)
    clock = flying.Pacer(recorder, 10.0, 0.5)
    for uav1, uav2 in ((None, None), (10.0, None), (10.0, None), (10.0, 10.0), (10.5, 10.0)):
        stamps = {'/uav1/cmd_vel': uav1, '/uav2/cmd_vel': uav2}
        recorder.latest |= {k: round(v * SECOND) for k, v in stamps.items() if v is not None}
        clock.look(NAMES)
    assert sent == [10.0, 10.0, 10.0, 10.5, 10.5]
    clock.look(NAMES[:1])  # the other one has landed
    assert sent[-1] == 11.0
    monkeypatch.setattr(flying, 'time', SimpleNamespace(monotonic=lambda: 200.0))
    with pytest.raises(OrbimpcError, match='/uav1, /uav2: no command for'):
        clock.look(NAMES)


def test_every_rope_is_caught(flown):
    done, folder = flown
    assert done.returncode == 0, done.stdout + done.stderr
    rows = dict(line.split(maxsplit=1) for line in done.stdout.splitlines()[1:])
    assert rows['captured'] == '2 of 2'
    for name in ('uav1', 'uav2'):
        assert rows[name].startswith('t = ')
    check_pictures(folder, 'trajectory.png')


def test_one_bag_holds_every_vehicle_from_its_first_step_on(flown):
    _, folder = flown
    for name in NAMES:
        seen = history.of_bag(folder / 'bag', name)
        start = vehicles(2)[name]['start.position']
        assert np.allclose(seen.positions[0], start)
        assert seen.values['forward'] == 2.0
        assert seen.values['rope.center'] == vehicles(2)[name]['rope.center']
        assert np.ptp(np.diff(seen.times)) < 1.0
        assert seen.captured


def test_bodies_of_a_fleet_have_frames_of_their_own_in_one_world(flown):
    """As on the one /tf; planners obey, and answer in the frame of their vehicle."""
    found = {}
    for topic, content in ((each.topic, each.content) for each in bags.read(flown[1] / 'bag')):
        if topic.endswith(('/odom', '/cmd_vel')):
            frame = getattr(content, 'child_frame_id', content.header.frame_id)
            found.setdefault(topic, set()).add(frame)
    topics = ('odom', 'cmd_vel')
    assert found == {f'{ns}/{topic}': {f'{ns[1:]}/base_link'} for ns in NAMES for topic in topics}


def test_ropes_are_drawn_from_the_seed_alone():
    assert vehicles(3) == vehicles(3)
    assert vehicles(3) != vehicles(3, seed=1)
    few, many = vehicles(3), vehicles(8)
    for name, one in few.items():
        for drawn in ('rope.frequency', 'rope.phase'):
            assert one[drawn] == many[name][drawn]
    frequencies = {each['rope.frequency'] for each in many.values()}
    assert len(frequencies) == 8
    assert vehicles(2, 2**31 - 1)['/uav1']['seed'] == 0  # the largest there is, and on
    assert all(0.02 <= frequency <= 0.3 for frequency in frequencies)


def test_what_is_set_holds_for_every_vehicle():
    values, own = demo.fleet(3, ['rope.frequency=0.25', 'seed=7'])
    assert values['rope.frequency'] == 0.25
    assert all('rope.frequency' not in each for each in own.values())
    assert own == {
        name: {key: value for key, value in each.items() if key != 'rope.frequency'}
        for name, each in vehicles(3, 7).items()
    }
    with pytest.raises(BadInput, match='clock'):
        demo.fleet(3, ['clock=lockstep'])


def test_a_fleets_parameters_are_read_back_by_namespace():
    values, own = demo.fleet(3, [])
    text = settings.text(values, own)
    for name, each in own.items():
        read = settings.read(text, name)
        assert read['rope.center'] == each['rope.center']
        assert read == values | each


def test_a_collision_is_called_one(capsys):
    ways = {'/uav1': [[-1.0, 0.0], [1.0, 0.0]], '/uav2': [[0.0, -1.0], [0.0, 1.1]]}
    flown = {
        name: SimpleNamespace(
            values={'avoid_radius': 1.0}, times=np.array([0.0, 2.0]), positions=np.array(way)
        )
        for name, way in ways.items()
    }
    assert not demo.clearance(flown)
    assert 'COLLISION     /uav1 and /uav2 within 0.0' in capsys.readouterr().out
    flown['/uav2'].times += 5.0
    assert demo.clearance(flown)
