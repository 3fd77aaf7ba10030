# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Obstacles by themselves: balls, and what moves."""

import numpy as np
import pytest

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Ball, Box, MovingObstacle


def test_a_point_is_as_deep_in_a_ball_as_it_is_from_its_surface():
    ball = Ball(np.array([1.0, 2.0]), 0.5)
    points = np.array([[1.0, 2.0], [1.5, 2.0], [1.0, 4.0]])
    np.testing.assert_allclose(ball.depth(points), [0.5, 0.0, -1.5], atol=1e-15)
    np.testing.assert_allclose(ball.scaled(2.0).depth(2.0 * points), [1.0, 0.0, -3.0], atol=1e-15)


@pytest.mark.parametrize('radius', [0.0, -1.0, np.nan, np.inf])
def test_a_ball_without_a_size_is_refused(radius):
    with pytest.raises(BadInput, match='radius'):
        Ball(np.zeros(2), radius)


def test_a_drifting_body_keeps_its_velocity_for_ever():
    hazard = MovingObstacle.drifting(Ball(np.zeros(3), 1.0), np.array([1.0, -2.0, 0.5]))
    times = np.array([0.0, 0.3, 1.0, 7.0])
    np.testing.assert_allclose(hazard.moved(times), times[:, None] * [1.0, -2.0, 0.5], atol=1e-12)


def test_a_body_moves_evenly_between_the_times_it_is_known_at_and_then_goes_on():
    box = Box(np.zeros(2), np.ones(2))
    hazard = MovingObstacle(
        box, np.array([0.0, 1.0, 3.0]), np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 4.0]])
    )
    expected = [[0.5, 0.0], [1.0, 0.0], [1.0, 2.0], [1.0, 8.0]]
    np.testing.assert_allclose(hazard.moved(np.array([0.5, 1.0, 2.0, 5.0])), expected, atol=1e-12)


@pytest.mark.parametrize(
    ('times', 'shifts', 'culprit'),
    [
        ([0.0], [[0.0, 0.0]], 'times'),
        ([0.0, 0.0], [[0.0, 0.0], [1.0, 0.0]], 'times'),
        ([0.5, 1.0], [[0.0, 0.0], [1.0, 0.0]], 'times'),
        ([0.0, np.nan], [[0.0, 0.0], [1.0, 0.0]], 'times'),
        ([0.0, 1.0], [[1.0, 0.0], [1.0, 0.0]], 'shifts'),
        ([0.0, 1.0], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], 'shifts'),
    ],
)
def test_a_track_that_makes_no_sense_is_refused(times, shifts, culprit):
    with pytest.raises(BadInput, match=culprit):
        MovingObstacle(Ball(np.zeros(2), 1.0), np.array(times), np.array(shifts))
