"""A floor and a model of one file each, unknown to the package: all of it respects them."""

from dataclasses import replace

import numpy as np
import pytest
import toy_floor
from plans import assembled
from scipy.optimize import minimize

from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.command import Command, flaw
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.loop.safety import safe_command
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.mpc.problem.case import case_of
from orbimpc_ros.mpc.sensitivity.constraints import explained
from orbimpc_ros.mpc.solve.solver import Solver

EAST = Floor('eastward', fraction=0.5)
BEHIND = np.tile([-3.0, 1.0], (5, 1))


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize('limits', [{}, {'max_rate': 0.5}, {'rotation_order': 2}])
def test_plans_keep_to_a_new_floor_and_are_proved(dimension, limits):
    problem = Problem(dimension, floor=EAST, **limits)
    turned = np.eye(dimension)
    start = State.at(np.zeros(dimension), 0.6 * turned, coasted=turned)
    plan = Solver(problem, coasting=True).solve(
        start, np.tile(BEHIND[0, [0, 1, 1][:dimension]], (5, 1))
    )
    assert plan.status == 'optimal'
    first = 1 if problem.rotation_order == 1 else 2
    assert plan.rotations[first:, 0, 0].min() >= 0.5 - 1e-6
    assert plan.rotations[first:, 0, 0].min() <= 0.5 + 1e-4  # it wants the other way


def test_the_optimum_under_a_new_floor_is_that_of_an_independent_solver():
    problem = Problem(floor=EAST)
    start = State.at(np.zeros(2), 0.6 * np.eye(2))
    plan = Solver(problem, gap_tolerance=1e-8).solve(start, BEHIND)

    def cost(x):
        headings = np.concatenate([[[0.6, 0.0]], x.reshape(5, 2)])
        places = np.cumsum(headings[:-1], axis=0)
        missed = ((places - BEHIND) ** 2).sum(axis=1)
        turned = 2.0 * (np.diff(headings, axis=0) ** 2).sum()
        return missed.sum() + 10.0 * missed[-1] + 0.05 * turned

    limits = [
        {'type': 'ineq', 'fun': lambda x: 1.0 - (x.reshape(5, 2) ** 2).sum(axis=1)},
        {'type': 'ineq', 'fun': lambda x: x.reshape(5, 2)[:, 0] - 0.5},
    ]
    best = minimize(cost, np.tile([0.6, 0.1], 5), constraints=limits, method='SLSQP', tol=1e-12)
    assert plan.objective == pytest.approx(best.fun, rel=1e-6)


def test_the_check_the_last_look_and_the_prices_see_a_new_floor():
    start = State.at(np.zeros(2), 0.6 * np.eye(2))
    free = Solver(Problem()).solve(start, BEHIND)
    problem = Problem(floor=EAST)
    found = violations(problem, start, BEHIND, free)
    assert len(found) == 1
    assert found[0].startswith('floor violated by 1.')
    slow = Command(0.4, np.zeros(1), np.eye(2))
    assert 'below the floor' in flaw(problem, slow)
    plan = Solver(problem).solve(start, BEHIND)
    binding = explained(problem, start, BEHIND, plan).binding
    assert {each.name for each in binding} == {'floor'}


def test_safe_commands_start_up_lines_and_files_know_a_new_floor():
    problem = Problem(floor=EAST)
    assert safe_command('auto', problem, exp(np.array([2.0])), 0.0).speed_fraction == 1.0
    assert safe_command('hold_rate_zero', problem, np.eye(2), 0.1).speed_fraction == 0.5
    case = case_of(
        {
            'dimension': 2,
            'rotation_order': 1,
            'translation_order': 1,
            'horizon': 5,
            'step': 1.0,
            'forward': 1.0,
            'weights': {'position': 1.0},
            'floor': {'shape': 'eastward', 'fraction': 0.5},
            'state': {'position': [0, 0], 'rotation': [[1, 0], [0, 1]]},
            'goal': [1, 1],
        }
    )
    assert case.problem.floor == EAST
    assert EAST.outline(2) == ()
    assert replace(EAST, fraction=0.7).least(np.array([0.6, 0.8])) == pytest.approx(0.7 / 0.6)


def test_plans_made_by_hand_are_judged_by_the_new_floor_alone():
    problem = Problem(floor=EAST)
    start = State.at(np.zeros(2), np.eye(2))
    x = np.tile(coordinates(0.7 * exp(np.array([0.6]))), (5, 1))
    assert violations(problem, start, BEHIND, assembled(problem, start, BEHIND, x)) == []
    slower = 0.8 * x  # 0.46 eastwards
    found = violations(problem, start, BEHIND, assembled(problem, start, BEHIND, slower))
    assert found == ['floor violated by 0.038']


assert toy_floor  # imported to be registered
