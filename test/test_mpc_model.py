# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The discrete model: rollouts, maps, inputs, the condensed quadratic, and what weights mean."""

from dataclasses import replace

import numpy as np
import pytest
from plans import assembled
from problems import CASES, ORDERS, disturbed, goals, weights

from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.model.dynamics import trajectory_of
from orbimpc_ros.mpc.problem import Problem, State, Weights
from orbimpc_ros.mpc.problem.case import case_of
from orbimpc_ros.mpc.problem.scaling import weighed
from orbimpc_ros.mpc.problem.units import Units

MODELS = [{**orders, 'discretisation': how} for orders in ORDERS for how in ('euler', 'exact')]
MODELS += [{**each, 'discretisation': 'held'} for each in ORDERS if each['translation_order'] == 2]
SPEEDS = [(0.02, 0.1), (0.7, 3.0), (2.0, 1000.0)]


@pytest.mark.parametrize('model', MODELS)
def test_rollouts_maps_and_inputs_are_the_steps_of_the_model(model):
    """As the check rolls them out; that these are the steps as stated, convex optima hold."""
    rng = np.random.default_rng([*map(ord, str(model))])
    problem = Problem(**model, horizon=6, step=rng.uniform(0.1, 2), forward=1.7)
    start, targets = disturbed(rng, problem), goals(rng, problem)
    x = rng.uniform(-1, 1, size=(6, 2 if problem.dimension == 2 else 9))
    flown = trajectory_of(problem, start, targets, x)
    plan = assembled(problem, start, targets, x)
    assert not [each for each in violations(problem, start, targets, plan) if 'differ' in each]
    mapped = dynamics.drift(problem, start) + problem.maps.reach @ flown.headings
    np.testing.assert_allclose(mapped, flown.positions[1:], atol=1e-11)
    assert np.allclose(coordinates(flown.rotations[1:]), x)
    inputs = np.einsum('kj,jab->kab', dynamics.input_map(problem), flown.rotations)
    np.testing.assert_allclose(flown.inputs[: len(inputs)], inputs, atol=1e-9)


@pytest.mark.parametrize('order', [1, 2])
def test_exact_steps_follow_a_vehicle_that_turns_evenly(order):
    """A fine integration of constant thrust on an axis that turns evenly, 0.3 rad in each step."""
    exact = Problem(2, 1, order, horizon=5, discretisation='exact')
    fine = Problem(2, 1, order, horizon=500, step=0.01, discretisation='exact')
    start = State.at([0.0, 0.0], np.eye(2), velocity=[0.0, 0.0], disturbance=[0.1, -0.2])

    def end(problem, turn):
        angles = turn * problem.step * np.arange(problem.horizon + 1)
        axes = np.column_stack([np.cos(angles), np.sin(angles)])
        return dynamics.translation_rollout(problem, start, axes)[0][-1]

    def error(problem, turn):
        return np.linalg.norm(end(problem, turn) - end(fine, turn))

    assert error(exact, 0.3) < 0.1 * error(replace(exact, discretisation='euler'), 0.3)
    assert error(exact, 0.3) / error(exact, 0.15) == pytest.approx(4.0, abs=0.3)  # second order


# --- units and weights


@pytest.mark.parametrize('orders', ORDERS)
@pytest.mark.parametrize(('step', 'forward'), SPEEDS)
def test_natural_units_have_steps_of_one_and_a_hessian_of_one(orders, step, forward):
    rng = np.random.default_rng(3)
    problem = Problem(**orders, step=step, forward=forward, weights=weights(rng))
    units = Units.of(problem)
    assert (units.problem.step, units.problem.forward) == (1.0, 1.0)
    diagonal = np.diag(Condensed(units.problem).hessian)
    assert max(diagonal.max(), units.problem.weights.length) == pytest.approx(1.0)
    unit = Problem(**orders, weights=problem.weights)
    natural, again = (Units.of(weighed(each, 'time')).problem for each in (unit, problem))
    for name in ('position', 'input', 'length', 'terminal'):
        one, two = getattr(natural.weights, name), getattr(again.weights, name)
        assert two == pytest.approx(one, rel=1e-12)


def test_the_paper_means_sums_and_the_weight_of_the_attitude_has_no_unit():
    problem = Problem(step=0.1, forward=30.0, weights=Weights(attitude=4.0))
    assert weighed(problem, 'paper') is problem
    assert weighed(problem, 'time').weights.attitude == 4.0


def test_a_case_may_state_what_its_weights_mean():
    plain = {**CASES['uav_hull_1'], 'step': 0.5, 'forward': 2.0}
    timed = {**plain, 'weights': {**plain['weights'], 'scaling': 'time'}}
    assert case_of(timed).problem == weighed(case_of(plain).problem, 'time')
