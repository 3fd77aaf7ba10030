# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The Hummingbird in MuJoCo behind the simulator: commands, rope, wind, contacts, seeds."""

import math

import numpy as np
import pytest

pytest.importorskip('rclpy')


from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.sim.engine_vehicle import EnginePlant
from orbimpc_ros.sim.engines import EngineFailure
from orbimpc_ros.sim.simulation import outcome
from orbimpc_ros.sim.vehicle import launched
from orbimpc_ros.sim.world import Rope, Scenario, departure
from orbimpc_ros.tool.study import flights as study
from orbimpc_ros.tool.study.draws import draws_of

STILL, FAR = np.zeros(2), np.array([50.0, 0.0])


@pytest.fixture
def hummingbird():
    pytest.importorskip('mujoco')
    return pytest.importorskip('orbimpc_ros.sim.engines.hummingbird')


def flight_of(rest=FAR, aside=STILL, wind=STILL, **others):
    rope = Rope(np.asarray(rest), np.asarray(aside), 0.0, np.full(2, 0.5 * math.pi))
    model = EnginePlant(
        forward=2.0,
        step=0.1,
        engine='hummingbird',
        rope=rope,
        disturbance=tuple(map(float, wind)),
        **others,
    )
    start = launched(model, np.zeros(2), np.eye(2), fraction=0.0, velocity=STILL)
    return departure(Scenario(model, start, rope, 0.15, 1000))


def flown(flight, seconds, fraction=0.0, turn=0.0):
    """Return the flights, one for each tenth of a second."""
    found = [flight]
    for _ in range(round(10 * seconds)):
        found.append(found[-1].after(fraction, np.array([turn])))
    return found


def test_it_hovers_where_it_starts_in_wind(hummingbird):
    flights = flown(flight_of(wind=[0.0, 2.0]), 2.0)
    vehicle = flights[-1].vehicle
    assert np.hypot(*vehicle.position) < 0.3  # the controller has no integral
    assert np.hypot(*vehicle.velocity) < 0.1
    assert abs(vehicle.height) < 0.1
    assert vehicle.wind.tolist() == [0.0, 2.0]
    assert vehicle.facts['bank'] > 0.02  # it leans against the wind


@pytest.mark.parametrize('turn', [0.5, -0.5])
def test_it_flies_as_fast_and_turns_as_it_is_told(hummingbird, turn):
    vehicle = flown(flight_of(), 3.0, 0.75, turn)[-1].vehicle
    assert vehicle.fraction * 2.0 == pytest.approx(1.5, abs=0.1)
    assert vehicle.body_rate[0] == pytest.approx(turn, abs=0.05)
    assert math.atan2(*vehicle.attitude[::-1, 0]) == pytest.approx(3.0 * turn, abs=0.15)
    assert vehicle.facts['off'] < 0.15


def test_its_own_guidance_brings_the_hook_to_a_waypoint(hummingbird):
    flight = flight_of()
    flight.vehicle.engine.steer_to(np.array([2.0, 1.0]))
    places = [each.vehicle.position for each in flown(flight, 2.0, 1.0, -1.5)]
    assert min(np.hypot(*(place - [2.0, 1.0])) for place in places) < 0.15


def test_the_rope_is_let_go_aside_and_swings(hummingbird):
    flights = flown(flight_of([6.0, 1.0], [0.3, 0.6]), 1.5)
    goals = np.array([each.goal for each in flights]) - [6.0, 1.0]
    np.testing.assert_allclose(goals[0], [0.3, 0.6], atol=1e-6)
    assert goals[:, 1].min() < -0.4  # half a swing later it is on the other side


def test_wind_moves_the_rope(hummingbird):
    flights = flown(flight_of(wind=[0.0, 6.0]), 1.0)
    assert flights[-1].goal[1] > 0.01
    assert flown(flight_of(), 1.0)[-1].goal[1] == pytest.approx(0.0, abs=1e-6)


def test_a_rope_that_the_hook_touches_is_caught(hummingbird):
    flights = flown(flight_of([1.0, 0.1]), 1.4, 1.0)
    caught = next(each for each in flights if each.captured)
    assert caught.miss == pytest.approx(0.1, abs=0.06)  # off the middle of a bar of 0.3 m
    assert caught.over
    assert caught.missed_at < 1.5
    assert flights[0].captured is False


def test_a_rope_that_something_else_touches_first_is_not_caught(hummingbird):
    flights = flown(flight_of([1.0, 0.22]), 1.4, 1.0)
    lost = next(each for each in flights if each.vehicle.lost)
    assert lost.over
    assert outcome(lost).startswith('not captured: something else of the vehicle')
    assert not any(each.captured for each in flights)


def test_a_rope_that_is_passed_is_not_caught(hummingbird):
    flights = flown(flight_of([1.0, 0.6]), 1.2, 1.0)
    assert not any(each.captured for each in flights)
    assert not any(each.vehicle.lost for each in flights)


def test_a_seed_brings_the_same_gusts_again(hummingbird):
    ends = [
        flown(flight_of(turbulence=0.8, seed=seed), 0.5)[-1].vehicle.position for seed in (1, 1, 2)
    ]
    assert np.array_equal(ends[0], ends[1])
    assert not np.array_equal(ends[0], ends[2])


def test_a_motion_that_mujoco_gives_up_is_a_failure(hummingbird):
    flight = flown(flight_of(), 0.2)[-1]
    flight.vehicle.engine._data.qvel[-1] = 1e12
    with pytest.raises(EngineFailure, match=r'mujoco: unstable after t = 0.200 s'):
        flight.after(0.0, np.zeros(1))


def test_a_rope_that_would_be_let_go_too_high_is_refused(hummingbird):
    with pytest.raises(BadInput, match=r'rope.amplitude is \[1.0, 1.0\]; .*at most 1.2 m aside'):
        flight_of(aside=[1.0, 1.0])


@pytest.mark.skipif(not COMPILED, reason='slow in plain Python: pip install numba')
def test_the_planner_catches_the_rope(hummingbird):
    """The first flight of a seed that no study has used."""
    flown_by_us = study.flown(study.Job('rope', 'orbitope', 0, draws_of('rope').of(901, 0)))
    assert flown_by_us['caught']
    assert flown_by_us['time'] < 15.0
    assert flown_by_us['off'] < 0.5
