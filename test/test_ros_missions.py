# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A vehicle in continuous time with a floor and a rate limit: no command is beyond them."""

import functools

import numpy as np
import pytest

QUICK = 6  # flights with steps that are few


@pytest.fixture(scope='module')
def flights():
    """The judge of flights, where ROS's messages are installed."""
    pytest.importorskip('rclpy', reason='needs ROS 2, or pip install orbimpc_ros[ros]')
    import flights

    return flights


@functools.cache
def quick_indices(draw):
    """The first flights of at most 120 ticks, two of them with faults."""
    short = [i for i in range(100) if draw(1, i).duration / draw(1, i).step <= 120.0]
    faulty = [i for i in short if draw(1, i).faults]
    return [*[i for i in short if i not in faulty][: QUICK - 2], *faulty[:2]]


@pytest.mark.parametrize('k', range(QUICK))
def test_no_command_is_beyond_the_limits(flights, k):
    flown = flights.row(1, quick_indices(flights.draw)[k])
    assert not flown['broken'], flown
    assert sum(flown['roads'].values()) >= 60


def test_each_limit_is_judged(flights):
    flight = flights.draw(1, 0)
    full, turning = flight.parameters['forward'], flight.parameters['max_rate']

    def found(speed, rate):
        return list(flights.beyond(flight, speed, rate))

    assert found(flight.least, turning) == found(full, -turning) == []
    assert found(flight.least * (1.0 - 2e-6), 0.0) == ['below the floor']
    assert found(full * (1.0 + 2e-6), 0.0) == ['above full speed']
    assert found(full, -turning * (1.0 + 2e-6)) == ['beyond max_rate']
    assert found(np.nan, 0.0) == found(full, np.inf)[:1] == ['not finite']
