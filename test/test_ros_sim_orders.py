# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The commands that a simulated vehicle obeys, and those that it refuses."""

import math

import numpy as np
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import TwistStamped, WrenchStamped

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Frames, Stamp
from orbimpc_ros.sim.commands import Orders
from orbimpc_ros.sim.vehicle import Model

NOW = 5_000_000_000  # [ns]
FRAMES = Frames('odom', 'base_link')


def at(stamp=NOW):
    return Stamp(stamp, FRAMES)


def twist(speed, rate, stamp=NOW):
    return messages.twist_message(at(stamp), speed, np.atleast_1d(rate))


def test_orders_join_twist_and_force_of_one_stamp():
    orders = Orders(Model(2, 1, 2, forward=2.0, mass=3.0), FRAMES)
    assert not orders.take_twist(twist(0.0, 0.3), NOW)
    assert not orders.take_force(messages.wrench_message(at(NOW + 1), 3.0), NOW)
    assert orders.latest is None
    assert orders.take_twist(twist(0.0, 0.4, NOW + 1), NOW)
    assert orders.latest.stamp == NOW + 1
    assert orders.latest.fraction == pytest.approx(0.5)
    np.testing.assert_array_equal(orders.latest.body_rate, [0.4])


def test_a_vehicle_that_pushes_along_z_takes_what_is_along_z():
    frames = Frames('odom', 'base_link', 'z')
    rate = np.array([0.1, -0.2, 0.3])
    sent = Stamp(NOW, frames)
    orders = Orders(Model(3, 1, 1, forward=2.0), frames)
    message = messages.twist_message(sent, 1.0, rate)
    assert message.twist.linear.z == 1.0
    assert orders.take_twist(message, NOW)
    assert orders.latest.fraction == pytest.approx(0.5)
    np.testing.assert_allclose(orders.latest.body_rate, rate, atol=1e-15)
    with pytest.raises(BadInput, match=r'twist\.linear\.z'):
        orders.take_twist(messages.twist_message(sent, 2.1, rate), NOW)
    pulled = Orders(Model(3, 1, 2, forward=2.0, mass=3.0), frames)
    pulled.take_twist(messages.twist_message(sent, 0.0, rate), NOW)
    force = messages.wrench_message(sent, 3.0)
    assert force.wrench.force.z == 3.0
    assert pulled.take_force(force, NOW)
    assert pulled.latest.fraction == pytest.approx(0.5)


def test_a_twist_alone_is_an_order_at_translation_order_1():
    orders = Orders(Model(forward=2.0, step=0.5), FRAMES)
    for speed, rate in ((0.0, 0.0), (2.0, 2 * math.pi), (-1e-4, -2 * math.pi)):
        assert orders.take_twist(twist(speed, rate), NOW)
        assert orders.latest.fraction == pytest.approx(speed / 2.0)


@pytest.mark.parametrize(
    ('speed', 'rate', 'stamp', 'culprit'),
    [
        (2.1, 0.0, NOW, r'twist\.linear\.x'),
        (-0.1, 0.0, NOW, r'twist\.linear\.x'),
        (math.nan, 0.0, NOW, r'twist\.linear'),
        (1.0, 6.3, NOW, r'twist\.angular'),
        (1.0, -6.3, NOW, r'twist\.angular'),
        (1.0, math.inf, NOW, r'twist\.angular'),
        (1.0, 0.0, NOW + 1_100_000_000, r'header\.stamp'),
    ],
)
def test_what_is_beyond_the_vehicle_is_refused(speed, rate, stamp, culprit):
    orders = Orders(Model(forward=2.0, step=0.5), FRAMES)
    with pytest.raises(BadInput, match=culprit):
        orders.take_twist(twist(speed, rate, stamp), NOW)
    assert orders.latest is None


@pytest.mark.parametrize('force', [6.1, -0.1])
def test_a_force_beyond_full_thrust_is_refused(force):
    orders = Orders(Model(2, 1, 2, forward=2.0, mass=3.0), FRAMES)
    with pytest.raises(BadInput, match=r'wrench\.force\.x'):
        orders.take_force(messages.wrench_message(at(), force), NOW)
    with pytest.raises(BadInput, match=r'header\.stamp'):
        orders.take_force(messages.wrench_message(at(2 * NOW), 1.0), NOW)


def test_malformed_commands_are_refused():
    orders = Orders(Model(2, 1, 2), FRAMES)
    bad, wrench = TwistStamped(), WrenchStamped()
    bad.twist.angular.z = math.nan
    wrench.wrench.torque.y = math.inf
    with pytest.raises(BadInput, match=r'twist\.angular'):
        orders.take_twist(bad, NOW)
    with pytest.raises(BadInput, match=r'wrench\.torque'):
        orders.take_force(wrench, NOW)
    assert orders.latest is None
