# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The demos beside the retrieval, end to end: real processes over DDS, numbers, bags, pictures."""

from typing import NamedTuple

import numpy as np
import pytest
from bags import check_pictures, check_rollout, messages_of
from harness import orbimpc

from orbimpc_ros.tool import cli

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
    shown, done = DEMOS[name], orbimpc('demo', name, '--out', tmp_path)
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
    words = [word for each in changes for word in ('--set', each)]
    done = orbimpc('demo', name, '--out', tmp_path, *words)
    assert done.returncode == 1, done.stdout + done.stderr
    assert end in done.stdout
    assert 'Traceback' not in done.stderr
    assert (tmp_path / name / 'trajectory.png').is_file()
