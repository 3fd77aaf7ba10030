# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Odometry in two halves: which twist a pose goes with, and what is refused."""

import itertools

import numpy as np
import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import PoseStamped, TwistStamped

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import (
    APART,
    SECOND,
    Frames,
    PoseTwistSynchronizer,
    header,
    read_odometry,
)


def pose(milliseconds, attitude=None):
    head = header(milliseconds * SECOND // 1000, 'map')
    return PoseStamped(header=head, pose=messages.pose(np.zeros(3), attitude or np.eye(3)))


def twist(milliseconds):
    """A twist whose speed is its time, by which it is known again."""
    message = TwistStamped(header=header(milliseconds * SECOND // 1000, 'base_link'))
    message.twist.linear.x = float(milliseconds)
    return message


def joined(*halves):
    """The stamps of odometry made of halves, as pairs of milliseconds: of its pose and twist."""
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
        # A pose without its twin is left out, and one that comes twice is one measurement.
        (
            [twist(1000), pose(1000), pose(1020), pose(1040), twist(1040)],
            [(1000, 1000), (1040, 1040)],
        ),
        ([twist(1000), pose(1000), pose(1000), twist(1000)], [(1000, 1000)]),
    ],
)
def test_where_stamps_differ_a_pose_goes_with_the_last_twist(sent, made):
    assert joined(*sent) == made


def test_halves_too_far_apart_are_refused():
    halves = PoseTwistSynchronizer()
    halves.take('twist', twist(1000))
    with pytest.raises(BadInput, match=r'twist.header.stamp.*0.101 s from that of pose'):
        halves.take('pose', pose(1001 + APART // 1_000_000))


def test_a_stamp_that_is_none_is_refused():
    halves, message = PoseTwistSynchronizer(), pose(1000)
    message.header.stamp.nanosec = SECOND
    with pytest.raises(BadInput, match=r'pose\.header\.stamp'):
        halves.take('pose', message)


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
    message.child_frame_id = 'odom'  # whatever it says
    frames = Frames('odom', 'base_link', axis, velocity='world')
    stamp, told_in_world = read_odometry(message, dimension, frames)
    np.testing.assert_allclose(told_in_world.body_velocity, told_in_body.body_velocity, atol=1e-12)
    np.testing.assert_array_equal(told_in_world.body_rate, told_in_body.body_rate)
    assert stamp.frames.body == 'base_link'  # of the commands
