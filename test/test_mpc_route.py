# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Paths to follow: how fast the wind lets them be flown, and what is said of those it does not."""

import math

import numpy as np
import pytest

from orbimpc_ros.loop.goal.motion import Paced, Route
from orbimpc_ros.loop.planner import Planner, Snapshot
from orbimpc_ros.loop.state import Odometry, WindReport
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Floor, Problem

EAST, NORTH = np.eye(2)
SPEED = 20.0
LINE = Route(np.array([[-1e4, 0.0], [1e4, 0.0]]))
TIMES = np.arange(1.0, 9.0)


def circle(radius=200.0, count=361):
    angles = np.linspace(0.0, 2.0 * math.pi, count)
    points = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    points[-1] = points[0]
    return Route(points)


@pytest.mark.parametrize('wind', [(0.0, 0.0), (5.0, 0.0), (-12.0, 9.0), (0.0, 19.0), (-19.0, 2.0)])
def test_the_goal_moves_at_the_airspeed_in_the_wind(wind):
    wind = np.array(wind)
    paced = Paced(LINE, 1e4, 0.0, SPEED, wind)
    over_ground = np.diff(paced.at(np.concatenate([[0.0], TIMES])), axis=0)
    np.testing.assert_allclose(np.linalg.norm(over_ground - wind, axis=1), SPEED, rtol=1e-9)
    assert paced.trouble(TIMES, 0.3) == ''


def test_around_a_circle_the_airspeed_is_kept_too():
    wind = np.array([8.0, -6.0])
    paced = Paced(circle(), 0.0, 0.0, SPEED, wind)
    times = np.linspace(0.0, 60.0, 6001)
    over_ground = np.diff(paced.at(times), axis=0) / 0.01
    np.testing.assert_allclose(np.linalg.norm(over_ground - wind, axis=1), SPEED, rtol=0.02)


@pytest.mark.parametrize('wind', [(-24.0, 0.0), (0.0, 24.0), (-20.0, -1.0)])
def test_what_the_wind_does_not_allow_is_said_and_waits(wind):
    paced = Paced(LINE, 1e4, 0.0, SPEED, np.array(wind))
    np.testing.assert_allclose(paced.at(TIMES), np.zeros((8, 2)), atol=1e-6)
    assert paced.trouble(TIMES, 0.3).startswith('the path cannot be followed in a wind of 2')


def test_a_corner_that_is_too_sharp_is_said():
    corner = Route(np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 500.0]]))
    paced = Paced(corner, 20.0, 0.0, SPEED, np.zeros(2))
    assert 'it is rounded off' in paced.trouble(TIMES, 0.3)
    assert paced.trouble(TIMES[:2], 0.3) == ''  # not yet in sight
    assert Paced(circle(), 0.0, 0.0, SPEED, np.zeros(2)).trouble(TIMES, 0.12) == ''


def test_the_nearest_point_is_looked_for_along_the_way():
    eight = Route(np.array([[0.0, -50.0], [0.0, 50.0], [80.0, 50.0], [80.0, 0.0], [-80.0, 0.0]]))
    crossing = np.array([1.0, 0.5])  # nearer to the second of the ways that cross
    assert eight.nearest(crossing) == pytest.approx(50.0 + 50.0 + 80.0 + 50.0 + 79.0)
    assert eight.nearest(crossing, near=40.0, within=60.0) == pytest.approx(50.5)
    around = circle()
    assert around.nearest(np.array([200.0, -1.0]), near=1.0, within=50.0) > 1200.0


def test_an_open_path_ends_and_a_closed_one_goes_on():
    short = Paced(Route(np.array([[0.0, 0.0], [30.0, 0.0]])), 0.0, 0.0, SPEED, np.zeros(2))
    np.testing.assert_allclose(short.at(np.array([5.0])), [[30.0, 0.0]])
    around = Paced(circle(), 0.0, 0.0, SPEED, np.zeros(2)).at(np.array([0.0, 20.0 * math.pi]))
    np.testing.assert_allclose(around[0], around[1], atol=0.5)


@pytest.mark.parametrize('points', [[[0.0, 0.0]], [[0.0, 0.0], [1.0, 0.0], [1.0, 0.0]]])
def test_points_have_to_be_apart(points):
    with pytest.raises(BadInput, match='goal_path'):
        Route(np.array(points))


def flown(route, wind, seconds, place=(0.0, 60.0), heading=0.0):
    """Return the ways over ground of a wing that obeys at once, and the last decision."""
    floor = Floor('circle', fraction=0.8)
    problem = Problem(
        horizon=10, step=0.5, forward=SPEED, floor=floor, max_rate=0.4, discretisation='exact'
    )
    planner = Planner(problem, estimated=True, velocity_source='air')
    place, turned, places = np.array(place), exp(np.array([heading])), []
    for time in np.arange(0.0, seconds, 0.5):
        measured = Odometry(time, place, turned, np.array([SPEED, 0.0]), np.zeros(1))
        snapshot = Snapshot(measured, route, wind=WindReport(time, wind, 0.01))
        decision = planner.step(snapshot, time)
        planner.sent(decision.command, time)
        for _ in range(10):
            turned = turned @ exp(0.05 * decision.command.body_rate)
            place = place + 0.05 * (SPEED * turned[:, 0] + wind)
            places.append(place)
    return np.array(places), turned[:, 0], decision


@pytest.mark.parametrize('share', [0.0, 0.6, 0.9])
def test_a_line_is_followed_in_wind(share):
    places, _, decision = flown(LINE, share * SPEED * np.array([-0.6, 0.8]), 60.0)
    assert np.abs(places[-200:, 1]).max() < 1.0
    assert places[-1, 0] > places[-200, 0] + 10.0  # and on along it
    assert 'cannot be followed' not in decision.reason


def test_a_wind_beyond_the_airspeed_is_said_and_flown_into():
    places, axis, decision = flown(LINE, 1.2 * SPEED * -EAST, 60.0)
    assert 'the path cannot be followed in a wind of 24 m/s' in decision.reason
    assert axis @ EAST > 0.95
    drift = (places[-1] - places[-200]) / 10.0
    assert np.linalg.norm(drift) < 0.2 * SPEED + 0.5  # as little as can be
