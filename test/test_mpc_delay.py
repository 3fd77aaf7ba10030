# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Delay compensation: arcs against fine steps, what was in force when, and what it is worth."""

import numpy as np
import pytest
from problems import ORDERS, rotation

from orbimpc_ros.loop.compensation import CommandHistory, Interval, advanced
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import Problem


def command(fraction, rate):
    return Command(
        fraction, np.atleast_1d(rate).astype(float), np.eye(2 if np.size(rate) == 1 else 3)
    )


def drawn(rng, n):
    """A command and a measurement, at random."""
    rates = 1 if n == 2 else 3
    measured = Odometry(
        7.0, rng.normal(size=n), rotation(rng, n), rng.normal(size=n), rng.normal(size=rates)
    )
    return command(rng.uniform(), 10.0 ** rng.uniform(-4, 0.5) * rng.normal(size=rates)), measured


def stepwise(problem, odometry, intervals, count=4000):
    """The same motion in small steps: midpoint rule, straight in each."""
    position, attitude = odometry.position, odometry.attitude
    velocity, body, rate = (
        attitude @ odometry.body_velocity,
        odometry.body_velocity,
        odometry.body_rate,
    )
    ahead = problem.forward * np.eye(problem.dimension)[0]
    for k, interval in enumerate(intervals):
        if k:
            body, rate = interval.before.speed_fraction * ahead, interval.before.body_rate
        turning = interval.command.body_rate if problem.rotation_order == 1 else rate
        thrust = 0.0 if interval.before is None else interval.before.speed_fraction
        h = interval.duration / count
        half = exp(0.5 * h * turning)
        for _ in range(count):
            middle = attitude @ half
            if problem.translation_order == 1:
                position = position + h * middle @ body
            else:
                gain = h * thrust * middle @ ahead
                position, velocity = position + h * (velocity + 0.5 * gain), velocity + gain
            attitude = middle @ half
    return position, attitude, velocity


@pytest.mark.parametrize('orders', ORDERS)
def test_intervals_are_flown_as_in_many_small_steps(orders):
    rng = np.random.default_rng(1)
    problem = Problem(**orders, forward=2.0)
    for _ in range(3):
        (first, measured), (second, _) = (
            drawn(rng, problem.dimension),
            drawn(rng, problem.dimension),
        )
        intervals = [Interval(0.3, first, None), Interval(0.2, second, first)]
        later = advanced(problem, measured, intervals)
        position, attitude, velocity = stepwise(problem, measured, intervals)
        assert later.time == pytest.approx(7.5)
        np.testing.assert_allclose(later.position, position, atol=1e-6)
        np.testing.assert_allclose(later.attitude, attitude, atol=1e-9)
        if problem.translation_order == 2:
            np.testing.assert_allclose(attitude @ later.body_velocity, velocity, atol=1e-6)
        else:
            speed = problem.forward * first.speed_fraction
            np.testing.assert_allclose(later.body_velocity, speed * np.eye(problem.dimension)[0])
        if problem.rotation_order == 2:
            np.testing.assert_array_equal(later.body_rate, first.body_rate)


@pytest.mark.parametrize('orders', ORDERS)
def test_a_leg_in_two_is_the_leg(orders):
    """Near zero rates, too, where the closed forms give way to series."""
    rng = np.random.default_rng(2)
    problem = Problem(**orders)
    for _ in range(20):
        given, measured = drawn(rng, problem.dimension)
        one = advanced(problem, measured, [Interval(0.4, given, given)])
        half = advanced(problem, measured, [Interval(0.2, given, given)])
        two = advanced(problem, half, [Interval(0.2, given, given)])
        for name in ('position', 'attitude', 'body_velocity'):
            np.testing.assert_allclose(getattr(two, name), getattr(one, name), atol=1e-8)


def test_no_time_changes_nothing():
    _, measured = drawn(np.random.default_rng(3), 2)
    assert advanced(Problem(), measured, []) is measured


def test_what_is_not_known_goes_on_as_measured():
    measured = Odometry(0.0, np.zeros(2), np.eye(2), np.array([2.0, 0.0]), np.array([0.1]))
    later = advanced(Problem(), measured, [Interval(0.5, None, None)])
    np.testing.assert_allclose(later.position, [1.0, 0.025], atol=1e-3)
    np.testing.assert_allclose(later.attitude, exp(np.array([0.05])), atol=1e-12)


A, B, C = command(0.1, 0.0), command(0.2, 0.0), command(0.3, 0.0)


def told(begin, end, sent=((1.0, A), (2.0, B), (3.0, C))):
    kept = CommandHistory()
    for at, given in sent:
        kept.add(given, at)
    return [
        (pytest.approx(interval.duration), interval.command, interval.before)
        for interval in kept.intervals(begin, end)
    ]


def test_intervals_are_what_was_in_force():
    assert told(1.5, 1.7) == [(0.2, A, None)]
    assert told(1.5, 2.5) == [(0.5, A, None), (0.5, B, A)]
    assert told(2.0, 3.5) == [(1.0, B, A), (0.5, C, B)]
    assert told(4.0, 4.25) == [(0.25, C, B)]
    assert told(0.5, 1.25) == [(0.5, None, None), (0.25, A, None)]
    assert told(0.0, 0.5) == [(0.5, None, None)]
    assert told(2.5, 2.5) == told(2.5, 2.0) == []


def test_forgotten_commands_are_not_in_force():
    kept = CommandHistory()
    kept.add(A, 1.0)
    kept.forget()
    assert [interval.command for interval in kept.intervals(1.5, 2.0)] == [None]
