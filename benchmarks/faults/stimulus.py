# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The stimulus of a planner: a healthy vehicle and goal, and ways in which messages go wrong.

``python -m`` this module with a rate [Hz] publishes odometry at it until killed.
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
AT_ONCE = 0.1  # [s] that a flood catches up with, at most
SLIP = 5.0  # [m/s] sideways, which makes the failing planner raise

# From a message to others in its place, none, or bytes that are no message at all.
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
    """Return a goal that swings in the middle of the circle."""
    swing = 0.3 * math.sin(0.5 * seconds)
    return messages.goal_message(Stamp(stamp, FRAMES), np.array([swing, RADIUS]))


def lost(_message: Any, _draw: random.Random) -> list[Any]:
    """Lose a message."""
    return []


def with_field(path: str, *values: Any) -> Spoiler:
    """Return a change of a field, such as ``pose.position.x``, to one of some values."""

    def spoil(message: Any, draw: random.Random) -> list[Any]:
        *parents, name = path.split('.')
        setattr(reduce(getattr, parents, message), name, draw.choice(values))
        return [message]

    return spoil


def shifted(low: float, high: float) -> Spoiler:
    """Return a shift of stamps by a time between two [s]."""

    def spoil(message: Any, draw: random.Random) -> list[Any]:
        stamp = messages.nanoseconds(message.header.stamp, 'stamp')
        moved = max(0, stamp + round(draw.uniform(low, high) * SECOND))
        message.header.stamp = messages.time_message(moved)
        return [message]

    return spoil


def in_the_world(message: Any, _draw: random.Random) -> list[Any]:
    """Give an odometry's velocity along the world's axes, as if that were the body's."""
    turned, velocity = message.pose.pose.orientation, message.twist.twist.linear
    yaw = 2.0 * math.atan2(turned.z, turned.w)
    velocity.x, velocity.y = velocity.x * math.cos(yaw), velocity.x * math.sin(yaw)
    return [message]


def repeated() -> Spoiler:
    """Return a repetition of the first message for ever."""
    first: list[Any] = []

    def spoil(message: Any, _draw: random.Random) -> list[Any]:
        if not first:
            first.append(copy.deepcopy(message))
        return [first[0]]

    return spoil


def scaled_quaternion(message: Any, draw: random.Random) -> list[Any]:
    """Change a quaternion to zero, or by 1 % in length."""
    turned = getattr(message.pose, 'pose', message.pose).orientation
    factor = draw.choice((0.0, 1.01, 0.99, 1e200))
    for name in 'xyzw':
        setattr(turned, name, factor * getattr(turned, name))
    return [message]


def garbled(message: Any, draw: random.Random) -> list[Any]:
    """Return bytes that are no such message: cut off, with absurd lengths, in another encoding."""
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
    """Publish odometry, its pose moved on a hundred times a second."""
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
