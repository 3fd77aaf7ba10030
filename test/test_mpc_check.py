# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The check before publishing: rollouts from the measured state, limits at every step, the cost."""

import math
from dataclasses import replace

import numpy as np
import pytest
from plans import (
    GOALS,
    START,
    assembled,
    changed,
    only_complaint,
    solved,
    straight,
)
from problems import ORDERS, case, floor, needs_machine_code, rotation, state
from problems import goals as goals_of

from orbimpc_ros.mpc import check
from orbimpc_ros.mpc.check import TOLERANCE, margins, violations
from orbimpc_ros.mpc.geometry.orbitopes import coordinates, matrix
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.plan import UNPROVED
from orbimpc_ros.mpc.problem import Box, Problem, State, Weights
from orbimpc_ros.mpc.solve.solver import Solver

# --- a rollout from the measured state


@pytest.mark.parametrize('name', ['positions', 'velocities', 'rotations', 'inputs', 'projected'])
@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_not_finite(name, value):
    problem = Problem()
    plan = solved(problem)
    broken = replace(plan, **{name: changed(getattr(plan, name), -1, value)})
    assert only_complaint(problem, broken) == 'plan is not finite'
    assert only_complaint(problem, replace(plan, objective=value)) == 'plan is not finite'


@pytest.mark.parametrize('what', ['position', 'rotation', 'rotation_rate', 'velocity'])
def test_a_plan_starts_from_the_measured_state_in_all_its_parts(what):
    """Else a plan could bring its own R_0, W_0 or p_0, and be consistent with itself."""
    problem = Problem(rotation_order=2, translation_order=2)
    start = State.at(
        [0.0, 0.0], 0.5 * np.eye(2), velocity=[0.1, 0.2], rotation_rate=np.zeros((2, 2))
    )
    plan = assembled(problem, start, GOALS, np.tile([0.5, 0.0], (5, 1)))
    assert violations(problem, start, GOALS, plan) == []
    moved = {
        'position': np.array([0.0, 1e-5]),
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


# --- limits


@pytest.mark.parametrize('k', range(5))
@pytest.mark.parametrize(
    ('name', 'given', 'speeds', 'off'),
    [
        ('hull', {}, 1.0, 2 * TOLERANCE),
        ('hull', {'dimension': 3}, 1.0, 2 * TOLERANCE),
        ('floor', {'floor': floor('polygon', 0.5, 6)}, 0.5, -2 * TOLERANCE),
        ('floor', {'floor': floor('circle', 0.5)}, 0.5, -2 * TOLERANCE),
        ('floor', {'dimension': 3, 'floor': floor('polygon', 0.5, 6)}, 0.5, -2 * TOLERANCE),
    ],
)
def test_hull_and_floor_bind_at_every_step(name, given, speeds, off, k):
    problem = Problem(**given)
    start, goals, plan = straight(problem, changed(np.full(5, speeds), k, speeds + off))
    assert name in only_complaint(problem, plan, start, goals)


@pytest.mark.parametrize('k', range(5))
@pytest.mark.parametrize('side', [-1.0, 1.0])
@pytest.mark.parametrize('name', ['max_rate', 'max_acceleration'])
def test_changes_from_step_to_step_bind_at_every_step(name, side, k):
    """Without a floor the chord counts as a turn, so a jump of the speed by itself is too much."""
    problem = Problem(**{name: 0.3})
    most = problem.chord if name == 'max_rate' else 0.3
    for jump, fine in ((most + 2 * TOLERANCE, False), (most - 2 * TOLERANCE, True)):
        speeds = np.where(np.arange(5) < k, 0.5, 0.5 + side * jump)
        start = State.at(np.zeros(2), 0.5 * np.eye(2))
        x = np.outer(speeds, coordinates(np.eye(2)))
        found = violations(problem, start, GOALS, assembled(problem, start, GOALS, x))
        assert (found == []) is fine
        assert fine or found[0].startswith(f'{name} violated by 2e-06')


def test_a_change_of_speed_that_the_state_has_decided_does_not_count():
    problem = Problem(rotation_order=2, max_acceleration=0.1)
    start = State.at([0.0, 0.0], 0.2 * np.eye(2), rotation_rate=0.5 * np.eye(2))
    for then, fine in ((0.7, True), (0.81, False)):
        x = np.outer([0.7, then, then, then, then], [1.0, 0.0])
        found = violations(problem, start, GOALS, assembled(problem, start, GOALS, x))
        assert (found == []) is fine


@pytest.mark.parametrize('k', range(1, 5))
def test_every_corner_counts_where_none_may_be_cut(k):
    start, goals, plan = straight(Problem(), np.ones(5))
    corner = Box([k + 0.4, -0.1], [k + 0.6, 0.1])
    assert violations(Problem(obstacles=(corner,)), start, goals, plan) == []
    strict = Problem(obstacles=(corner,), no_corner_cutting=True)
    assert 'obstacle' in only_complaint(strict, plan, start, goals)


def test_a_body_that_coasts_has_its_first_turn_behind_it():
    problem = Problem(rotation_order=2, max_rate=0.3, floor=floor('circle', 0.5))
    start = State.at([0.0, 0.0], np.zeros((2, 2)), attitude=np.eye(2), coasted=exp(np.array([1.0])))
    plan = assembled(problem, start, GOALS, np.tile(coordinates(start.coasted), (5, 1)))
    assert violations(problem, start, GOALS, plan) == []
    free = replace(problem, floor=floor('none'))
    assert 'max_rate' in only_complaint(free, plan, start)


@pytest.mark.parametrize('k', range(1, 6))
@pytest.mark.parametrize('which', [0, 1])
def test_every_box_is_kept_out_of_at_every_step(k, which):
    start, goals, plan = straight(Problem(), np.ones(5))
    far, there = Box([50.0, 50.0], [51.0, 51.0]), Box([k - 0.1, -0.5], [k + 0.1, 0.5])
    boxes = (far, there) if which else (there, far)
    assert 'obstacle' in only_complaint(Problem(obstacles=boxes), plan, start, goals)
    above = Box([k - 0.1, 2 * TOLERANCE - 0.5], [k + 0.1, -0.4 * TOLERANCE])
    assert violations(Problem(obstacles=(above,)), start, goals, plan) == []


def test_arriving_in_motion():
    moving = Problem(translation_order=2)
    plan = solved(moving)
    there = np.tile(plan.positions[-1], (5, 1))
    stopped = replace(moving, terminal='constraint')
    found = violations(stopped, START, there, plan)
    assert {each.split()[0] for each in found} == {'terminal', 'the'}  # and the objective


@pytest.mark.parametrize('shape', ['circle', 'polygon'])
def test_a_floor_is_under_the_thrust_axis_alone(shape):
    """The other columns of R are the roll's, and may vanish."""
    problem = Problem(3, floor=floor(shape, 0.5, 6))
    start = State.at(np.zeros(3), np.diag([1.0, 0.0, 0.0]), attitude=np.eye(3))
    x = np.tile(coordinates(np.diag([1.0, 0.0, 0.0])), (5, 1))
    plan = assembled(problem, start, np.zeros((5, 3)), x)
    assert violations(problem, start, np.zeros((5, 3)), plan) == []


@pytest.mark.parametrize('floored', [False, True])
def test_a_first_turn_counts_from_the_attitude_that_was_measured(floored):
    """A plan made for another attitude is none for this one, whatever it says of itself."""
    problem = Problem(max_rate=0.3, floor=floor('circle' if floored else 'none', 0.5))
    other = State.at([0.0, 0.0], exp(np.array([0.5])))
    x = np.tile([np.cos(0.6), np.sin(0.6)], (5, 1))
    plan = assembled(problem, other, GOALS, x)
    assert violations(problem, other, GOALS, plan) == []
    turned = replace(other, attitude=np.eye(2))
    assert violations(problem, turned, GOALS, plan) == [
        'the first rotation is not the measured attitude',
        *(['max_rate violated by 0.3'] if floored else []),
    ]


def test_later_turns_of_a_body_that_coasts_count():
    problem = Problem(rotation_order=2, max_rate=0.3, floor=floor('circle', 0.5))
    start = State.at([0.0, 0.0], np.eye(2), coasted=exp(np.array([1.0])))
    for k in range(2, 6):
        angles = np.where(np.arange(1, 6) < k, 1.0, 1.31)
        plan = assembled(problem, start, GOALS, np.column_stack([np.cos(angles), np.sin(angles)]))
        assert only_complaint(problem, plan, start).startswith('max_rate violated by 0.0')


@pytest.mark.parametrize('k', range(1, 6))
@pytest.mark.parametrize(('turn', 'speed'), [(0.3, 0.0), (1.5, 0.2), (2.5, 1.0)])
def test_with_a_floor_every_turn_is_an_angle_whatever_the_speeds(k, turn, speed):
    """Slow headings are near each other, and their angle may be wide all the same."""
    problem = Problem(max_rate=turn, floor=floor('circle', 0.2))
    sizes = np.where(np.arange(1, 6) % 2, 0.2, 1.0)
    start = State.at([0.0, 0.0], speed * np.eye(2), attitude=np.eye(2))
    for extra, fine in ((-1e-5, True), (1e-5, False)):
        angles = np.where(np.arange(1, 6) < k, 0.0, turn + extra)
        x = np.column_stack([np.cos(angles), np.sin(angles)]) * sizes[:, None]
        found = violations(problem, start, GOALS, assembled(problem, start, GOALS, x))
        assert (found == []) is fine


def test_the_corner_before_the_first_step_is_not_the_plans():
    """R_0 or p_0 has decided s_1: how a vehicle gets there no plan can change."""
    corner = Box([0.4, -0.1], [0.6, 0.1])
    for steps in (1, 5):
        problem = Problem(horizon=steps, obstacles=(corner,), no_corner_cutting=True)
        start, goals, plan = straight(problem, np.ones(steps))
        assert violations(problem, start, goals, plan) == []


def test_margins_are_told_of_every_limit_that_there_is():
    box = Box([1.2, 2.0], [9.0, 9.0])
    problem = Problem(floor=floor('circle', 0.5), max_acceleration=0.3, obstacles=(box,))
    start, goals, plan = straight(problem, np.array([0.9, 0.8, 0.7, 0.7, 0.7]))
    found = margins(problem, start, goals, plan)
    below = float((box.minimum - plan.positions[1:]).max(axis=1).min())
    expected = {'hull': 0.1, 'floor': 0.2, 'max_acceleration': 0.2, 'obstacle': below}
    assert found == pytest.approx(expected, abs=1e-9)
    assert set(margins(replace(problem, max_rate=0.3), start, goals, plan)) - set(found) == {
        'max_rate'
    }


# --- objective and bound


@pytest.mark.parametrize('excess', [1e-4, 1.0, 9.0, np.inf, np.nan])
def test_a_bound_above_the_cost_is_refused(excess):
    problem = Problem()
    plan = solved(problem)
    bound = plan.objective + excess * (plan.objective + plan.proof.cost_unit)
    claimed = replace(plan, proof=replace(plan.proof, lower_bound=bound))
    assert 'lower bound exceeds' in only_complaint(problem, claimed)


def test_a_plan_is_optimal_only_by_a_bound_that_is_near_enough():
    plan = solved(Problem())
    for bound, status in (
        (plan.objective * (1.0 - 0.9e-4), 'optimal'),
        (plan.objective * (1.0 - 1.1e-4), 'feasible'),
        (0.0, 'feasible'),
        (-np.inf, 'feasible'),
        (np.nan, 'feasible'),
    ):
        assert replace(plan, proof=replace(plan.proof, lower_bound=bound)).status == status
    assert replace(plan, objective=np.inf).status == 'feasible'
    assert replace(plan, proof=UNPROVED).status == 'feasible'


@pytest.mark.parametrize(('units', 'status'), [(1e8, 'feasible'), (1e10, 'optimal')])
def test_a_gap_far_below_the_unit_of_costs_is_none(units, status):
    plan = solved(Problem())
    unit = units * plan.objective
    proof = replace(plan.proof, lower_bound=0.0, cost_unit=unit)
    assert replace(plan, proof=proof).status == status


def judged(problem, start, goals, plan):
    """The objective as the problem states it, number by number."""
    w, h, z = problem.weights, problem.step, problem.forward
    cost, last = 0.0, problem.horizon
    for k in range(1, last + 1):
        miss = sum((a - b) ** 2 for a, b in zip(plan.positions[k], goals[k - 1], strict=True))
        cost += w.position * miss
        if k == last:
            cost += (w.terminal + problem.arrival_weight) * miss
    for k in range(last):
        cost += w.input * sum(u**2 for row in plan.inputs[k] for u in row)
        cost += w.length * h * z * math.hypot(*plan.rotations[k, :, 0])
    if problem.translation_order == 2:
        cost += problem.arrival_weight * h * h * sum(v**2 for v in plan.velocities[last])
    off = plan.rotations[last] - start.wanted
    cost += w.attitude * sum(each**2 for row in off for each in row)
    return cost


@pytest.mark.parametrize('orders', ORDERS)
@pytest.mark.parametrize('arrival', [0.0, 0.5, 3.0])
def test_every_term_of_the_objective_is_summed(orders, arrival):
    rng = np.random.default_rng(int(10 * arrival) + orders['dimension'])
    for length in (0.0, 0.7):
        problem = Problem(
            **orders,
            horizon=4,
            step=0.7,
            forward=3.0,
            weights=Weights(0.9, 0.4, length, 2.0, attitude=1.3),
            arrival_weight=arrival,
        )
        start, places = state(rng, problem), goals_of(rng, problem)
        n = problem.dimension
        start = replace(start, wanted=rotation(rng, n))
        squeezed = np.diag([1.0, 0.5, 0.5][:n])  # so that the first column is not as long as others
        points = [rng.uniform(0.1, 0.9) * rotation(rng, n) @ squeezed for _ in range(4)]
        if start.coasted is not None:
            points[0] = 0.8 * start.coasted
        plan = assembled(problem, start, places, coordinates(np.array(points)))
        told = replace(plan, objective=judged(problem, start, places, plan))
        assert violations(problem, start, places, told) == []
        for factor in (1.0 - 1e-8, 1.0 + 1e-8):
            off = replace(plan, objective=factor * told.objective)
            assert only_complaint(problem, off, start, places).startswith('the objective is ')


def test_an_overflow_excuses_nothing():
    plan = solved(Problem())
    endless = Problem(weights=Weights(position=1e308))
    with np.errstate(over='ignore'):
        assert only_complaint(endless, plan).startswith('the objective is inf, not ')
    unit = replace(
        plan, proof=replace(plan.proof, lower_bound=2.0 * plan.objective, cost_unit=np.inf)
    )
    assert only_complaint(Problem(), unit).startswith('the lower bound exceeds the cost')


@needs_machine_code
@pytest.mark.parametrize('family', ['hull', 'hull, inertia', 'space, attitude', 'space, coasting'])
def test_a_check_in_a_tick_takes_no_other_machine_code_than_was_loaded_before(family):
    problem, state, goals = case(family)
    solver = Solver(problem)
    loaded = list(check._strayed.signatures)
    solver.solve(state, goals)
    assert check._strayed.signatures == loaded != []
