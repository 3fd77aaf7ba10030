# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Autopilots of wings in plain numbers: round trips of axes, setpoints as firmwares read them."""

import math
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

from orbimpc_ros.loop.compensation import Compensator, Odometry, WindReport
from orbimpc_ros.mpc.geometry.rotations import exp, from_quaternion, to_quaternion
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.ros.planner import wings
from orbimpc_ros.ros.planner.wings import ArduPlane, Px4

DRAWS = 2_000


def alone(kind, share=1.0, origin=0.0):
    """Return a wing without its node, and the list of what it will tell PX4."""
    wing, told = kind.__new__(kind), []
    wing._types, wing._share, wing._origin, wing._due = MagicMock(), share, origin, ()
    wing._tell, wing._ask = lambda _kind, **fields: told.append(fields), list
    return wing, told


def same(one, other):
    return np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-6)


def test_axes_and_attitudes_there_and_back():
    rng = np.random.default_rng(33)
    for _ in range(DRAWS):
        vector, unit = rng.normal(scale=100.0, size=3), rng.normal(size=4)
        unit /= np.linalg.norm(unit)
        same(wings.NED @ wings.NED @ vector, vector)
        same(wings.FRD @ wings.FRD @ vector, vector)
        rotation = wings.attitude(unit)
        back = to_quaternion(wings.NED @ rotation @ wings.FRD)
        same(back * math.copysign(1.0, back @ unit), unit)
        # A body vector maps to the same world vector in both conventions of axes.
        of_body = from_quaternion(unit, 3) @ (wings.FRD @ vector)
        same(rotation @ vector, wings.NED @ of_body)


def test_setpoints_there_and_back():
    rng = np.random.default_rng(34)
    for _ in range(DRAWS):
        share, origin = rng.uniform(0.7, 1.0), rng.uniform(-50.0, 900.0)
        speed, course = rng.uniform(8.0, 60.0), rng.uniform(-math.pi, math.pi)
        spin = rng.normal(scale=0.3)
        level = math.nan if rng.random() < 0.3 else rng.uniform(5.0, 500.0)
        (px4, told), (arduplane, _) = (alone(kind, share, origin) for kind in (Px4, ArduPlane))
        px4._publish(speed, course, spin, level)
        arduplane._publish(speed, course, spin, level)
        across, along = told
        # Ranges that the firmwares accept.
        assert -math.pi <= across['airspeed_direction'] <= math.pi
        assert math.isnan(across['course'])  # unused: a finite direction takes precedence
        names = ('height_rate', 'pitch_direct', 'throttle_direct')
        assert all(math.isnan(along[name]) for name in names)
        airspeed = along['equivalent_airspeed'] / share
        turn = -across['lateral_acceleration'] / airspeed
        heading = wings.bearing(across['airspeed_direction'])
        same(math.remainder(heading - course, 2.0 * math.pi), 0.0)
        same([airspeed, turn], [speed, spin])
        same(along['altitude'] - origin, level)
        heading, paced, *height = arduplane._due
        assert 0.0 <= heading['param2'] < 360.0
        assert heading['param3'] >= wings.HOLD  # with 0 the vehicle would not bank
        assert bool(height) == math.isfinite(level)  # otherwise the altitude is held
        same(paced['param2'] / share, speed)
        same([each['z'] for each in height], [level][: len(height)])
        ahead = wings.AHEAD * speed * spin / wings.GRAVITY
        found = wings.bearing(math.radians(heading['param2'])) - ahead
        same(math.remainder(found - course, 2.0 * math.pi), 0.0)


@pytest.mark.parametrize(
    ('angle', 'compass'), [(0.0, 90.0), (90.0, 0.0), (180.0, -90.0), (-90.0, 180.0), (45.0, 45.0)]
)
def test_a_bearing_is_that_of_a_compass(angle, compass):
    found = math.degrees(wings.bearing(math.radians(angle)))
    assert math.remainder(found - compass, 360.0) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize('bank', [-0.5, 0.3])
def test_a_bank_to_the_right_turns_to_the_right(bank):
    half = 0.5 * bank  # FRD: a rotation to the right about x
    banked = wings.attitude(np.array([math.cos(half), math.sin(half), 0.0, 0.0]))
    turn = wings.coordinated(banked, 20.0)
    assert turn == pytest.approx(-wings.GRAVITY * math.tan(bank) / 20.0)


def test_the_heading_of_a_setpoint_is_that_of_the_next_command():
    rate = np.array([0.4])
    command = Command(0.8, rate, exp(0.5 * rate))  # a step of 0.5 s, from heading 0
    wing, told = alone(Px4)
    wing.look, wing._note, wing.engaged = list, str, True
    wing._publish = lambda *given: told.append(given)
    wing.send(SimpleNamespace(forward=15.0, step=0.5, period=0.1), command, math.nan)
    same(told[0][:3], [12.0, 0.04, 0.4])


def test_the_air_is_thinner_higher_up():
    assert wings.equivalent(0.0) == 1.0
    assert wings.equivalent(1000.0) == pytest.approx(0.9529, abs=1e-3)  # standard atmosphere


def test_the_velocity_through_the_air_is_of_what_is_known():
    turned, unknown = np.eye(3), np.full(2, math.nan)
    over_ground, wind = np.array([18.0, 3.0, 0.0]), np.array([3.0, 3.0])
    found = wings.through_air(over_ground, turned, math.nan, wind)
    same(found, [15.0, 0.0, 0.0])
    same(wings.through_air(over_ground, turned, 16.0, wind), [16.0, 0.0, 0.0])
    same(wings.through_air(over_ground, turned, 16.0, unknown), [16.0, 0.0, 0.0])
    assert wings.through_air(over_ground, turned, math.nan, unknown) is None


# --- reported wind


def flown(report, seconds=2.0, wind=(4.0, -2.0)):
    """Return the wind estimated by a wing that flies east, with or without reports."""
    loop = Compensator(Problem(forward=20.0), estimated=True, velocity_source='air')
    for time in np.arange(0.0, seconds, 0.1):
        place = time * (np.array([20.0, 0.0]) + wind)
        measured = Odometry(time, place, np.eye(2), np.array([20.0, 0.0]), np.zeros(1))
        start = loop.start(measured, 0.0, None, report(time))
        loop.history.add(Command(1.0, np.zeros(1), np.eye(2)), time)
    return start.state['disturbance']


def test_a_reported_wind_is_believed_at_once():
    found = flown(lambda time: WindReport(time, np.array([4.0, -2.0]), 0.1), seconds=0.05)
    np.testing.assert_allclose(found, [4.0, -2.0], atol=0.1)
    vague = WindReport(9.0, np.zeros(2), 99.0)  # after which its clock is set back
    found = flown(lambda time: WindReport(time, found, 0.1) if time else vague, seconds=0.15)
    np.testing.assert_allclose(found, [4.0, -2.0], atol=0.1)


def test_a_report_is_believed_as_much_as_its_variance_and_its_news_are_worth():
    wrong = np.array([-8.0, 8.0])

    def off(variance, *, again=False):
        found = flown(lambda time: WindReport(time if again else 0.0, wrong, variance), 5.0)
        return np.linalg.norm(found - [4.0, -2.0])

    assert off(0.01) < 1.5  # a single report, long ago
    assert off(100.0, again=True) < off(1.0, again=True) < off(0.1, again=True)
    assert off(math.nan, again=True) == pytest.approx(off(1.0, again=True))
