# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What a planner publishes for whom: topics by its settings, and thrust as autopilots count it."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from planners import settings

from orbimpc_ros.mpc.command import Command
from orbimpc_ros.ros.messages import Frames, Stamp, header
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
