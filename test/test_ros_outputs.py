# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What a planner publishes for whom: topics by its settings, and thrust as autopilots count it."""

import itertools

import numpy as np
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import PoseStamped, Vector3Stamped
from nav_msgs.msg import Odometry

from orbimpc_ros.mpc.command import Command
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Frames, Stamp, header
from orbimpc_ros.ros.parameters.planner import PLANNER, planner_settings
from orbimpc_ros.ros.planner.description import summary
from orbimpc_ros.ros.planner.outputs import command_messages, outputs

CRAFT = {
    'dimension': 3,
    'translation_order': 2,
    'thrust_axis': 'z',
    'forward': 16.35,  # the weight is 0.6 of full thrust
    'gravity': 9.81,
    'mass': 1.5,
}
STAMP = Stamp(7, Frames('odom', 'base_link', 'z'))


def settings(**given):
    return planner_settings({**{row.name: row.default for row in PLANNER}, **given})


def told(fraction, **given):
    command = Command(fraction, np.array([0.1, 0.2, 0.3]), np.eye(3))
    return command_messages(settings(**CRAFT, **given), STAMP, command)


def test_topics_follow_from_what_the_vehicle_takes():
    reports = {'plan', 'plan_markers', 'tick'}
    drive = {*reports, 'cmd_vel', 'rotation'}
    assert set(outputs(settings(publish_certificate=True))) == {*drive, 'certificate'}
    assert set(outputs(settings())) == drive
    assert set(outputs(settings(**CRAFT))) == {*drive, 'cmd_thrust'}
    assert set(outputs(settings(**CRAFT, hover_thrust=0.4))) == {*drive, 'cmd_thrust', 'thrust'}
    assert set(outputs(settings(**CRAFT, hover_thrust=0.4, dry_run=True))) == reports


@pytest.mark.parametrize('hover', [0.25, 0.4, 0.6])
def test_thrust_is_the_share_at_hover_when_it_carries_the_weight_and_in_proportion(hover):
    found = told(0.6, hover_thrust=hover)
    assert found['thrust'].vector.z == pytest.approx(hover)
    assert found['cmd_thrust'].wrench.force.z == pytest.approx(1.5 * 9.81)
    assert found['thrust'].header == found['cmd_thrust'].header == header(7, 'base_link')
    assert told(0.3, hover_thrust=hover)['thrust'].vector.z == pytest.approx(0.5 * hover)
    assert told(1.0, hover_thrust=hover)['thrust'].vector.z <= 1.0
    assert 'thrust' not in told(0.6)


def test_a_share_that_full_thrust_would_exceed_is_refused():
    with pytest.raises(
        BadInput, match=r'hover_thrust is 0\.61; allowed: at most gravity / forward'
    ):
        settings(**CRAFT, hover_thrust=0.61)
    with pytest.raises(BadInput, match=r'hover_thrust is 0\.4; allowed: 0 without gravity'):
        settings(hover_thrust=0.4)


def test_the_start_up_line_says_the_share():
    assert 'told as 0.4 on thrust' in summary(settings(**CRAFT, hover_thrust=0.4), False)


def test_a_planner_says_thrust_with_every_command(launch, observer):
    node, shares = observer.node, observer.listen(Vector3Stamped, 'thrust')
    senders = [node.create_publisher(Odometry, 'odom', 1)]
    senders.append(node.create_publisher(PoseStamped, 'goal', 1))
    given = {'step': 0.1, 'trigger': 'odom', 'odom_timeout': 60.0, 'hover_thrust': 0.4}
    planner = launch('planner', {**CRAFT, **given})
    observer.until_connected('thrust')
    stamps = (k * 10**8 for k in itertools.count(1))

    def step():
        stamp = next(stamps)
        place = messages.pose(np.zeros(3), np.eye(3))
        odometry = Odometry(header=header(stamp, 'odom'), child_frame_id='base_link')
        odometry.pose.pose = place
        senders[0].publish(odometry)
        senders[1].publish(PoseStamped(header=header(stamp, 'odom'), pose=place))
        return bool(shares)

    observer.until(step, 'a share')
    assert 0.0 <= shares[0].vector.z <= 1.0
    assert planner.stop() == 0
