# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A floor and a model that the package does not have: every part of it handles them."""

import numpy as np
import pytest
from oracles import enumerated
from problems import CASES
from scipy.optimize import minimize

from orbimpc_ros.loop.fallback import safe_command
from orbimpc_ros.mpc.check import flaw, violations
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.model.dynamics import trajectory_of
from orbimpc_ros.mpc.model.translation import TRANSLATIONS, Translation
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.mpc.problem.case import case_of
from orbimpc_ros.mpc.problem.floor import SHAPES
from orbimpc_ros.mpc.proof.document import Unproved, certificate_of
from orbimpc_ros.mpc.sensitivity import explained
from orbimpc_ros.mpc.solve.solver import Solver

DRAG, KEPT = 3, 0.8  # the model's translation_order, and the share of velocity kept in a step
BEHIND = np.tile([-3.0, 1.0], (5, 1))


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """Register both for one test at a time: what is allowed elsewhere depends on the registries."""
    monkeypatch.setitem(SHAPES, 'eastward', lambda n, _: np.eye(n)[:1])
    monkeypatch.setitem(TRANSLATIONS, DRAG, Translation((0, 1), (0, 0), kept=KEPT))


def east(fraction=0.5):
    return Floor('eastward', fraction=fraction)


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize('limits', [{}, {'max_rate': 0.5}, {'rotation_order': 2}])
def test_plans_keep_to_a_new_floor(dimension, limits):
    problem = Problem(dimension, floor=east(), **limits)
    turned = np.eye(dimension)
    start = State.at(np.zeros(dimension), 0.6 * turned, coasted=turned)
    goals = np.tile(BEHIND[0, [0, 1, 1][:dimension]], (5, 1))
    plan = Solver(problem, coasting=True).solve(start, goals)
    assert plan.lower_bound == 0.0
    with pytest.raises(Unproved, match='no proof'):  # certificates cannot state this floor
        certificate_of(problem, start, goals, plan.proof)
    first = 1 if problem.rotation_order == 1 else 2
    assert plan.rotations[first:, 0, 0].min() >= 0.5 - 1e-6
    assert plan.rotations[first:, 0, 0].min() <= 0.5 + 1e-4  # the goal is in the other direction


def test_the_optimum_above_a_new_floor_is_that_of_an_independent_solver():
    problem = Problem(floor=east(0.4))
    start = State.at(np.zeros(2), 0.6 * np.eye(2))
    plan = Solver(problem, gap_tolerance=1e-8).solve(start, BEHIND)
    assert plan.objective == pytest.approx(enumerated(problem, start, BEHIND), rel=1e-5)


def test_the_optimum_of_a_new_model_is_that_of_an_independent_solver():
    problem = Problem(2, 1, DRAG)
    start = State.at(np.zeros(2), 0.6 * np.eye(2), velocity=np.array([0.0, 0.3]))
    plan = Solver(problem, gap_tolerance=1e-8).solve(start, BEHIND)

    def cost(x):
        return trajectory_of(problem, start, BEHIND, x.reshape(5, 2)).objective

    disks = {'type': 'ineq', 'fun': lambda x: 1.0 - (x.reshape(5, 2) ** 2).sum(axis=1)}
    least = minimize(cost, np.zeros(10), method='SLSQP', constraints=disks, tol=1e-12).fun
    assert plan.objective == pytest.approx(least, rel=1e-5)


def test_the_check_the_last_look_and_the_prices_see_a_new_floor():
    start = State.at(np.zeros(2), 0.6 * np.eye(2))
    free = Solver(Problem()).solve(start, BEHIND)
    problem = Problem(floor=east())
    found = violations(problem, start, BEHIND, free)
    assert len(found) == 1
    assert found[0].startswith('floor violated by 1.')
    slow = Command(0.4, np.zeros(1), np.eye(2))
    assert 'below the floor' in flaw(problem, slow)
    plan = Solver(problem).solve(start, BEHIND)
    binding = explained(problem, start, BEHIND, plan).binding
    assert {each.name for each in binding} == {'floor'}


def test_safe_commands_start_up_lines_and_files_know_a_new_floor():
    problem = Problem(floor=east())
    assert safe_command('auto', problem, exp(np.array([2.0])), 0.0).speed_fraction == 1.0
    assert safe_command('hold_rate_zero', problem, np.eye(2), 0.1).speed_fraction == 0.5
    case = case_of({**CASES['uav_hull_1'], 'floor': {'shape': 'eastward', 'fraction': 0.5}})
    assert case.problem.floor == east()
    assert east().outline(2) == ()
    assert east(0.7).least(np.array([0.6, 0.8])) == pytest.approx(0.7 / 0.6)


def flown(problem, start, headings):
    """Return positions and velocities of s_{k+1} = s_k + h p_k, p_{k+1} = 0.8 p_k + h z R_k e1."""
    places, velocities = [start.position], [start.velocity]
    for heading in headings[:-1]:
        places.append(places[-1] + problem.step * velocities[-1])
        pushed = problem.step * problem.forward * heading
        velocities.append(KEPT * velocities[-1] + pushed)
    return np.array(places), np.array(velocities)


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize('rotation_order', [1, 2])
@pytest.mark.parametrize('speed', [0.05, 1.0, 300.0])
def test_a_new_model_is_planned_with_checked_and_proved(dimension, rotation_order, speed):
    model = (dimension, rotation_order, DRAG)
    problem = Problem(*model, horizon=8, step=0.2, forward=speed, terminal='constraint')
    moving = 0.2 * speed * np.eye(dimension)[-1]
    turned = np.eye(dimension)
    start = State.at(np.ones(dimension), 0.5 * turned, velocity=moving, coasted=turned)
    reached = np.ones(dimension) + 0.06 * speed
    goals = np.tile(reached, (8, 1))
    plan = Solver(problem, coasting=True).solve(start, goals)
    assert plan.is_closed
    assert plan.proof.checked or not COMPILED  # certificates cannot state this model
    places, velocities = flown(problem, start, plan.rotations[:, :, 0])
    np.testing.assert_allclose(plan.positions, places, rtol=0.0, atol=1e-9 * speed)
    np.testing.assert_allclose(plan.velocities, velocities, rtol=0.0, atol=1e-9 * speed)
    np.testing.assert_allclose(places[-1], reached, rtol=0.0, atol=1e-7 * speed)
    np.testing.assert_allclose(velocities[-1], 0.0, atol=1e-6 * speed)
