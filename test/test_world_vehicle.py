# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Laws of the simulated vehicle: it follows the planner's dynamics and stays on SO(n)."""

import math
from dataclasses import replace

import numpy as np
import pytest
from problems import ORDERS
from scenarios import model_of
from scipy.integrate import solve_ivp
from stepping import launched

from orbimpc_ros.mpc.geometry.rotations import exp, skew
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.sim import vehicle
from orbimpc_ros.sim.parameters import SimSettings
from orbimpc_ros.sim.vehicle import Model, Plant, gusts, measured
from orbimpc_ros.sim.world import departure


def drawn(model, rng, turning=1.0):
    """Return a vehicle in a random state."""
    (place, velocity), share = rng.normal(size=(2, model.dimension)), rng.uniform()
    attitude, rate = exp(rng.normal(size=model.rates)), turning * rng.normal(size=model.rates)
    return launched(model, place, attitude, fraction=share, velocity=velocity, body_rate=rate)


def stepped(model, vehicle, fraction, rate):
    return model.flown(vehicle, model.step, fraction, rate)[-1]


@pytest.mark.parametrize('discretisation', ['euler', 'exact'])
@pytest.mark.parametrize('orders', ORDERS)
def test_the_vehicle_moves_as_the_planners_dynamics(orders, discretisation):
    rng, n = np.random.default_rng(1), orders['dimension']
    w, known = rng.normal(size=n), {**orders, 'discretisation': discretisation}
    problem = Problem(**known, horizon=9, step=0.3, forward=1.7)
    model = replace(model_of(problem), disturbance=tuple(w))
    flown = [drawn(model, rng)]
    for _ in range(problem.horizon):
        flown.append(stepped(model, flown[-1], rng.uniform(), rng.normal(size=model.rates)))
    state = State.at(flown[0].position, np.eye(n), velocity=flown[0].velocity, disturbance=w)
    headings = np.array([v.fraction * v.attitude[:, 0] for v in flown])
    positions, velocities = dynamics.translation_rollout(problem, state, headings)
    np.testing.assert_allclose([v.position for v in flown], positions, atol=1e-12)
    np.testing.assert_allclose([v.velocity for v in flown], velocities, atol=1e-12)


@pytest.mark.parametrize('orders', ORDERS)
def test_a_command_is_taken_over_at_the_end_of_the_step(orders):
    rng, model = np.random.default_rng(2), Model(**orders, step=0.5)
    old = drawn(model, rng)
    rate = rng.normal(size=model.rates)
    new = stepped(model, old, 0.25, rate)
    turned = rate if model.rotation_order == 1 else old.body_rate
    np.testing.assert_allclose(new.attitude, old.attitude @ exp(0.5 * turned), atol=1e-12)
    np.testing.assert_allclose(new.body_rate, rate)
    assert new.fraction == 0.25
    more, less = (stepped(model, old, fraction, rate) for fraction in (7.0, -3.0))
    assert (more.fraction, less.fraction) == (1.0, 0.0)
    np.testing.assert_allclose(new.position, more.position)  # the old thrust flew this step


# --- in continuous time


def plant_of(n=2, order=1, *, wind=(), **others):
    values = {'step': 0.5, 'forward': 15.0} | others
    return Plant(n, 1, order, disturbance=tuple(wind), **values)


def flight(goal=(1e5, 1e5), **own):
    """Return a flight at its start at the origin, with a goal at rest."""
    known = {'vehicle': 'continuous', 'step': 2.0, 'forward': 15.0, 'capture_radius': 1.0} | own
    rope = {'rope_center': tuple(goal), 'rope_amplitude': (0.0, 0.0, 0.0)}
    return departure(SimSettings(**known, **rope, max_ticks=1000))


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('order', [1, 2])
def test_it_agrees_with_an_integrator_of_any_accuracy(n, order):
    """With lags, gain, wind, drag and limits at once, from any attitude."""
    rng = np.random.default_rng(2)
    for most in (0.0, 9.0, 0.4, 0.2):
        own = {'max_acceleration': 4.0} if order == 1 else {'drag': 0.3}
        own |= {'speed_lag': 0.8, 'rate_lag': 0.3, 'gain': 0.9, 'max_rate': most}
        plant = plant_of(n, order, wind=rng.normal(size=n), **own)
        vehicle, rate, t = drawn(plant, rng, turning=0.3), rng.normal(size=plant.rates), 1.3
        end = plant.flown(vehicle, t, 0.6, rate)[-1]
        position, velocity, attitude, body_rate, fraction = integrated(plant, vehicle, t, 0.6, rate)
        np.testing.assert_allclose(end.body_rate, body_rate, atol=1e-9)
        assert end.fraction == pytest.approx(fraction, abs=1e-6)
        np.testing.assert_allclose(end.attitude, attitude, atol=1e-4)
        np.testing.assert_allclose(end.position, position, atol=1e-4)
        np.testing.assert_allclose(end.velocity, velocity, atol=1e-4)


def integrated(plant, vehicle, time, fraction, rate):
    """Return position, velocity, attitude, body rate and fraction by SciPy's integrator."""
    n, order = plant.dimension, plant.translation_order
    limit = plant.max_acceleration / (plant.forward * plant.gain) or math.inf
    pull, size = plant.blown, float(np.linalg.norm(rate))
    rate = rate * min(1.0, (plant.max_rate or math.inf) / size)

    def slope(_t, state):
        velocity, attitude = state[n : 2 * n], state[2 * n : 2 * n + n * n].reshape(n, n)
        body_rate, share = state[2 * n + n * n : -1], state[-1]
        pushed = plant.gain * plant.forward * share * attitude[:, 0] + pull
        return np.concatenate(
            [
                pushed if order == 1 else velocity,
                pushed - plant.drag * velocity,
                (attitude @ skew(body_rate)).ravel(),
                (rate - body_rate) / plant.rate_lag,
                [np.clip((fraction - share) / plant.speed_lag, -limit, limit)],
            ]
        )

    start = np.concatenate(
        [
            vehicle.position,
            vehicle.velocity,
            vehicle.attitude.ravel(),
            vehicle.body_rate,
            [vehicle.fraction],
        ]
    )
    end = solve_ivp(slope, (0.0, time), start, rtol=1e-11, atol=1e-11, max_step=0.01).y[:, -1]
    attitude = end[2 * n : 2 * n + n * n].reshape(n, n)
    pushed = plant.gain * plant.forward * end[-1] * attitude[:, 0] + pull
    velocity = pushed if order == 1 else end[n : 2 * n]
    return end[:n], velocity, attitude, end[2 * n + n * n : -1], end[-1]


def test_odometry_measures_over_ground_or_through_the_air():
    plant = plant_of(wind=[0.0, 4.0])
    vehicle = launched(plant, np.zeros(2), np.eye(2), fraction=0.3)
    vehicle = plant.flown(vehicle, 1.0, 0.8, np.zeros(1))[-1]  # obeyed at once: it has no lag
    np.testing.assert_allclose(measured(vehicle).body_velocity, [12.0, 4.0])
    np.testing.assert_allclose(measured(vehicle, 'air').body_velocity, [12.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(vehicle.position, [12.0, 4.0])
    assert vehicle.airspeed == pytest.approx(12.0)


def test_each_fall_below_the_stall_speed_counts_once():
    now = flight(speed_lag=0.3, stall_speed=10.0)
    for fraction in (1.0, 0.5, 0.4, 1.0, 10.0 / 15.0, 0.5, 1.0):
        now = now.after(fraction, np.zeros(1))
    assert (now.stalls, now.stalled) == (2, False)
    assert 6.0 < now.least_airspeed < 6.1  # [m/s]: 0.4 * 15 after 2 s of a lag of 0.3 s
    assert now.after(0.5, np.zeros(1)).stalled


def test_a_flight_catches_between_its_steps_where_it_flew():
    """On an arc that is 3.7 m off the step's chord."""
    trail = flight().after(1.0, np.array([0.5])).trail
    caught = flight(trail[50].position).after(1.0, np.array([0.5]))
    assert caught.miss == pytest.approx(0.0, abs=1e-9)
    assert caught.missed_at == pytest.approx(trail[50].time)
    assert caught.captured


LONG = 4_000.0  # [s] of a long series


def series(times, memory=3.0, seed=5):
    return np.array([gusts(t, 2, memory, seed) for t in times])


@pytest.mark.parametrize('memory', [0.5, 3.0])
def test_gusts_have_the_memory_asked_for(memory):
    """To within four standard errors, given the number of independent gusts in the series."""
    blown = series(np.arange(0.0, LONG, 0.5), memory, 7)
    error = 4.0 * np.sqrt(2.0 * memory / LONG)
    np.testing.assert_allclose(blown.mean(axis=0), 0.0, atol=error)
    np.testing.assert_allclose(blown.var(axis=0), 1.0, atol=error + 0.02 / memory)
    later = round(memory / 0.5)
    correlation = (blown[later:] * blown[:-later]).mean(axis=0)
    np.testing.assert_allclose(correlation, np.exp(-1.0), atol=error)
    assert abs((blown[:, 0] * blown[:, 1]).mean()) < error


def test_a_seed_brings_the_same_gusts_in_whatever_order_they_are_asked_for():
    times = np.random.default_rng(1).uniform(0.0, 100.0, size=200)
    first, order = series(times), np.argsort(times)
    np.testing.assert_array_equal(series(times[order]), first[order])
    assert not np.allclose(series([1.0], seed=6), series([1.0]))


def test_the_first_gust_is_as_strong_as_any():
    begun = np.array([gusts(0.0, 3, 5.0, seed) for seed in range(400)])
    assert begun.std() == pytest.approx(1.0, rel=4.0 / np.sqrt(2 * begun.size))


def test_gusts_are_there_before_a_flight_in_real_time_begins():
    plant = Plant(gust=1.0, seed=4242)
    drawn = vehicle._series.cache_info().misses
    plant.flown(departure(SimSettings()).vehicle, 0.1, 1.0, np.zeros(1))
    assert vehicle._series.cache_info().misses == drawn


def test_gusts_never_jump():
    """Neither between samples nor between blocks of them do increments exceed the expected size."""
    steps = np.diff(series(np.arange(0.0, 100.0, 0.01)), axis=0)
    assert np.abs(steps).max() < 5.0 * np.sqrt(2.0 * 0.02 / 3.0)


@pytest.mark.parametrize('n', [2, 3])
def test_the_attitude_stays_a_rotation(n):
    rng = np.random.default_rng(3)
    model = Model(n)
    vehicle = drawn(model, rng)
    for _ in range(2000):
        vehicle = stepped(model, vehicle, 1.0, rng.normal(size=model.rates))
    residual = vehicle.attitude.T @ vehicle.attitude - np.eye(n)
    assert np.abs(residual).max() < 1e-12
    assert np.linalg.det(vehicle.attitude) == pytest.approx(1.0)
