# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The Cessna of JSBSim behind the simulator: axes, wind, limits, seeds."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import trapezoid

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.sim.engine_vehicle import EnginePlant
from orbimpc_ros.sim.engines import Start
from orbimpc_ros.sim.faults import Faults, View
from orbimpc_ros.sim.vehicle import launched
from orbimpc_ros.sim.world import Scenario, departure, fixed

WIND = np.array([-4.0, 6.0])
FAR = np.array([1e5, 0.0])


@pytest.fixture
def cessna():
    return pytest.importorskip('orbimpc_ros.sim.engines.cessna')


def flight_of(heading=0.0, wind=WIND, goal=FAR, **others):
    model = EnginePlant(forward=50.0, step=1.0, disturbance=tuple(wind), **others)
    cos, sin = math.cos(heading), math.sin(heading)
    start = launched(model, np.zeros(2), np.array([[cos, -sin], [sin, cos]]), fraction=0.9)
    return departure(Scenario(model, start, fixed(goal), 5.0, 1000, rope_length=40.0))


def flown(flight, seconds, fraction=0.9, turn=0.0):
    """Return the flights, one for each second."""
    found = [flight]
    for _ in range(seconds):
        found.append(found[-1].after(fraction, np.array([turn])))
    return found


@pytest.mark.parametrize('heading', [0.4, 2.5, -1.9])
def test_it_starts_in_level_flight_through_air_that_moves(cessna, heading):
    vehicle = flight_of(heading).vehicle
    axis = np.array([math.cos(heading), math.sin(heading)])
    np.testing.assert_allclose(vehicle.wind, WIND, atol=1e-6)
    np.testing.assert_allclose(vehicle.velocity - WIND, 45.0 * axis, atol=0.1)
    np.testing.assert_allclose(vehicle.attitude[:, 0], axis, atol=1e-3)
    assert vehicle.airspeed == pytest.approx(45.0, abs=0.01)


@pytest.mark.parametrize('heading', [0.4, -1.9])
def test_positions_follow_velocities(cessna, heading):
    """The globe is turned into a plane well enough, in both of its directions."""
    trail = [v for each in flown(flight_of(heading), 40)[1:] for v in each.trail]
    times = np.array([v.time for v in trail])
    way = trapezoid([v.velocity for v in trail], times, axis=0)
    np.testing.assert_allclose(trail[-1].position - trail[0].position, way, rtol=1e-4)


@pytest.mark.parametrize('turn', [0.06, -0.06])
def test_it_turns_as_it_is_told_within_its_bank(cessna, turn):
    flights = flown(flight_of(wind=np.zeros(2)), 30, turn=turn)
    late = flights[10:]
    yaws = np.unwrap([math.atan2(*f.vehicle.attitude[::-1, 0]) for f in late])
    assert np.diff(yaws).mean() == pytest.approx(turn, rel=0.1)
    assert late[-1].vehicle.body_rate[0] == pytest.approx(turn, rel=0.1)
    banks = [v.facts['bank'] for f in flights[1:] for v in f.trail]
    assert math.copysign(1.0, banks[-1]) == math.copysign(1.0, turn)
    assert max(map(abs, banks)) < math.radians(30.0)


def test_it_tends_to_the_airspeed_that_it_is_told(cessna):
    slow, fast = (flown(flight_of(), 60, fraction)[-1].vehicle for fraction in (0.8, 1.0))
    assert slow.airspeed == pytest.approx(40.0, abs=1.5)
    assert fast.airspeed == pytest.approx(50.0, abs=1.5)


def test_throttles_are_those_of_the_engines_own_trim(cessna):
    for speed, throttle in zip(cessna.SPEEDS, cessna.THROTTLES, strict=True):
        still = np.zeros(2)
        start = Start(still, still, np.eye(2), np.zeros(1), speed, still, 0.0, 0, still, still)
        assert cessna.Cessna(start).motion().facts['throttle'] == pytest.approx(throttle, abs=2e-3)


def test_its_own_guidance_flies_to_a_waypoint(cessna):
    flight = flight_of(wind=np.array([3.0, 0.0]))
    flight.vehicle.engine.steer_to([600.0, 400.0])
    flights = flown(flight, 40, turn=-0.09)
    assert min(np.hypot(*(f.vehicle.position - [600.0, 400.0])) for f in flights) < 50.0


def test_a_seed_brings_the_same_air_again(cessna):
    ends = [
        flown(flight_of(turbulence=1.0, seed=seed), 10)[-1].vehicle.position for seed in (1, 1, 2)
    ]
    assert np.array_equal(ends[0], ends[1])
    assert not np.array_equal(ends[0], ends[2])


def test_turbulence_is_as_strong_as_is_said(cessna):
    flights = flown(flight_of(turbulence=1.0, seed=3), 300)
    felt = np.array([v.wind - WIND for f in flights[1:] for v in f.trail])
    assert 0.6 < felt.std() < 1.4


def test_a_point_is_missed_by_height_and_a_line_is_not(cessna):
    flights = flown(flight_of(wind=np.zeros(2), goal=np.array([200.0, 0.0])), 6)
    best = min(flights, key=lambda each: each.miss)
    height = abs(best.vehicle.height)
    assert best.captured
    assert best.miss < 2.0 < height
    point = replace(best.scenario, rope_length=0.0)
    again = departure(point)
    assert min(f.miss for f in flown(again, 6)) == pytest.approx(height, abs=1.0)


def test_odometry_may_come_late(cessna):
    flights = flown(flight_of(), 3)
    view = View(Faults(delay=0.4), 0, 1.0)
    seen = [view.of(flight)[-1].content for flight in flights]
    assert seen[-1].time == pytest.approx(2.6)
    assert flights[2].vehicle.position[0] < seen[-1].position[0] < flights[3].vehicle.position[0]


def test_a_start_that_cannot_be_flown_is_refused(cessna):
    model = EnginePlant(forward=50.0)
    start = launched(model, np.zeros(2), np.eye(2), fraction=0.2)
    with pytest.raises(BadInput, match=r'start.speed_fraction is 0.2; .*no level flight'):
        model.begun(start)
