# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Hostile messages: 10,000 against the validators."""

import math
import random

import numpy as np
import pytest

pytest.importorskip('rclpy')

from planners import FRAMES, settings
from stepping import stale_goal, targets

from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND, RosTime, Stamp
from orbimpc_ros.ros.planner.inputs import Inputs
from orbimpc_ros.sim.vehicle import Model, launched, measured

NUMBERS = (
    math.nan, math.inf, -math.inf, 0.0, -0.0, 1e308, -1e308, 5e-324, 1.0, -1.0, 1e7, 1e-3, 3e38,
)  # fmt: skip
WORDS = ('', 'map', 'odom', 'base_link', 'o' * 100_000, 'odom\n', '/odom', 'öдом', '\x7f', '%s%n{}')
SECONDS = (-(2**31), -1, 0, 1, 2**31 - 1)
NANOSECONDS = (0, 1, SECOND - 1, SECOND, 2**32 - 1)
MOST = 40  # poses of a path


def numbers_in(message, path=()):
    """Yield where in a message there are numbers: as (names of fields, index or None)."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if kind == 'double':
            yield (*path, name), None
        elif kind.startswith('double['):
            yield from (((*path, name), i) for i in range(len(value)))
        elif hasattr(value, 'get_fields_and_field_types'):
            yield from numbers_in(value, (*path, name))


def poisoned(draw, message, most=4):
    """Return a message of which a few numbers, names and stamps are something else."""
    places = list(numbers_in(message))
    for path, index in draw.sample(places, min(len(places), draw.randint(0, most))):
        *parents, last = path
        holder = message
        for name in parents:
            holder = getattr(holder, name)
        if index is None:
            setattr(holder, last, draw.choice(NUMBERS))
        else:
            getattr(holder, last)[index] = draw.choice(NUMBERS)
    if draw.random() < 0.2:
        message.header.frame_id = draw.choice(WORDS)
    if draw.random() < 0.2 and hasattr(message, 'child_frame_id'):
        message.child_frame_id = draw.choice(WORDS)
    if draw.random() < 0.2:
        message.header.stamp.sec = draw.choice(SECONDS)
        message.header.stamp.nanosec = draw.choice(NANOSECONDS)
    return message


def odometry(draw, at):
    vehicle = launched(Model(), np.array([draw.gauss(0, 3), draw.gauss(0, 3)]), np.eye(2))
    return poisoned(draw, messages.odometry_message(Stamp(at, FRAMES), measured(vehicle)))


def goal(draw, at):
    return poisoned(
        draw, messages.goal_message(Stamp(at, FRAMES), np.array([5.0, draw.gauss(0, 3)]))
    )


def path(draw, at):
    length = draw.choice([0, 1, 2, 5, MOST])
    places = [np.array([k, draw.gauss(0, 1)]) for k in range(length)]
    whole = messages.goal_path_message(Stamp(at, FRAMES), draw.choice([0.1, 0.0]), places)
    for each in draw.sample(whole.poses, min(length, draw.randint(0, 2))):
        poisoned(draw, each)
    return poisoned(draw, whole)


def finite(*arrays):
    return all(np.isfinite(array).all() for array in arrays)


@pytest.mark.parametrize('part', range(4))
def test_whatever_comes_is_taken_whole_or_refused_whole(part):
    draw = random.Random(part)
    inputs = Inputs(settings(step=0.1, goal_jump_limit=50.0))
    makers = {'odom': odometry, 'goal': goal, 'goal_path': path}
    taken = 0
    for k in range(2500):
        now, at = 0.05 * k, (1_700_000_000 * SECOND) + k * SECOND // 20
        topic = draw.choice(('odom', 'odom', 'goal', 'goal_path'))
        message = makers[topic](draw, at)
        refusal = inputs.update(topic, message, now, RosTime(at + draw.choice((0, SECOND // 10))))
        taken += not refusal
        assert '\n' not in refusal
        assert len(refusal) < 400
        if inputs.missing or stale_goal(inputs, now):
            continue
        known = inputs.odometry.value
        assert finite(known.position, known.attitude, known.body_velocity, known.body_rate)
        np.testing.assert_allclose(known.attitude.T @ known.attitude, np.eye(2), atol=1e-9)
        assert finite(targets(inputs, inputs.odometry.value.time + np.arange(1, 6), now))
    assert 500 < taken < 2000
    assert sum(inputs.refused.values()) == 2500 - taken


def test_covariances_are_not_read():
    """Many drivers mean "unknown" by NaN there."""
    start = launched(Model(), np.zeros(2), np.eye(2))
    message = messages.odometry_message(Stamp(1, FRAMES), measured(start))
    message.pose.covariance[:] = np.full(36, np.nan)
    message.twist.covariance[:] = np.full(36, np.inf)
    _, read = messages.read_odometry(message, 2, FRAMES)
    np.testing.assert_array_equal(read.position, [0.0, 0.0])
