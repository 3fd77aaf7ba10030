# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Boxes that a simulated vehicle touches on its way, whatever its odometry says."""

import numpy as np
import pytest

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Box
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.sim.world import departure, touched
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.settings import config


def box(rng, n):
    low = rng.uniform(-1.0, 1.0, n)
    return Box(low, low + rng.uniform(0.1, 1.5, n))


@pytest.mark.parametrize('n', [2, 3])
def test_a_way_touches_what_its_points_are_in(n):
    rng = np.random.default_rng([71, n])
    hits = 0
    for _ in range(300):
        boxes = [box(rng, n) for _ in range(3)]
        start, end = rng.uniform(-2.0, 2.0, (2, n))
        axis = rng.integers(n)  # along which nothing moves
        end[axis] = start[axis]
        points = start + np.linspace(0.0, 1.0, 4001)[:, None] * (end - start)
        sampled = {k for k, each in enumerate(boxes) if each.depth(points).max() > 0.0}
        found = touched(boxes, start, end)
        assert sampled <= found
        for k in found - sampled:  # a corner cut between two samples
            assert boxes[k].depth(points).max() > -1e-3
        hits += len(found)
    assert hits > 30


def test_along_a_face_and_at_a_standstill():
    unit = Box(np.zeros(3), np.ones(3))
    along, inside, outside = np.array([[0.2, 0.5, 1.0], [0.8, 0.5, 1.0]]), 0.5, 1.5
    assert not touched([unit], *along)
    assert touched([unit], np.full(3, inside), np.full(3, inside)) == {0}
    assert not touched([unit], np.full(3, outside), np.full(3, outside))


@pytest.mark.parametrize('vehicle', ['discrete', 'continuous'])
def test_who_flew_through_a_box_has_not_done_the_job(vehicle):
    """Straight on to a goal 5 m away, through a box thinner than a step."""
    pytest.importorskip('rclpy', reason='needs ROS 2, or pip install orbimpc_ros[ros]')
    wall = '[2.2, -1.0, 2.3, 1.0]'
    for changes, done in (((), True), ((f'obstacles={wall}',), False)):
        still = (f'vehicle={vehicle}', 'rope.amplitude=[0.0, 0.0, 0.0]', 'max_ticks=8', *changes)
        values = settings.resolve(config('retrieval.yaml'), still)
        flight = departure(sim_settings(settings.of_sim(values)).scenario)
        while not flight.over:
            flight = flight.after(1.0, np.zeros(1))
        assert flight.captured is done
        assert flight.touched == (frozenset() if done else {0})


def test_boxes_of_another_dimension_are_refused():
    pytest.importorskip('rclpy', reason='needs ROS 2, or pip install orbimpc_ros[ros]')
    values = settings.resolve(config('retrieval.yaml'))
    with pytest.raises(BadInput, match='obstacles'):
        sim_settings(values | {'obstacles': (1.0, 2.0, 3.0)})
