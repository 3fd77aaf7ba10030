# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Velocities in the wrong frame are told from those in the right one by the way flown."""

import numpy as np
import pytest

from orbimpc_ros.loop.state import WINDOW, Odometry, VelocityFrameCheck
from orbimpc_ros.mpc.geometry.rotations import exp


def flight(rng, dimension, count=60, noise=0.0, wind=0.0, speed=2.0):
    """Yield times, positions, attitudes and velocities in the world of a turning vehicle."""
    rates = 1 if dimension == 2 else 3
    attitude = exp(rng.normal(size=rates))
    position, rate = rng.normal(size=dimension), 0.5 * rng.normal(size=rates)
    for k in range(count):
        velocity = speed * attitude[:, 0]
        yield 0.1 * k, position + noise * rng.normal(size=dimension), attitude, velocity
        attitude = attitude @ exp(0.1 * rate)
        position = position + 0.1 * speed * attitude[:, 0] + 0.1 * wind * np.eye(dimension)[0]


def told(given, truly, states):
    """Return what a witness says of velocities given in a frame that may not be theirs."""
    witness = VelocityFrameCheck(given)
    for time, position, attitude, velocity in states:
        sent = velocity if truly == 'world' else attitude.T @ velocity
        read = attitude.T @ sent if given == 'world' else sent
        rate = np.zeros(1 if len(position) == 2 else 3)
        witness.note(Odometry(time, position.copy(), attitude.copy(), read, rate))
    return witness.doubt


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize('truly', ['body', 'world'])
@pytest.mark.parametrize('given', ['body', 'world'])
def test_a_wrong_frame_is_told_and_the_right_one_is_not(given, truly, dimension):
    rng = np.random.default_rng([dimension, given == 'body', truly == 'body'])
    doubts = [told(given, truly, flight(rng, dimension, noise=0.005)) for _ in range(20)]
    if given == truly:
        assert not any(doubts)
    else:  # who looks along x all the time gives nothing away
        assert sum(f'those of the {truly} frame' in each for each in doubts) >= 15


@pytest.mark.parametrize('given', ['body', 'world'])
@pytest.mark.parametrize(
    ('wind', 'noise', 'speed'),
    [(0.0, 0.2, 2.0), (1.5, 0.0, 2.0), (1.5, 0.05, 2.0), (0.0, 0.0, 0.0)],
)
def test_noise_wind_and_rest_are_no_wrong_frame(given, wind, noise, speed):
    rng = np.random.default_rng(8)
    for _ in range(20):
        assert not told(given, given, flight(rng, 2, noise=noise, wind=wind, speed=speed))


def test_a_few_measurements_are_no_evidence():
    rng = np.random.default_rng(9)
    assert not told('body', 'world', flight(rng, 2, count=WINDOW))
