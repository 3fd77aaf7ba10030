# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The discrete dynamics: rollouts, inputs and linear maps all say the same."""

import numpy as np
import pytest
from problems import ORDERS, goals, state, weights

from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Problem


def step_by_step(problem, start, rotations):
    """The equations as they stand, one at a time."""
    h, z = problem.step, problem.forward
    position, velocity = start.position, start.velocity
    positions = [position]
    for r in rotations[:-1]:
        if problem.translation_order == 1:
            position = position + h * z * r[:, 0]
        else:
            position, velocity = position + h * velocity, velocity + h * z * r[:, 0]
        positions.append(position)
    return np.array(positions)


def turned_step_by_step(problem, rotation, rate, inputs):
    """R_{k+1} = R_k + h u_k, or W_{k+1} = W_k + h u_k and R_{k+1} = R_k + h W_k."""
    turned = [rotation]
    for u in inputs:
        moved = u if problem.rotation_order == 1 else rate
        turned.append(turned[-1] + problem.step * moved)
        rate = rate + problem.step * u
    return np.array(turned)


@pytest.mark.parametrize('orders', ORDERS)
@pytest.mark.parametrize('seed', range(3))
def test_maps_rollouts_and_equations_agree(orders, seed):
    rng = np.random.default_rng(seed)
    problem = Problem(**orders, horizon=6, step=rng.uniform(0.1, 2), forward=rng.uniform(0.5, 2))
    start = state(rng, problem, full_speed=False)
    x = rng.uniform(-1, 1, size=(6, 2 if problem.dimension == 2 else 9))
    flown = trajectory_of(problem, start, goals(rng, problem), x)
    assert np.allclose(coordinates(flown.rotations[1:]), x)
    assert np.allclose(flown.positions, step_by_step(problem, start, flown.rotations), atol=1e-12)
    mapped = dynamics.drift(problem, start) + problem.maps.reach @ flown.headings
    assert np.allclose(flown.positions[1:], mapped, atol=1e-12)
    first_rate = (flown.rotations[1] - flown.rotations[0]) / problem.step
    turned = turned_step_by_step(problem, flown.rotations[0], first_rate, flown.inputs)
    assert np.allclose(turned, flown.rotations, atol=1e-10)
    inputs = np.einsum('kj,jab->kab', dynamics.input_map(problem), flown.rotations)
    assert np.allclose(flown.inputs[: len(inputs)], inputs, atol=1e-9)


@pytest.mark.parametrize('translation_order', [1, 2])
@pytest.mark.parametrize('seed', range(5))
def test_the_condensed_quadratic_is_the_objective(translation_order, seed):
    rng = np.random.default_rng(seed)
    problem = Problem(translation_order=translation_order, horizon=5, weights=weights(rng))
    start, targets = state(rng, problem, full_speed=False), goals(rng, problem)
    z = rng.uniform(-0.7, 0.7, size=(5, 2))
    condensed = Condensed(problem)
    q, c = condensed.affine(start, targets)
    quadratic = np.sum(z * (0.5 * condensed.hessian @ z + q)) + c
    length = problem.weights.length * problem.step * problem.forward
    quadratic += length * np.linalg.norm(z[:-1], axis=1).sum()
    assert quadratic == pytest.approx(trajectory_of(problem, start, targets, z).cost, rel=1e-12)
