# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Boxes and balls that a simulated vehicle touches on its way, and fleets that keep apart."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scenarios import retrieval

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Ball, Box, MovingObstacle, Problem
from orbimpc_ros.sim.fleet import LEAST_RING, crossers, separations
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.sim.vehicle import launched
from orbimpc_ros.sim.world import departure, met, touched
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


@pytest.mark.parametrize('dimension', [2, 3])
def test_a_ball_is_met_exactly_where_looking_often_finds_it(dimension):
    rng = np.random.default_rng([91, dimension])
    shares = np.linspace(0.0, 1.0, 4001)[:, None]
    for _ in range(300):
        place, velocity, begin, end = rng.uniform(-2.0, 2.0, (4, dimension))
        radius, (start, stop) = rng.uniform(0.1, 1.5), np.cumsum(rng.uniform(0.1, 2.0, 2))
        ball = MovingObstacle.drifting(Ball(place, radius), velocity)
        way = begin + shares * (end - begin)
        there = place + (start + shares * (stop - start)) * velocity
        least = np.linalg.norm(way - there, axis=1).min()
        if abs(least - radius) > 1e-3:
            assert met([ball], (begin, end), (start, stop)) == ({0} if least < radius else set())


@pytest.mark.parametrize('order', [1, 2])
def test_what_a_plan_may_lead_inside_is_no_touch(order):
    """Past a ball that passes, and along a wall: by the tolerance of plans, and by more."""
    model = replace(retrieval().model, translation_order=order, step=0.5, forward=4.0)
    unit, speed = model.length_unit, np.array([4.0, 0.0]) if order == 2 else None
    assert unit == pytest.approx(Problem(2, 1, order, step=0.5, forward=4.0).length_unit)
    for depth, allowed in ((0.9e-6 * unit, True), (1.1e-6 * unit, False)):
        ball = MovingObstacle.drifting(
            Ball(np.array([1.0, 0.3 - depth]), 0.3), np.array([-1.0, 0.0])
        )
        wall = Box(np.array([0.5, -1.0]), np.array([1.5, depth]))
        for bodies in ({'traffic': (ball,)}, {'obstacles': (wall,)}):
            start = launched(model, np.zeros(2), np.eye(2), velocity=speed)
            flight = departure(replace(retrieval(), model=model, start=start, **bodies))
            assert (flight.after(1.0, np.zeros(1)).touched == frozenset()) is allowed


def test_who_touches_traffic_has_not_caught_anything():
    """A ball that crosses the way of a step between its ends, and one that is late."""
    crossing_by = MovingObstacle.drifting(Ball(np.array([0.5, 5.0]), 0.2), np.array([0.0, -10.0]))
    late = MovingObstacle.drifting(Ball(np.array([0.5, 50.0]), 0.2), np.array([0.0, -10.0]))
    for traffic, numbers in (((crossing_by,), {0}), ((late,), set()), ((late, crossing_by), {1})):
        scenario = replace(retrieval(), traffic=traffic, capture_radius=1e6)
        flight = departure(scenario, 100.0).after(1.0, np.zeros(1))
        assert flight.touched == numbers
        assert flight.captured == (not numbers)


def test_a_crossing_leads_from_a_ring_through_its_middle():
    fleet = [*crossers(8, 3).values()]
    places = np.array([each['start.position'][:2] for each in fleet])
    for each, place in zip(fleet, places, strict=True):
        goal = np.array(each['rope.center'][:2])
        assert not any((*each['rope.amplitude'], each['rope.frequency']))
        assert np.linalg.norm(place) > LEAST_RING - 1.0
        assert np.linalg.norm(0.5 * (place + goal)) < 1.0
        way = goal - place
        *_, z, w = each['start.orientation']
        assert 2.0 * math.atan2(z, w) == pytest.approx(math.atan2(way[1], way[0]))
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    assert apart[~np.eye(8, dtype=bool)].min() > 1.5
    assert crossers(8, 3) == crossers(8, 3)
    with pytest.raises(BadInput, match='vehicles'):
        crossers(65)


def test_vehicles_are_apart_as_looking_often_finds_them():
    rng = np.random.default_rng(92)
    for _ in range(30):
        tracks = [
            (np.cumsum(rng.uniform(0.1, 1.0, 6)), rng.uniform(-5.0, 5.0, (6, 2))) for _ in range(3)
        ]
        least = math.inf
        for i in range(3):
            for j in range(i):
                (ones, here), (others, there) = tracks[i], tracks[j]
                times = np.linspace(max(ones[0], others[0]), min(ones[-1], others[-1]), 20001)
                apart = [
                    np.interp(times, ones, a) - np.interp(times, others, b)
                    for a, b in zip(here.T, there.T, strict=True)
                ]
                least = min(least, np.hypot(*apart).min())
        found = separations(dict(enumerate(tracks)))
        assert found.keys() == {(0, 1), (0, 2), (1, 2)}
        assert least - 0.01 < min(found.values()) <= least + 1e-9
    straight = np.array([0.0, 2.0])
    ways = {
        'a': (straight, np.array([[-1.0, 0.3], [1.0, 0.3]])),
        'b': (straight, np.array([[0.0, -1.0], [0.0, 1.0]])),
    }
    assert separations(ways) == {('a', 'b'): pytest.approx(0.3 / math.sqrt(2.0))}
    later = {'a': ways['a'], 'b': (straight + 3.0, ways['b'][1])}
    assert separations(later) == {('a', 'b'): math.inf}
