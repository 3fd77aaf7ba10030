"""The check before publishing: each of its conditions, on a good plan broken in one way."""

from dataclasses import replace

import numpy as np
import pytest
from problems import floor, state

from orbimpc_ros.mpc.orbitopes import coordinates
from orbimpc_ros.mpc.plan import CHECK_TOLERANCE, assemble, shifted, violations
from orbimpc_ros.mpc.problem import Box, Problem, State
from orbimpc_ros.mpc.rotations import exp
from orbimpc_ros.mpc.solver import Solver

GOALS = np.tile([3.0, 1.0], (5, 1))
START = State.at([0.0, 0.0], np.eye(2))


def solved(problem, start=START, goals=GOALS, coasting=False):
    plan = Solver(problem, coasting=coasting).solve(start, goals)
    assert violations(problem, start, goals, plan) == []
    return plan


def changed(array, index, value):
    copy = array.copy()
    copy[index] = value
    return copy


def only_complaint(problem, plan, start=START, goals=GOALS):
    found = violations(problem, start, goals, plan)
    assert len(found) == 1, found
    return found[0]


@pytest.mark.parametrize('name', ['positions', 'velocities', 'rotations', 'inputs', 'projected'])
@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_not_finite(name, value):
    problem = Problem()
    plan = solved(problem)
    broken = replace(plan, **{name: changed(getattr(plan, name), -1, value)})
    assert only_complaint(problem, broken) == 'plan is not finite'
    assert only_complaint(problem, replace(plan, objective=value)) == 'plan is not finite'


@pytest.mark.parametrize('name', ['positions', 'velocities'])
def test_positions_and_velocities_are_those_of_a_rollout(name):
    problem = Problem()
    plan = solved(problem)
    array = getattr(plan, name)
    off = replace(plan, **{name: changed(array, 2, array[2] + 2 * CHECK_TOLERANCE)})
    assert name in only_complaint(problem, off)
    close = replace(plan, **{name: changed(array, 2, array[2] + 0.4 * CHECK_TOLERANCE)})
    assert violations(problem, START, GOALS, close) == []


def test_rotations_are_those_of_a_rollout():
    problem = Problem()
    plan = solved(problem)
    off = replace(plan, inputs=changed(plan.inputs, -1, plan.inputs[-1] + 1e-4))
    assert any('rotations differ' in f for f in violations(problem, START, GOALS, off))


def test_a_plan_from_another_state_is_not_this_states_plan():
    problem = Problem()
    plan = solved(problem)
    elsewhere = State.at([0.0, 1e-5], np.eye(2))
    assert 'positions differ' in only_complaint(problem, plan, elsewhere)


def assembled(problem, start, goals, x):
    """A consistent plan through any rotations: only the limits can object to it."""
    how = {'status': 'optimal', 'lower_bound': -np.inf, 'nodes': 1, 'projection': 'nearest'}
    return assemble(problem, start, goals, x, **how)


def stretched(problem, start, goals, scale):
    """A plan with R_1..R_N scaled."""
    plan = solved(problem, start, goals)
    return assembled(problem, start, goals, scale * coordinates(plan.rotations[1:]))


def test_outside_the_orbitope():
    far = np.tile([30.0, 0.0], (5, 1))
    broken = stretched(Problem(), START, far, 1.0 + 1e-5)
    assert 'conv SO(n)' in only_complaint(Problem(), broken, START, far)


@pytest.mark.parametrize('shape', ['polygon', 'circle'])
def test_below_the_floor(shape):
    problem = Problem(floor=floor(shape, 0.5))
    here = np.zeros((5, 2))
    broken = stretched(problem, START, here, 1.0 - 1e-5)
    assert 'floor' in only_complaint(problem, broken, START, here)


def test_turning_too_fast():
    problem = Problem(max_rate=0.3)
    behind = np.tile([-5.0, 0.1], (5, 1))
    plan = solved(Problem(), START, behind)
    assert 'max_rate' in only_complaint(problem, plan, START, behind)


def test_inside_an_obstacle():
    plan = solved(Problem())
    box = Box(plan.positions[3] - 0.1, plan.positions[3] + 0.1)
    assert 'obstacle' in only_complaint(Problem(obstacles=(box,)), plan)


def test_cutting_a_corner():
    plan = solved(Problem())
    a, b = plan.positions[1], plan.positions[2]
    middle, half = (a + b) / 2, np.abs(b - a) / 2 * 0.999
    box = Box(middle - half, middle + half)
    assert violations(Problem(obstacles=(box,)), START, GOALS, plan) == []
    strict = Problem(obstacles=(box,), no_corner_cutting=True)
    assert 'obstacle' in only_complaint(strict, plan)


@pytest.mark.parametrize('order', [1, 2])
def test_missing_the_arrival(order):
    problem = Problem(translation_order=order, terminal='constraint')
    reachable = np.tile([2.0, 0.5], (5, 1))
    plan = solved(problem, START, reachable)
    aside = reachable + 1e-5
    assert 'terminal' in only_complaint(problem, plan, START, aside)


def test_arriving_in_motion():
    moving = Problem(translation_order=2)
    plan = solved(moving)
    there = np.tile(plan.positions[-1], (5, 1))
    stopped = replace(moving, terminal='constraint')
    assert 'terminal' in only_complaint(stopped, plan, START, there)


def test_projected_rotations_are_rotations():
    problem = Problem()
    plan = solved(problem)
    skewed = replace(plan, projected=changed(plan.projected, 1, plan.projected[1] * (1 + 1e-8)))
    assert any('orthogonal' in f for f in violations(problem, START, GOALS, skewed))
    mirror = replace(plan, projected=changed(plan.projected, 1, np.diag([1.0, -1.0])))
    assert 'determinant' in only_complaint(problem, mirror)


def test_second_order_rotation_leaves_where_the_body_rate_carries_it():
    problem = Problem(dimension=3, rotation_order=2, translation_order=2)
    start = state(np.random.default_rng(4), problem)
    assert start.coasted is not None
    goals = np.tile(start.position + 9.0 * start.coasted[:, 0], (5, 1))
    plan = solved(problem, start, goals, coasting=True)
    turned = start.coasted @ exp(np.array([0.0, 0.0, 0.01]))
    other = replace(start, coasted=turned)
    assert plan.speed_fraction[1] > 0.1
    assert any('R_1' in f for f in violations(problem, other, goals, plan))


def test_second_order_rotation_thrusts_forwards():
    problem = Problem(rotation_order=2, translation_order=2)
    start = State.at([0.0, 0.0], np.eye(2), coasted=np.eye(2))
    plan = solved(problem, start, GOALS, coasting=True)
    x = coordinates(plan.rotations[1:]).copy()
    x[0] = [-0.1, 0.0]  # in the hull, but no thrust
    backwards = assembled(problem, start, GOALS, x)
    assert 'backwards by 0.1' in only_complaint(problem, backwards, start)


def test_shifted_plan_holds_from_where_the_plan_leads():
    problem = Problem(floor=floor('circle', 0.5))
    plan = solved(problem)
    following = State.at(plan.positions[1], plan.rotations[1])
    moved = shifted(problem, following, GOALS, plan, projection='nearest')
    assert moved is not None
    assert violations(problem, following, GOALS, moved) == []
    assert np.allclose(moved.rotations[:-1], plan.rotations[1:])


def test_arrays_of_a_plan_are_read_only():
    plan = solved(Problem())
    with pytest.raises(ValueError, match='read-only'):
        plan.positions[0] = 1.0
