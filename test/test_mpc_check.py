# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The check before publishing: finite numbers, and a rollout from the measured state."""

from dataclasses import replace

import numpy as np
import pytest
from plans import (
    GOALS,
    START,
    assembled,
    changed,
    only_complaint,
    only_complaint_but_the_cost,
    solved,
)
from problems import floor, state

from orbimpc_ros.mpc.check import TOLERANCE, violations
from orbimpc_ros.mpc.geometry.orbitopes import coordinates, matrix
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.plan import shifted
from orbimpc_ros.mpc.problem import Problem, State


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
    off = replace(plan, **{name: changed(array, 2, array[2] + 2 * TOLERANCE)})
    assert name in only_complaint_but_the_cost(problem, off)
    close = replace(plan, **{name: changed(array, 2, array[2] + 0.4 * TOLERANCE)})
    assert not any('differ' in each for each in violations(problem, START, GOALS, close))


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


def test_the_rest_of_a_plan_turns_no_faster_than_the_vehicle_between_its_steps():
    """On the chord of a turn as wide as may be, headings turn faster in its middle."""
    problem = Problem(floor=floor('circle', 0.5), max_rate=0.3, discretisation='exact')
    start, behind = State.at([0.0, 0.0], np.eye(2)), np.tile([-3.0, 2.0], (5, 1))
    plan = solved(problem, start, behind)
    knots = 0.2 + np.arange(1, 6)
    for off in (-0.05, 0.0, 0.05):
        here = State.at([0.2, 0.0], exp(np.array([0.06 + off])))
        moved = shifted(problem, here, behind, plan, knots, projection='nearest')
        assert violations(problem, here, behind, moved) == []
        turned = np.arctan2(moved.rotations[1:4, 1, 0], moved.rotations[1:4, 0, 0])
        np.testing.assert_allclose(turned, 0.3 * knots[:3], atol=0.06)


def test_arrays_of_a_plan_are_read_only():
    plan = solved(Problem())
    with pytest.raises(ValueError, match='read-only'):
        plan.positions[0] = 1.0


@pytest.mark.parametrize('what', ['rotation', 'rotation_rate', 'velocity'])
def test_a_plan_starts_from_the_measured_state_in_all_its_parts(what):
    """Else a plan could bring its own R_0, W_0 or p_0, and be consistent with itself."""
    problem = Problem(rotation_order=2, translation_order=2)
    start = State.at(
        [0.0, 0.0], 0.5 * np.eye(2), velocity=[0.1, 0.2], rotation_rate=np.zeros((2, 2))
    )
    plan = assembled(problem, start, GOALS, np.tile([0.5, 0.0], (5, 1)))
    assert violations(problem, start, GOALS, plan) == []
    moved = {
        'rotation': 0.5001 * np.eye(2),
        'rotation_rate': 1e-4 * matrix(np.array([1.0, 0.5])),
        'velocity': np.array([0.1001, 0.2]),
    }
    other = replace(start, **{what: moved[what]})
    assert any('differ' in each for each in violations(problem, other, GOALS, plan))


def test_a_rate_is_that_of_the_measured_rotation():
    """A plan whose own R_0 is off by less than the tolerance departs from there step by step."""
    problem = Problem(rotation_order=2)
    start = State.at([0.0, 0.0], 0.5 * np.eye(2), coasted=np.eye(2))
    near = replace(start, rotation=(0.5 + 0.9e-6) * np.eye(2))
    plan = assembled(problem, near, GOALS, np.tile([0.5, 0.0], (5, 1)))
    assert violations(problem, near, GOALS, plan) == []
    found = violations(problem, start, GOALS, plan)
    assert 'rotations differ by 3.6e-06 from a rollout of the inputs' in found
