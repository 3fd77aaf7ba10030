# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Laws of the simulated vehicle: it does what the planner's dynamics say, and stays on SO(n)."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scenarios import model_of

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.sim.vehicle import Model, advance, launched

ALL_ORDERS = list(itertools.product((2, 3), (1, 2), (1, 2)))


def drawn(model, rng, attitude=None):
    """Return a vehicle in a random state."""
    n = model.dimension
    return launched(
        model,
        rng.normal(size=n),
        exp(rng.normal(size=model.rates)) if attitude is None else attitude,
        fraction=rng.uniform(),
        velocity=rng.normal(size=n),
        body_rate=rng.normal(size=model.rates),
    )


@pytest.mark.parametrize('discretisation', ['euler', 'exact'])
@pytest.mark.parametrize(('n', 'rotation', 'translation'), ALL_ORDERS)
def test_the_vehicle_moves_as_the_planners_dynamics(n, rotation, translation, discretisation):
    rng = np.random.default_rng(1)
    orders, w = (n, rotation, translation), rng.normal(size=n)
    problem = Problem(*orders, 9, step=0.3, forward=1.7, discretisation=discretisation)
    model = replace(model_of(problem), disturbance=tuple(w))
    flown = [drawn(model, rng)]
    for _ in range(problem.horizon):
        flown.append(advance(model, flown[-1], rng.uniform(), rng.normal(size=model.rates)))
    state = State.at(flown[0].position, np.eye(n), velocity=flown[0].velocity, disturbance=w)
    headings = np.array([v.fraction * v.attitude[:, 0] for v in flown])
    positions, velocities = dynamics.translation_rollout(problem, state, headings)
    np.testing.assert_allclose([v.position for v in flown], positions, atol=1e-12)
    np.testing.assert_allclose([v.velocity for v in flown], velocities, atol=1e-12)


@pytest.mark.parametrize(('n', 'rotation', 'translation'), ALL_ORDERS)
def test_a_command_is_taken_over_at_the_end_of_the_step(n, rotation, translation):
    rng = np.random.default_rng(2)
    model = Model(n, rotation, translation, step=0.5)
    old = drawn(model, rng)
    rate = rng.normal(size=model.rates)
    new = advance(model, old, 0.25, rate)
    turned = rate if rotation == 1 else old.body_rate
    np.testing.assert_allclose(new.attitude, old.attitude @ exp(0.5 * turned), atol=1e-12)
    np.testing.assert_allclose(new.body_rate, rate)
    assert new.fraction == 0.25
    other = advance(model, old, 1.0, rate)
    np.testing.assert_allclose(new.position, other.position)  # the old thrust flew this step


@pytest.mark.parametrize('n', [2, 3])
def test_the_attitude_stays_a_rotation(n):
    rng = np.random.default_rng(3)
    model = Model(n)
    vehicle = drawn(model, rng)
    for _ in range(2000):
        vehicle = advance(model, vehicle, 1.0, rng.normal(size=model.rates))
    residual = vehicle.attitude.T @ vehicle.attitude - np.eye(n)
    assert np.abs(residual).max() < 1e-12
    assert np.linalg.det(vehicle.attitude) == pytest.approx(1.0)


@pytest.mark.parametrize('asked', [-3.0, 7.0])
def test_the_speed_fraction_is_clipped(asked):
    model = Model()
    vehicle = advance(model, launched(model, np.zeros(2), np.eye(2)), asked, np.zeros(1))
    assert vehicle.fraction == np.clip(asked, 0.0, 1.0)


def test_nonsense_is_refused():
    vehicle = launched(Model(), np.zeros(2), np.eye(2))
    for field, value in (
        ('position', [np.nan, 0.0]),
        ('fraction', 1.5),
        ('velocity', [1.0, 2.0, 3.0]),
        ('time', np.inf),
    ):
        with pytest.raises(BadInput, match=r'start\.'):
            replace(vehicle, **{field: value})
