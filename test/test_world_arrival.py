# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Arriving: what counts as it, and how near the paper's two vehicles come."""

from dataclasses import replace

import numpy as np
import pytest
from open_loop import open_loop
from scenarios import dubins, dubins_problem, spacecraft, spacecraft_problem

from orbimpc_ros.sim.world import departure, fixed

AHEAD = replace(dubins(), rope=fixed(np.array([3.0, 0.0])), max_ticks=3, arrival_radius=0.1)


def flown(scenario, fractions):
    flight = departure(scenario)
    for fraction in fractions:
        flight = flight.after(fraction, np.zeros(1))
    return flight


def test_an_arrival_is_judged_at_the_end_alone():
    passing = flown(replace(AHEAD, rope=fixed(np.array([1.0, 0.0]))), [1.0])
    assert passing.miss == pytest.approx(0.0)
    assert not passing.over
    assert not passing.captured
    assert flown(AHEAD, [1.0, 1.0, 1.0]).captured
    assert flown(AHEAD, [1.0, 1.0, 1.0]).over


def test_a_vehicle_that_is_too_far_or_too_fast_has_not_arrived():
    near = flown(AHEAD, [1.0, 0.95, 0.5])
    assert near.captured
    assert near.distance == pytest.approx(0.05)
    far = flown(AHEAD, [1.0, 0.5, 0.0])
    assert far.over
    assert not far.captured
    slow = replace(AHEAD, arrival_speed=0.4)
    assert not flown(slow, [1.0, 1.0, 0.5]).captured
    assert flown(slow, [1.0, 1.0, 0.3]).captured
    assert flown(slow, [1.0, 1.0, 0.3]).speed == pytest.approx(0.3)


@pytest.mark.parametrize('floor', ['none', 'polygon', 'circle'])
def test_the_dubins_car_arrives_by_its_first_plan(floor):
    found = open_loop(dubins_problem(floor), dubins(), 'nearest')
    assert found.plan.status == 'optimal'
    assert found.relaxed.position < 1e-6
    assert found.flown.position < 1e-3
    least = found.plan.speed_fraction[1:].min()
    assert (least >= np.sqrt(0.5) - 1e-6) == (floor != 'none')


@pytest.mark.parametrize('projection', ['nearest', 'thrust_aligned'])
def test_the_spacecraft_arrives_at_rest_by_its_first_plan(projection):
    found = open_loop(spacecraft_problem(), spacecraft(), projection)
    assert max(found.relaxed[:2]) < 1e-6
    assert max(found.flown[:2]) < 1e-3
