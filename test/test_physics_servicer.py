# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The servicer in Basilisk behind the simulator: orbits, thrust, turns, errors, failures."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

pytest.importorskip('rclpy')


from orbimpc_ros.mpc.geometry.rotations import exp, log
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.sim.engine_vehicle import EnginePlant
from orbimpc_ros.sim.engines import EngineFailure
from orbimpc_ros.sim.vehicle import launched
from orbimpc_ros.sim.world import Scenario, departure, fixed
from orbimpc_ros.tool.study import flights as study
from orbimpc_ros.tool.study.draws import draws_of

REASON = "Basilisk is not installed: pip install 'orbimpc_ros[basilisk]' runs this"
STILL, AWAY = np.zeros(3), np.array([30.0, -20.0, 10.0])
TURNED = exp(np.array([0.4, -0.7, 1.1]))
FULL = 0.015  # [m/s^2]


@pytest.fixture
def servicer():
    return pytest.importorskip('orbimpc_ros.sim.engines.servicer', reason=REASON)


def flight_of(goal=AWAY, velocity=STILL, rate=STILL, push=STILL, **others):
    model = EnginePlant(
        3,
        translation_order=2,
        step=5.0,
        forward=FULL,
        mass=60.0,
        engine='servicer',
        rope=fixed(goal),
        disturbance=tuple(map(float, push)),
        **others,
    )
    start = launched(model, STILL, TURNED, fraction=0.0, velocity=velocity, body_rate=rate)
    return departure(Scenario(model, start, fixed(goal), 0.1, 1000, finish='arrival'))


def flown(flight, seconds, fraction=0.0, rate=STILL):
    """Return the flights, one for each five seconds."""
    found = [flight]
    for _ in range(round(seconds / 5.0)):
        found.append(found[-1].after(fraction, np.asarray(rate)))
    return found


def test_it_starts_as_it_is_told(servicer):
    velocity, rate = np.array([0.1, 0.2, -0.3]), np.array([0.01, 0.0, -0.02])
    vehicle = flight_of(velocity=velocity, rate=rate).vehicle
    np.testing.assert_allclose(vehicle.position, STILL, atol=1e-8)
    np.testing.assert_allclose(vehicle.velocity, velocity, atol=1e-10)
    np.testing.assert_allclose(vehicle.attitude, TURNED, atol=1e-12)
    np.testing.assert_allclose(vehicle.body_rate, rate, atol=1e-12)
    assert vehicle.fraction == 0.0


def falling(_time, state):
    """Of a point around the Earth; state: place and velocity."""
    return np.append(state[3:], -3.986004418e14 * state[:3] / np.linalg.norm(state[:3]) ** 3)


def test_the_earth_pulls_it_and_its_client_differently(servicer, monkeypatch):
    monkeypatch.setattr(servicer, 'OFF_CENTER', 0.0)
    client = np.array([6.878e6, 0.0, 0.0, 0.0, math.sqrt(3.986004418e14 / 6.878e6), 0.0])
    ends = [
        solve_ivp(falling, (0.0, 300.0), state, method='DOP853', rtol=1e-13, atol=1e-7).y[:3, -1]
        for state in (client, client - np.append(AWAY, STILL))
    ]
    drifted = flown(flight_of(), 300.0)[-1].vehicle.position
    np.testing.assert_allclose(drifted, AWAY + ends[1] - ends[0], atol=1e-5)
    assert np.linalg.norm(drifted) > 1.0


def test_pulses_come_to_the_thrust_that_is_commanded(servicer, monkeypatch):
    for name in ('OFF_CENTER', 'OFF_FORCE', 'OFF_AXIS'):
        monkeypatch.setattr(servicer, name, 0.0)
    vehicle = flown(flight_of(STILL), 60.0, 0.5)[-1].vehicle
    np.testing.assert_allclose(vehicle.velocity, 60.0 * 0.5 * FULL * TURNED[:, 0], atol=0.02)
    assert vehicle.fraction == pytest.approx(0.5, abs=0.05)
    assert vehicle.facts['pointing'] < 1e-3


def test_a_push_that_nothing_explains_moves_it(servicer):
    push = np.array([1e-3, 0.0, -2e-3])
    pushed, alone = (flown(flight_of(push=each), 20.0)[-1].vehicle for each in (push, STILL))
    np.testing.assert_allclose(pushed.velocity - alone.velocity, 20.0 * push, atol=1e-5)


@pytest.mark.parametrize('rate', [[0.05, -0.1, 0.15], [-0.2, 0.05, 0.0]])
def test_it_turns_at_the_rate_that_is_commanded(servicer, rate):
    before, after = (each.vehicle for each in flown(flight_of(), 20.0, 0.3, rate)[-2:])
    np.testing.assert_allclose(after.body_rate, rate, atol=2e-3)
    turned = log(before.attitude.T @ after.attitude)
    np.testing.assert_allclose(turned, 5.0 * np.array(rate), atol=5e-3)
    assert 0.0 < after.facts['pointing'] < 0.05
    assert after.facts['wheel'] > 1.0


def test_a_seed_brings_the_same_vehicle_again(servicer):
    ends = [flown(flight_of(seed=seed), 20.0, 1.0)[-1].vehicle.position for seed in (1, 1, 2)]
    assert np.array_equal(ends[0], ends[1])
    assert np.linalg.norm(ends[0] - ends[2]) > 1e-3


def test_an_error_of_basilisk_is_a_failure(servicer, monkeypatch):
    def failing(*_words):
        raise servicer.bskLogging.BasiliskError('the task list is empty')

    flight = flight_of()
    monkeypatch.setattr(flight.vehicle.engine._simulation, 'StepUntilStop', failing)
    with pytest.raises(EngineFailure, match='basilisk: the task list is empty'):
        flight.after(0.0, STILL)


@pytest.mark.skipif(not COMPILED, reason='slow in plain Python: pip install numba')
def test_the_planner_arrives(servicer):
    """The first flight of a seed that no study has used."""
    flown_by_us = study.flown(study.Job('servicer', 'orbitope', 0, draws_of('servicer').of(901, 0)))
    assert flown_by_us['caught']
    assert flown_by_us['missed'] < 0.1
    assert flown_by_us['speed'] < 0.05
    assert 0.0 < flown_by_us['pointing'] < 0.1
