# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The stimulus of a planner: a healthy vehicle and goal, and corruptions of their messages.

Run with ``python -m`` and a rate [Hz], this module publishes odometry at this rate until killed.
"""

from __future__ import annotations

import copy
import math
import random
import sys
import time
from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from harness import Observer
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message

from orbimpc_ros.loop.compensation import Odometry as Measured
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND, Frames, Stamp
from orbimpc_ros.ros.process import qos

FRAMES = Frames('odom', 'base_link')
RADIUS = 3.0  # [m] of the circle that the vehicle flies
SPEED = 0.8  # [m/s]
HUGE = 1_000_000  # characters
AT_ONCE = 0.1  # [s] of delay that a flood makes up for, at most
SLIP = 5.0  # [m/s] sideslip, on which the modified planner raises an exception

# Maps a message to its replacements: other messages, none, or invalid bytes.
Spoiler = Callable[[Any, random.Random], list[Any]]


def odometry_at(seconds: float, stamp: int) -> Odometry:
    """Return odometry of a vehicle that flies in a circle."""
    turn = SPEED / RADIUS
    angle = turn * seconds
    seen = Measured(
        seconds,
        RADIUS * np.array([math.sin(angle), 1.0 - math.cos(angle)]),
        exp(np.array([angle])),
        np.array([SPEED, 0.0]),
        np.array([turn]),
    )
    return messages.odometry_message(Stamp(stamp, FRAMES), seen)


def goal_at(seconds: float, stamp: int) -> PoseStamped:
    """Return a goal that swings around the middle of the circle."""
    swing = 0.3 * math.sin(0.5 * seconds)
    return messages.goal_message(Stamp(stamp, FRAMES), np.array([swing, RADIUS]))


def lost(_message: Any, _draw: random.Random) -> list[Any]:
    """Lose a message."""
    return []


def with_field(path: str, *values: Any) -> Spoiler:
    """Return a change of a field, such as ``pose.position.x``, to one of the given values."""

    def spoil(message: Any, draw: random.Random) -> list[Any]:
        *parents, name = path.split('.')
        setattr(reduce(getattr, parents, message), name, draw.choice(values))
        return [message]

    return spoil


def shifted(low: float, high: float) -> Spoiler:
    """Return a shift of stamps by a random time in a range [s]."""

    def spoil(message: Any, draw: random.Random) -> list[Any]:
        stamp = messages.nanoseconds(message.header.stamp, 'stamp')
        moved = max(0, stamp + round(draw.uniform(low, high) * SECOND))
        message.header.stamp = messages.time_message(moved)
        return [message]

    return spoil


def in_the_world(message: Any, _draw: random.Random) -> list[Any]:
    """Express odometry's velocity in the world frame instead of the body frame."""
    turned, velocity = message.pose.pose.orientation, message.twist.twist.linear
    yaw = 2.0 * math.atan2(turned.z, turned.w)
    velocity.x, velocity.y = velocity.x * math.cos(yaw), velocity.x * math.sin(yaw)
    return [message]


def repeated() -> Spoiler:
    """Return an endless repetition of the first message."""
    first: list[Any] = []

    def spoil(message: Any, _draw: random.Random) -> list[Any]:
        if not first:
            first.append(copy.deepcopy(message))
        return [first[0]]

    return spoil


def scaled_quaternion(message: Any, draw: random.Random) -> list[Any]:
    """Set a quaternion to zero, or change its length by 1 %."""
    turned = getattr(message.pose, 'pose', message.pose).orientation
    factor = draw.choice((0.0, 1.01, 0.99, 1e200))
    for name in 'xyzw':
        setattr(turned, name, factor * getattr(turned, name))
    return [message]


def garbled(message: Any, draw: random.Random) -> list[Any]:
    """Return invalid bytes: truncated, with absurd lengths, or in another encoding."""
    whole = bytes(serialize_message(message))
    ways = (
        whole[: draw.randrange(len(whole))],
        whole[:12] + b'\xff\xff\xff\x7f' + whole[16:],
        b'\x00\x09' + whole[2:],
        whole[:4] + draw.randbytes(len(whole) - 4),
        whole.replace(FRAMES.world.encode(), b'\xff' * len(FRAMES.world)),
    )
    return [draw.choice(ways)]


def flood() -> None:
    """Publish odometry, whose pose is updated a hundred times a second."""
    period = 1.0 / float(sys.argv[1])
    source = Observer()
    publisher = source.node.create_publisher(Odometry, 'odom', qos())
    message = odometry_at(0.0, 0)
    posed = due = time.monotonic()
    while True:
        now = time.monotonic()
        due = max(due + period, now - AT_ONCE)
        if now - posed > 0.01:
            message, posed = odometry_at(now, 0), now
        message.header.stamp = messages.time_message(time.time_ns())
        publisher.publish(message)
        time.sleep(max(0.0, due - time.monotonic()))


if __name__ == '__main__':
    flood()
