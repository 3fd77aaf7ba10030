# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Traffic in the simulated world: balls that are touched, and vehicles that cross over."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scenarios import retrieval

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Ball, Box, Hazard, Problem
from orbimpc_ros.sim.fleet import LEAST_RING, crossing, separations
from orbimpc_ros.sim.vehicle import launched
from orbimpc_ros.sim.world import departure, met


@pytest.mark.parametrize('dimension', [2, 3])
def test_a_ball_is_met_exactly_where_looking_often_finds_it(dimension):
    rng = np.random.default_rng([91, dimension])
    shares = np.linspace(0.0, 1.0, 4001)[:, None]
    for _ in range(300):
        place, velocity, begin, end = rng.uniform(-2.0, 2.0, (4, dimension))
        radius, (start, stop) = rng.uniform(0.1, 1.5), np.cumsum(rng.uniform(0.1, 2.0, 2))
        ball = Hazard.drifting(Ball(place, radius), velocity)
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
        ball = Hazard.drifting(Ball(np.array([1.0, 0.3 - depth]), 0.3), np.array([-1.0, 0.0]))
        wall = Box(np.array([0.5, -1.0]), np.array([1.5, depth]))
        for bodies in ({'traffic': (ball,)}, {'obstacles': (wall,)}):
            start = launched(model, np.zeros(2), np.eye(2), velocity=speed)
            flight = departure(replace(retrieval(), model=model, start=start, **bodies))
            assert (flight.after(1.0, np.zeros(1)).touched == frozenset()) is allowed


def test_who_touches_traffic_has_not_caught_anything():
    """A ball that crosses the way of a step between its ends, and one that is late."""
    crossing_by = Hazard.drifting(Ball(np.array([0.5, 5.0]), 0.2), np.array([0.0, -10.0]))
    late = Hazard.drifting(Ball(np.array([0.5, 50.0]), 0.2), np.array([0.0, -10.0]))
    for traffic, numbers in (((crossing_by,), {0}), ((late,), set()), ((late, crossing_by), {1})):
        scenario = replace(retrieval(), traffic=traffic, capture_radius=1e6)
        flight = departure(scenario, 100.0).after(1.0, np.zeros(1))
        assert flight.touched == numbers
        assert flight.captured == (not numbers)


def test_a_crossing_leads_from_a_ring_through_its_middle():
    fleet = crossing(8, 3)
    for member in fleet:
        goal = member.rope.at(0.0)
        np.testing.assert_array_equal(goal, member.rope.at(17.0))
        assert np.linalg.norm(member.position) > LEAST_RING - 1.0
        assert np.linalg.norm(0.5 * (member.position + goal)) < 1.0
        way = goal - member.position
        assert member.heading == pytest.approx(math.atan2(way[1], way[0]))
    starts = {m: (np.array([0.0, 1.0]), np.tile(fleet[m].position, (2, 1))) for m in range(8)}
    assert min(separations(starts).values()) > 1.5
    np.testing.assert_array_equal(crossing(8, 3)[2].position, fleet[2].position)
    with pytest.raises(BadInput, match='vehicles'):
        crossing(65)


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
