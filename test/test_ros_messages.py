# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Messages and plain types: round trips, and refusals of malformed messages."""

import itertools
import math
from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, Quaternion, TwistStamped, TwistWithCovarianceStamped
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from planners import FRAMES, settings
from stepping import launched

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import (
    APART,
    SECOND,
    Frames,
    PoseTwistSynchronizer,
    Stamp,
    header,
    read_odometry,
)
from orbimpc_ros.sim.vehicle import Model, measured

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
    return messages.path_message(STAMP, 0.5, map(messages.pose, list(np.arange(8.0).reshape(4, 2))))


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
        # Body rates in world axes do not depend on how the body's axes are named.
        turning = odometry.attitude @ odometry.body_rate
        meant = measured(vehicle)
        np.testing.assert_allclose(turning, own @ meant.body_rate, atol=1e-12)
        again = messages.odometry_message(stamp, odometry)
        for part in ('pose.pose.orientation', 'twist.twist.linear', 'twist.twist.angular'):
            for axis in 'xyz':
                wanted = attrgetter(f'{part}.{axis}')(message)
                assert attrgetter(f'{part}.{axis}')(again) == pytest.approx(wanted, abs=1e-12)
        command = Command(0.5, np.zeros(3), odometry.attitude)
        sent = dict(messages.command_messages(settings(), stamp, command))['rotation'].quaternion
        same = messages.quaternion(own)
        for axis in 'wxyz':
            assert getattr(sent, axis) == pytest.approx(getattr(same, axis), abs=1e-9)


def set_at(message, path, value):
    *parents, last = path.split('.')
    for name in parents:
        message = message[int(name)] if name.isdigit() else getattr(message, name)
    setattr(message, last, value)


NAN, INF = math.nan, math.inf
UPRIGHT = Quaternion(y=math.sqrt(0.5), w=math.sqrt(0.5))  # x is vertical: no yaw
REFUSED = [
    (odometry_message, 'header.stamp.sec', -1),
    (odometry_message, 'header.stamp.nanosec', 10**9),
    *((odometry_message, 'header.frame_id', name) for name in ('map', '')),
    (odometry_message, 'child_frame_id', ''),
    *((odometry_message, f'pose.pose.position.{axis}', NAN) for axis in 'xz'),
    (odometry_message, 'pose.pose.position.y', 1e300),
    *((odometry_message, 'pose.pose.orientation.w', each) for each in (NAN, 1e200)),
    (odometry_message, 'pose.pose.orientation.x', 0.5),
    *((odometry_message, 'pose.pose.orientation', q) for q in (UPRIGHT, Quaternion(x=1.0, w=0.0))),
    (odometry_message, 'twist.twist.linear.x', -INF),
    (odometry_message, 'twist.twist.angular.x', NAN),
    (odometry_message, 'twist.twist.angular.z', INF),
    (goal_message, 'header.stamp.sec', -(2**31)),
    (goal_message, 'header.frame_id', 'm' * 100_000),
    (goal_message, 'pose.position.x', INF),
    (goal_message, 'pose.orientation.w', 0.0),
    (path_message, 'header.frame_id', 'map'),
    *((path_message, 'poses', count * [PoseStamped()]) for count in (0, 1 + messages.LONGEST_PATH)),
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


def test_an_empty_frame_parameter_accepts_any():
    message, _ = odometry_message()
    message.header.frame_id, message.child_frame_id = 'map', 'r2/base'
    stamp, _ = messages.read_odometry(message, 2, Frames())
    assert stamp.frames == Frames('map', 'r2/base')


def test_a_wind_has_a_variance_if_that_is_known_along_both_axes():
    wind = TwistWithCovarianceStamped()
    wind.twist.covariance[[0, 7]] = 5.0, -1.0
    assert math.isnan(messages.read_wind(wind, 2, FRAMES)[1].variance)


# --- odometry in two messages: which twist belongs to a pose


def pose(milliseconds, attitude=None):
    head = header(milliseconds * SECOND // 1000, 'map')
    return PoseStamped(header=head, pose=messages.pose(np.zeros(3), attitude or np.eye(3)))


def twist(milliseconds):
    """Return a twist whose speed identifies it: its stamp [ms]."""
    message = TwistStamped(header=header(milliseconds * SECOND // 1000, 'base_link'))
    message.twist.linear.x = float(milliseconds)
    return message


def joined(*halves):
    """Return the stamps of pose and twist in each odometry made of halves [ms]."""
    made, found = PoseTwistSynchronizer(), []
    for each in halves:
        took = made.take('pose' if isinstance(each, PoseStamped) else 'twist', each)
        if took is not None:
            at = messages.nanoseconds(took.header.stamp, '') // 1_000_000
            found.append((at, round(took.twist.twist.linear.x)))
            assert (took.header.frame_id, took.child_frame_id) == ('map', 'base_link')
    return found


@pytest.mark.parametrize('order', [*itertools.product([False, True], repeat=3)])
def test_halves_of_one_stamp_belong_together_in_any_order(order):
    sent = []
    for k, twist_first in enumerate(order):
        both = [pose(1000 + 20 * k), twist(1000 + 20 * k)]
        sent += reversed(both) if twist_first else both
    assert joined(*sent) == [(1000 + 20 * k,) * 2 for k in range(3)]


@pytest.mark.parametrize(
    ('sent', 'made'),
    [
        (
            [twist(995), pose(1000), twist(1005), pose(1020), pose(1030)],
            [(1000, 995), (1020, 1005), (1030, 1005)],
        ),
        ([pose(1000), twist(1005), pose(1020)], [(1000, 1005), (1020, 1005)]),
        # A pose without its twist is dropped; one that comes twice is refused later, with reason.
        (
            [twist(1000), pose(1000), pose(1020), pose(1040), twist(1040)],
            [(1000, 1000), (1040, 1040)],
        ),
        ([twist(1000), pose(1000), pose(1000), twist(1000)], [(1000, 1000)] * 2),
        # Equal stamps that end, such as zeros before a clock starts, do not bind those after them.
        (
            [pose(0), twist(0)]
            + [m for k in range(1000, 1130, 10) for m in (twist(k - 5), pose(k))],
            [(0, 0), (1100, 1095), (1110, 1105), (1120, 1115)],
        ),
    ],
)
def test_where_stamps_differ_a_pose_goes_with_the_last_twist(sent, made):
    assert joined(*sent) == made


def test_halves_too_far_apart_and_a_stamp_that_is_none_are_refused():
    halves, unstamped = PoseTwistSynchronizer(), pose(1000)
    unstamped.header.stamp.nanosec = SECOND
    with pytest.raises(BadInput, match=r'pose\.header\.stamp'):
        halves.take('pose', unstamped)
    halves.take('twist', twist(1000))
    with pytest.raises(BadInput, match=r'twist.header.stamp.*0.101 s from that of pose'):
        halves.take('pose', pose(1001 + APART // 1_000_000))


@pytest.mark.parametrize(('dimension', 'axis'), [(2, 'x'), (3, 'x'), (3, 'z')])
def test_a_velocity_of_the_world_is_turned_into_the_body(dimension, axis):
    rng = np.random.default_rng(dimension)
    turn = rng.normal(size=3) * ([0, 0, 1] if dimension == 2 else [1, 1, 1])
    own, velocity = exp(turn), rng.normal(size=3)
    message = messages.OdometryMessage(header=header(SECOND, 'odom'), child_frame_id='base_link')
    message.pose.pose = messages.pose(np.zeros(3), own)
    message.twist.twist.angular.z = 0.3
    message.twist.twist.linear = messages.vector(own.T @ velocity)
    _, told_in_body = read_odometry(message, dimension, Frames(thrust_axis=axis))
    message.twist.twist.linear = messages.vector(velocity)
    message.child_frame_id = 'odom'  # ignored
    frames = Frames('odom', 'base_link', axis, velocity='world')
    stamp, told_in_world = read_odometry(message, dimension, frames)
    np.testing.assert_allclose(told_in_world.body_velocity, told_in_body.body_velocity, atol=1e-12)
    np.testing.assert_array_equal(told_in_world.body_rate, told_in_body.body_rate)
    assert stamp.frames.body == 'base_link'  # for commands
