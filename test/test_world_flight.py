# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rope, capture and scenarios: geometry against brute force, and the paper's story."""

from dataclasses import replace

import numpy as np
import pytest
from flying import fly
from scenarios import dubins, retrieval, retrieval_problem

from orbimpc_ros.loop.capture import closest_approach, is_headed
from orbimpc_ros.loop.goal.forecast import FORECASTS
from orbimpc_ros.loop.planner import Planner
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import log
from orbimpc_ros.mpc.problem import Approach
from orbimpc_ros.sim.vehicle import Model, launched
from orbimpc_ros.sim.world import Rope, departure, fixed


@pytest.mark.parametrize('n', [2, 3])
def test_closest_approach_is_the_least_of_many(n):
    rng = np.random.default_rng(4)
    for _ in range(50):
        s0, s1, g0, g1 = rng.normal(size=(4, n))
        distance, share = closest_approach((s0, s1), (g0, g1))
        shares = np.linspace(0.0, 1.0, 1001)[:, None]
        apart = np.linalg.norm((s0 - g0) + shares * ((s1 - g1) - (s0 - g0)), axis=1)
        assert distance <= apart.min() + 1e-12
        assert distance == pytest.approx(apart.min(), abs=5e-3)
        assert 0.0 <= share <= 1.0


def test_closest_approach_of_points_that_move_alike():
    offset = np.array([0.3, 0.4])
    assert closest_approach((np.zeros(2), np.ones(2)), (offset, 1 + offset))[0] == pytest.approx(
        0.5
    )


def test_a_rope_swings_about_its_center():
    rope = Rope([5.0, 0.0], [0.5, 0.25], 0.1, [0.0, np.pi / 2])
    np.testing.assert_allclose(rope.at(0.0), [5.0, 0.25])
    np.testing.assert_allclose(rope.at(2.5), [5.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(rope.at(10.0), rope.at(0.0), atol=1e-12)
    np.testing.assert_allclose(fixed(np.array([1.0, 2.0])).at(7.0), [1.0, 2.0])
    with pytest.raises(BadInput, match='amplitude'):
        Rope([5.0, 0.0], [0.5], 0.1, [0.0, 0.0])


def test_a_flight_that_starts_later_is_the_same_flight():
    early, late = departure(retrieval()), departure(retrieval(), 30.0)
    np.testing.assert_array_equal(early.goal, late.goal)
    early, late = (each.after(0.9, np.array([0.1])) for each in (early, late))
    assert early.miss == late.miss
    assert late.missed_at == early.missed_at + 30.0


@pytest.fixture(scope='module')
def controller():
    return Planner(retrieval_problem())


@pytest.mark.parametrize('seed', [None, 1, 2])
def test_the_papers_story(controller, seed):
    """Several near misses, then capture at about t = 24; also from starts a little off."""
    scenario = retrieval()
    if seed is not None:
        nudge = np.random.default_rng(seed).uniform(-1e-3, 1e-3, 2)
        scenario = replace(scenario, start=launched(scenario.model, nudge, np.eye(2)))
    controller.reset()
    log = fly(controller, scenario, FORECASTS['hold']())
    assert log.captured
    assert 23.0 <= log.flights[-1].missed_at <= 25.0
    assert np.sum(log.misses[:-1] < 0.35) >= 3
    assert log.misses[-1] < scenario.capture_radius - 0.01
    assert log.misses[:-1].min() > scenario.capture_radius + 0.01
    assert all(tick.status == 'optimal' for tick in log.ticks)


class KnownRope:
    """The rope's true future, as a simulator publishes it."""

    def observe(self, sighting):
        pass

    def at(self, times):
        return np.array([retrieval().rope.at(time) for time in times])


@pytest.mark.parametrize(
    'forecast',
    [FORECASTS['harmonic'](), FORECASTS['auto'](), KnownRope()],
    ids=['harmonic', 'auto', 'known'],
)
def test_who_knows_the_swing_catches_the_rope_in_well_under_half_of_the_ticks(forecast):
    ticks = []
    for each in (forecast, FORECASTS['hold']()):
        log = fly(Planner(retrieval_problem()), retrieval(), each)
        assert log.captured
        ticks.append(len(log.ticks))
    assert ticks[0] < 0.4 * ticks[1]


def test_a_command_that_ends_within_a_step_stops_the_vehicle_there():
    flight = departure(retrieval()).after(1.0, np.array([0.4]))
    whole, cut = (flight.after(0.9, np.array([0.6]), held) for held in (np.inf, 0.25))
    start, model = flight.vehicle, retrieval().model
    np.testing.assert_allclose(
        cut.vehicle.position - start.position, 0.25 * (whole.vehicle.position - start.position)
    )
    turned = start.attitude.T @ cut.vehicle.attitude
    assert np.arctan2(turned[1, 0], turned[0, 0]) == pytest.approx(0.15)
    assert cut.speed == cut.vehicle.fraction == 0.0
    assert cut.vehicle.time == start.time + model.step
    assert cut.ticks == whole.ticks
    none = flight.after(0.9, np.array([0.6]), -1.0)
    np.testing.assert_array_equal(none.vehicle.position, start.position)
    np.testing.assert_array_equal(flight.after(0.9, np.array([0.6]), 1.0).vehicle.position,
                                  whole.vehicle.position)  # fmt: skip


def test_a_thrust_that_ends_within_a_step_leaves_the_vehicle_coasting():
    scenario = retrieval()
    model = replace(scenario.model, translation_order=2)
    start = launched(model, np.zeros(2), np.eye(2), fraction=1.0, velocity=np.array([2.0, 0.0]))
    flight = departure(replace(scenario, model=model, start=start)).after(1.0, np.zeros(1), 0.25)
    np.testing.assert_allclose(flight.vehicle.velocity, [2.25, 0.0])
    np.testing.assert_allclose(flight.vehicle.position, [0.25 * 2.0 + 0.75 * 2.25, 0.0])
    assert flight.vehicle.fraction == 0.0


def test_a_rope_caught_before_the_vehicle_stops_is_caught():
    near = replace(retrieval(), rope=fixed(np.array([0.2, 0.05])), capture_radius=0.1)
    caught = departure(near).after(1.0, np.zeros(1), 0.5)
    assert caught.captured
    assert caught.missed_at == pytest.approx(0.2)
    assert not departure(near).after(1.0, np.zeros(1), 0.05).captured


@pytest.mark.parametrize('n', [2, 3])
def test_a_vehicle_that_cannot_stand_circles_without_a_command(n):
    rate = 2.0 * np.pi / (16 * 0.5)  # a circle in 16 steps
    model = Model(n, forward=15.0, step=0.5, failsafe_fraction=0.7, failsafe_rate=rate)
    start = launched(model, np.zeros(n), np.eye(n), fraction=0.7)
    flight = departure(replace(retrieval(), model=model, start=start, rope=fixed(np.full(n, 1e3))))
    for _ in range(16):
        flight = flight.after(0.0, np.zeros(model.rates), 0.0)
        assert flight.speed == pytest.approx(0.7 * 15.0)
    np.testing.assert_allclose(flight.vehicle.position, np.zeros(n), atol=1e-9)
    np.testing.assert_allclose(flight.vehicle.attitude, np.eye(n), atol=1e-9)


def test_the_failsafe_begins_where_the_command_ends():
    model = Model(failsafe_fraction=0.5, failsafe_rate=0.4)
    flight = departure(replace(retrieval(), model=model)).after(1.0, np.zeros(1), 0.25)
    np.testing.assert_allclose(flight.vehicle.position, [0.25 + 0.75 * 0.5, 0.0])
    np.testing.assert_allclose(log(flight.vehicle.attitude), [0.75 * 0.4])
    assert flight.vehicle.fraction == 0.5


def test_who_is_headed_elsewhere_has_not_caught_the_goal():
    ahead = replace(retrieval(), rope=fixed(np.array([1.0, 0.0])), capture_radius=0.3)
    caught = departure(ahead).after(1.0, np.zeros(1))
    assert caught.captured
    for direction, done in (((1.0, 0.0), True), ((1.0, 1.0), False), ((-1.0, 0.0), False)):
        coned = replace(ahead, approach=Approach(0.5, direction))
        flown = departure(coned).after(1.0, np.zeros(1))
        assert flown.near
        assert flown.captured == done
    with pytest.raises(BadInput, match=r'approach\.direction is \[\]'):
        replace(ahead, approach=Approach(0.5))


def test_headings_at_the_closest_approach_are_those_between_the_ends():
    ends = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    cone = Approach(0.1, (3.0, 3.0))
    assert [is_headed(cone, ends, share) for share in (0.0, 0.5, 1.0)] == [False, True, False]
    assert is_headed(Approach(), ends, 0.0)


# --- arrivals

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
