# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Messages and plain types: what goes out comes back, and nothing malformed gets in."""

import math
from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Frames, Stamp
from orbimpc_ros.sim.vehicle import Model, launched, measured

FRAMES = Frames('odom', 'base_link')
STAMP = Stamp(1_700_000_000_123_456_789, FRAMES)


def odometry_message(n=2, rng=None):
    rng = rng or np.random.default_rng(1)
    model = Model(n, translation_order=2)
    vehicle = launched(
        model,
        rng.normal(size=n),
        exp(rng.normal(size=model.rates)),
        velocity=rng.normal(size=n),
        body_rate=rng.normal(size=model.rates),
    )
    return messages.odometry_message(STAMP, measured(vehicle)), vehicle


def goal_message():
    return messages.goal_message(STAMP, np.array([5.0, 1.0]))


def path_message():
    return messages.goal_path_message(STAMP, 0.5, list(np.arange(8.0).reshape(4, 2)))


@pytest.mark.parametrize('n', [2, 3])
def test_odometry_comes_back(n):
    for seed in range(20):
        message, vehicle = odometry_message(n, np.random.default_rng(seed))
        stamp, odometry = messages.read_odometry(message, n, FRAMES)
        assert stamp == STAMP
        lies_flat = message.pose.pose.position.z == message.pose.pose.orientation.x == 0.0
        assert lies_flat == (n == 2)
        meant = measured(vehicle)
        for name in ('position', 'attitude', 'body_velocity', 'body_rate'):
            got, wanted = getattr(odometry, name), getattr(meant, name)
            np.testing.assert_allclose(got, wanted, atol=1e-12, err_msg=name)


def test_a_body_that_pushes_along_z_is_turned_on_the_way_in_and_back_on_the_way_out():
    for seed in range(20):
        message, vehicle = odometry_message(3, np.random.default_rng(seed))
        stamp, odometry = messages.read_odometry(message, 3, replace(FRAMES, thrust_axis='z'))
        own, twist = vehicle.attitude, message.twist.twist
        np.testing.assert_allclose(odometry.attitude[:, 0], own[:, 2], atol=1e-12)
        along = [twist.linear.z, twist.linear.y, -twist.linear.x]
        np.testing.assert_allclose(odometry.body_velocity, along, atol=1e-12)
        # What a body sees of the world is the same, whatever its axes are called.
        turning = odometry.attitude @ odometry.body_rate
        meant = measured(vehicle)
        np.testing.assert_allclose(turning, own @ meant.body_rate, atol=1e-12)
        again = messages.odometry_message(stamp, odometry)
        for part in ('pose.pose.orientation', 'twist.twist.linear', 'twist.twist.angular'):
            for axis in 'xyz':
                wanted = attrgetter(f'{part}.{axis}')(message)
                assert attrgetter(f'{part}.{axis}')(again) == pytest.approx(wanted, abs=1e-12)
        command = Command(0.5, np.zeros(3), odometry.attitude)
        sent = messages.rotation_message(stamp, command).quaternion
        same = messages.quaternion(own)
        for axis in 'wxyz':
            assert getattr(sent, axis) == pytest.approx(getattr(same, axis), abs=1e-9)


def test_goals_come_back():
    stamp, sighting = messages.read_sighting(goal_message(), 2, FRAMES)
    assert stamp.nanoseconds == STAMP.nanoseconds
    np.testing.assert_array_equal(sighting.position, [5.0, 1.0])
    _, itinerary = messages.read_itinerary(path_message(), 2, FRAMES)
    np.testing.assert_array_equal(itinerary.positions, np.arange(8.0).reshape(4, 2))
    np.testing.assert_allclose(np.diff(itinerary.times), 0.5, atol=1e-6)


def set_at(message, path, value):
    *parents, last = path.split('.')
    for name in parents:
        message = message[int(name)] if name.isdigit() else getattr(message, name)
    setattr(message, last, value)


NAN, INF = math.nan, math.inf
REFUSED = [
    (odometry_message, 'header.stamp.sec', -1),
    (odometry_message, 'header.stamp.nanosec', 10**9),
    (odometry_message, 'header.frame_id', 'map'),
    (odometry_message, 'child_frame_id', ''),
    (odometry_message, 'pose.pose.position.x', NAN),
    (odometry_message, 'pose.pose.position.z', NAN),
    (odometry_message, 'pose.pose.position.y', 1e300),
    (odometry_message, 'pose.pose.orientation.w', NAN),
    (odometry_message, 'pose.pose.orientation.w', 1e200),
    (odometry_message, 'pose.pose.orientation.x', 0.5),
    (odometry_message, 'twist.twist.linear.x', -INF),
    (odometry_message, 'twist.twist.angular.x', NAN),
    (odometry_message, 'twist.twist.angular.z', INF),
    (goal_message, 'header.stamp.sec', -(2**31)),
    (goal_message, 'header.frame_id', 'm' * 100_000),
    (goal_message, 'pose.position.x', INF),
    (goal_message, 'pose.orientation.w', 0.0),
    (path_message, 'header.frame_id', 'map'),
    (path_message, 'poses', []),
    (path_message, 'poses', [PoseStamped()] * (messages.LONGEST_PATH + 1)),
    (path_message, 'poses.2.pose.position.y', NAN),
    (path_message, 'poses.2.header.stamp.sec', 0),
    (path_message, 'poses.1.header.stamp.nanosec', 2**32 - 1),
]
READ = {
    OdometryMessage: messages.read_odometry,
    PoseStamped: messages.read_sighting,
    Path: messages.read_itinerary,
}


@pytest.mark.parametrize(('make', 'field', 'value'), REFUSED)
def test_a_malformed_message_is_refused_in_one_line(make, field, value):
    made = make()
    message = made[0] if isinstance(made, tuple) else made
    set_at(message, field, value)
    with pytest.raises(BadInput) as refusal:
        READ[type(message)](message, 2, FRAMES)
    assert '\n' not in str(refusal.value)
    assert len(str(refusal.value)) < 300
    assert 'allowed' in str(refusal.value)


@pytest.mark.parametrize('scale', [0.9995, 1.0005])
def test_a_quaternion_almost_of_unit_length_is_normalised(scale):
    message, vehicle = odometry_message(3)
    for name in 'xyzw':
        turned = message.pose.pose.orientation
        setattr(turned, name, scale * getattr(turned, name))
    _, odometry = messages.read_odometry(message, 3, FRAMES)
    np.testing.assert_allclose(odometry.attitude, vehicle.attitude, atol=1e-9)


def test_a_vertical_vehicle_has_no_yaw():
    message, _ = odometry_message(2)
    upright = message.pose.pose.orientation
    upright.x, upright.y, upright.z, upright.w = 0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)
    with pytest.raises(BadInput, match='yaw'):
        messages.read_odometry(message, 2, FRAMES)


def test_an_empty_frame_parameter_accepts_any():
    message, _ = odometry_message()
    message.header.frame_id, message.child_frame_id = 'map', 'r2/base'
    stamp, _ = messages.read_odometry(message, 2, Frames())
    assert stamp.frames == Frames('map', 'r2/base')


def test_covariances_are_not_read():
    """Many drivers mean "unknown" by NaN there."""
    message, vehicle = odometry_message()
    message.pose.covariance[:] = np.full(36, np.nan)
    message.twist.covariance[:] = np.full(36, np.inf)
    _, read = messages.read_odometry(message, 2, FRAMES)
    np.testing.assert_allclose(read.position, vehicle.position)
