# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The check before publishing: limits, each at every step, and the terminal constraint."""

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
    straight,
)
from problems import floor

from orbimpc_ros.mpc.check import TOLERANCE, margins, turn_margin, violations
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Box, Problem, State


def stretched(problem, start, goals, scale):
    """A plan with R_1..R_N scaled."""
    plan = solved(problem, start, goals)
    return assembled(problem, start, goals, scale * coordinates(plan.rotations[1:]))


def test_outside_the_orbitope():
    far = np.tile([30.0, 0.0], (5, 1))
    broken = stretched(Problem(), START, far, 1.0 + 1e-5)
    assert 'hull' in only_complaint(Problem(), broken, START, far)


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


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('k', range(5))
def test_the_orbitope_binds_at_every_step(n, k):
    start, goals, plan = straight(Problem(n), changed(np.ones(5), k, 1.0 + 2 * TOLERANCE))
    assert 'hull' in only_complaint(Problem(n), plan, start, goals)


@pytest.mark.parametrize(('n', 'shape'), [(2, 'polygon'), (2, 'circle'), (3, 'polygon')])
@pytest.mark.parametrize('k', range(5))
def test_the_floor_binds_at_every_step(n, shape, k):
    problem = Problem(n, floor=floor(shape, 0.5, 6))
    start, goals, plan = straight(problem, changed(np.full(5, 0.5), k, 0.5 - 2 * TOLERANCE))
    assert 'floor' in only_complaint(problem, plan, start, goals)


@pytest.mark.parametrize('k', range(5))
def test_the_rate_limit_binds_at_every_step(k):
    """Without a floor it is the chord that counts, so a jump of the speed by itself is too much."""
    problem = Problem(max_rate=0.3)
    jump = problem.chord + 2 * TOLERANCE
    start, goals, plan = straight(problem, np.where(np.arange(5) < k, 1.0, 1.0 - jump))
    assert 'max_rate' in only_complaint(problem, plan, start, goals)


@pytest.mark.parametrize('k', range(1, 6))
def test_the_turn_of_every_step_counts(k):
    problem = Problem(max_rate=0.3, floor=floor('circle', 0.5))
    for extra, fine in ((-1e-5, True), (1e-5, False)):
        angles = np.where(np.arange(1, 6) < k, 0.0, 0.3 + extra)
        x = np.column_stack([np.cos(angles), np.sin(angles)])
        plan = assembled(problem, START, GOALS, x)
        assert (violations(problem, START, GOALS, plan) == []) is fine


@pytest.mark.parametrize('speed', [0.0, 0.2, 1.0])
@pytest.mark.parametrize('fraction', [0.5, 1.0])
def test_with_a_floor_the_first_turn_is_an_angle_whatever_the_speeds(speed, fraction):
    problem = Problem(max_rate=0.3, floor=floor('circle', 0.5))
    start = State.at([0.0, 0.0], speed * np.eye(2), attitude=np.eye(2))
    for angle, fine in ((0.3 - 1e-5, True), (0.3 + 1e-5, False)):
        x = np.tile([fraction * np.cos(angle), fraction * np.sin(angle)], (5, 1))
        found = violations(problem, start, GOALS, assembled(problem, start, GOALS, x))
        assert (found == []) is fine


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


@pytest.mark.parametrize('k', range(1, 5))
def test_every_corner_counts(k):
    start, goals, plan = straight(Problem(), np.ones(5))
    corner = Box([k + 0.4, -0.1], [k + 0.6, 0.1])
    strict = Problem(obstacles=(corner,), no_corner_cutting=True)
    assert 'obstacle' in only_complaint(strict, plan, start, goals)


@pytest.mark.parametrize('order', [1, 2])
def test_missing_the_arrival(order):
    problem = Problem(translation_order=order, terminal='constraint')
    reachable = np.tile([2.0, 0.5], (5, 1))
    plan = solved(problem, START, reachable)
    aside = reachable + 1e-5
    assert 'terminal' in only_complaint_but_the_cost(problem, plan, START, aside)


def test_arriving_in_motion():
    moving = Problem(translation_order=2)
    plan = solved(moving)
    there = np.tile(plan.positions[-1], (5, 1))
    stopped = replace(moving, terminal='constraint')
    assert 'terminal' in only_complaint_but_the_cost(stopped, plan, START, there)


@pytest.mark.parametrize('order', [1, 2])
@pytest.mark.parametrize(('step', 'forward'), [(1.0, 1.0), (0.1, 300.0), (2.0, 0.1)])
def test_an_arrival_is_as_exact_as_steps_are_long(order, step, forward):
    problem = Problem(
        translation_order=order, terminal='constraint', step=step, forward=forward, horizon=6
    )
    reachable = np.tile(problem.length_unit * np.array([2.0, 0.5]), (6, 1))
    plan = solved(problem, START, reachable)
    for share, fine in ((0.3, True), (3.0, False)):
        aside = reachable + changed(
            np.zeros((6, 2)), (5, 1), share * TOLERANCE * problem.length_unit
        )
        found = violations(problem, START, aside, plan)
        assert any('terminal' in each for each in found) is not fine


# --- only what a limit speaks of counts


@pytest.mark.parametrize('shape', ['circle', 'polygon'])
def test_a_floor_is_under_the_thrust_axis_alone(shape):
    """The other columns of R are the roll's, and may vanish."""
    problem = Problem(3, floor=floor(shape, 0.5, 6))
    start = State.at(np.zeros(3), np.diag([1.0, 0.0, 0.0]), attitude=np.eye(3))
    x = np.tile(coordinates(np.diag([1.0, 0.0, 0.0])), (5, 1))
    plan = assembled(problem, start, np.zeros((5, 3)), x)
    assert violations(problem, start, np.zeros((5, 3)), plan) == []


@pytest.mark.parametrize('rate', [0.0, 0.3])
def test_every_step_has_its_margin(rate):
    start, _, plan = straight(Problem(), np.ones(5))
    margins = turn_margin(Problem(max_rate=rate), start, plan.rotations)
    np.testing.assert_array_equal(margins, np.full(5, Problem(max_rate=rate).chord))


def test_one_radian_a_second_is_a_limit():
    problem = Problem(max_rate=1.0)
    start, goals, plan = straight(problem, [-0.1, -0.1, -0.1, -0.1, -0.1])
    assert only_complaint(problem, plan, start, goals) == 'max_rate violated by 0.14'


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


def test_a_first_turn_ends_at_the_first_step():
    """What comes later neither makes it shorter nor longer."""
    problem = Problem(max_rate=0.3, floor=floor('circle', 0.5))
    for angles, sizes, fine in (
        ([0.29, 0.5, 0.7, 0.7, 0.7], [1.0, 1.0, 1.0, 1.0, 1.0], True),
        ([0.29, 0.29, 0.29, 0.29, 0.29], [1.0, 0.75, 0.75, 0.75, 0.75], True),
        ([0.31, 0.29, 0.29, 0.29, 0.29], [1.0, 1.0, 1.0, 1.0, 1.0], False),
    ):
        x = np.array(sizes)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        plan = assembled(problem, START, GOALS, x)
        assert (violations(problem, START, GOALS, plan) == []) is fine


def test_later_turns_of_a_body_that_coasts_count():
    problem = Problem(rotation_order=2, max_rate=0.3, floor=floor('circle', 0.5))
    start = State.at([0.0, 0.0], np.eye(2), coasted=exp(np.array([1.0])))
    for k in range(2, 6):
        angles = np.where(np.arange(1, 6) < k, 1.0, 1.31)
        plan = assembled(problem, start, GOALS, np.column_stack([np.cos(angles), np.sin(angles)]))
        assert only_complaint(problem, plan, start).startswith('max_rate violated by 0.0')


@pytest.mark.parametrize('k', range(1, 6))
@pytest.mark.parametrize('turn', [0.3, 1.5, 2.5])
def test_with_a_floor_every_turn_is_an_angle_whatever_the_speeds(k, turn):
    """Slow headings are near each other, and their angle may be wide all the same."""
    problem = Problem(max_rate=turn, floor=floor('circle', 0.2))
    sizes = np.where(np.arange(1, 6) % 2, 0.2, 1.0)
    for extra, fine in ((-1e-5, True), (1e-5, False)):
        angles = np.where(np.arange(1, 6) < k, 0.0, turn + extra)
        x = np.column_stack([np.cos(angles), np.sin(angles)]) * sizes[:, None]
        found = violations(problem, START, GOALS, assembled(problem, START, GOALS, x))
        assert (found == []) is fine


def test_no_speed_has_no_heading_to_turn_to():
    """R_1 e1 = 0 is then as far from any attitude as a half-circle is from its middle."""
    problem = Problem(max_rate=0.9, floor=floor('circle', 0.5))
    plan = assembled(problem, START, GOALS, np.zeros((5, 2)))
    found = violations(problem, START, GOALS, plan)
    assert found == ['floor violated by 0.5', f'max_rate violated by {0.5 * np.pi - 0.9:.2g}']


def test_the_corner_before_the_first_step_is_not_the_plans():
    """R_0 or p_0 has decided s_1: how a vehicle gets there no plan can change."""
    corner = Box([0.4, -0.1], [0.6, 0.1])
    problem = Problem(obstacles=(corner,), no_corner_cutting=True)
    start, goals, plan = straight(problem, np.ones(5))
    assert violations(problem, start, goals, plan) == []


@pytest.mark.parametrize('steps', [1, 2])
def test_short_plans_have_corners_where_they_have_two_points(steps):
    corner = Box([1.4, -0.1], [1.6, 0.1])
    problem = Problem(horizon=steps, obstacles=(corner,), no_corner_cutting=True)
    start, goals, plan = straight(problem, np.ones(steps))
    found = violations(problem, start, goals, plan)
    assert found == ([] if steps == 1 else ['obstacle violated by 0.1'])


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
