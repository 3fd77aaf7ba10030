# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The check before publishing: projected rotations, and the command made of them."""

from dataclasses import replace

import numpy as np
import pytest
from plans import GOALS, START, assembled, changed, only_complaint, solved, straight
from problems import rotation, state

from orbimpc_ros.mpc.check import command_violations, violations
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.plan import UNPROVED, assemble, command_of
from orbimpc_ros.mpc.problem import Problem, State

STRAYS = 'a projected rotation strays {} from its projection'


def test_projected_rotations_are_rotations():
    problem = Problem()
    plan = solved(problem)
    skewed = replace(plan, projected=changed(plan.projected, 1, plan.projected[1] * (1 + 1e-8)))
    assert any('orthogonal' in f for f in violations(problem, START, GOALS, skewed))
    mirror = replace(plan, projected=changed(plan.projected, 1, np.diag([1.0, -1.0])))
    assert only_complaint(problem, mirror) == 'a projected rotation has not determinant +1'
    swapped = np.array([[0.0, 1.0], [1.0, 0.0]])
    swap = replace(plan, projected=changed(plan.projected, 1, swapped))
    assert only_complaint(problem, swap) == 'a projected rotation has not determinant +1'


def spatial_plan(projection, order=1):
    """A plan over SO(3) with rotations well inside the orbitope."""
    rng = np.random.default_rng(8)
    problem = Problem(3, rotation_order=order)
    start = state(rng, problem)
    points = [0.5 * exp(rng.normal(size=3)) + 0.3 * exp(rng.normal(size=3)) for _ in range(5)]
    if order == 2:
        points[0] = 0.7 * start.coasted
    x = coordinates(np.array(points))
    goals = np.zeros((5, 3))
    plan = assemble(problem, start, goals, x, projection=projection, proof=UNPROVED)
    return problem, start, goals, plan


@pytest.mark.parametrize(
    ('projection', 'order'), [('nearest', 1), ('thrust_aligned', 1), ('nearest', 2)]
)
@pytest.mark.parametrize('k', range(6))
@pytest.mark.parametrize('axis', range(3))
def test_every_projected_rotation_is_the_projection_of_its_own(projection, order, k, axis):
    """But for the first one, and the second of a body that coasts, which are given."""
    problem, start, goals, plan = spatial_plan(projection, order)
    assert violations(problem, start, goals, plan) == []
    given = ['measured attitude', 'carries the first'][:order]
    for angle in (1e-4, 2.0, np.pi):
        turned = plan.projected[k] @ exp(angle * np.eye(3)[axis])
        off = replace(plan, projected=changed(plan.projected, k, turned))
        assert [*given, *6 * ['strays']][k] in only_complaint(problem, off, start, goals)


@pytest.mark.parametrize('k', range(6))
def test_every_planar_rotation_heads_where_its_own_does(k):
    plan = replace(solved(Problem()), projection=['nearest', 'thrust_aligned'][k % 2])
    for angle in (1e-4, 2.0, np.pi):
        turned = plan.projected[k] @ exp(np.array([angle]))
        off = replace(plan, projected=changed(plan.projected, k, turned))
        assert ('strays' if k else 'measured attitude') in only_complaint(Problem(), off)


@pytest.mark.parametrize('max_rate', [0.0, 0.2, 3.0])
@pytest.mark.parametrize('order', [1, 2])
def test_a_command_is_that_of_its_plan(order, max_rate):
    problem, start, _, plan = spatial_plan('thrust_aligned', order)
    problem = replace(problem, max_rate=max_rate)
    command = command_of(problem, start, plan)
    assert command_violations(problem, plan, command) == []
    aside, zero = exp(np.array([0.0, 0.0, 1e-4])), np.zeros(3)
    for broken, told in (
        (replace(command, speed_fraction=command.speed_fraction - 1e-5), 'speed'),
        (replace(command, rotation=command.rotation @ aside), 'leads'),
        (replace(command, body_rate=1.001 * command.body_rate), 'leads'),
        (replace(command, body_rate=zero, rotation=plan.projected[order - 1]), 'rad from'),
    ):
        assert any(told in each for each in command_violations(problem, plan, broken))
    rate = command.body_rate * (1.001 if max_rate != 0.2 else 0.999)
    other = replace(
        command, body_rate=rate, rotation=plan.projected[order - 1] @ exp(problem.step * rate)
    )
    assert any('rad from' in each for each in command_violations(problem, plan, other))


# --- each condition of a projection by itself


def sheet(projection, rotations, projected):
    """A plan over SO(3) through given R_1..R_5 that claims given Q_1..Q_5."""
    problem, start, goals = Problem(3), State.at(np.zeros(3), np.eye(3)), np.zeros((5, 3))
    plan = assemble(
        problem, start, goals, coordinates(rotations), projection=projection, proof=UNPROVED
    )
    told = replace(plan, projected=np.concatenate([np.eye(3)[None], projected]))
    return violations(problem, start, goals, told)


def frames(seed):
    rng = np.random.default_rng(seed)
    return np.array([rotation(rng, 3) for _ in range(5)])


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize('k', range(5))
def test_the_nearest_rotation_is_no_other_stationary_one(seed, k):
    """A half turn about a principal axis keeps Q'R symmetric, and is farther away."""
    frame = frames(seed)
    rotations = frame @ np.diag([0.5, 0.3, 0.1])
    assert sheet('nearest', rotations, frame) == []
    for turn, stray in (([1, -1, -1], 0.4), ([-1, 1, -1], 0.6), ([-1, -1, 1], 0.8)):
        turned = changed(frame, k, frame[k] @ np.diag(turn))
        assert sheet('nearest', rotations, turned) == [STRAYS.format(stray)]


@pytest.mark.parametrize('k', range(5))
def test_a_thrust_aligned_rotation_has_the_heading_even_without_a_roll(k):
    """R = R e1 e1' leaves the roll free: there only the heading can be wrong."""
    frame = frames(k)
    rotations = 0.8 * frame @ np.diag([1.0, 0.0, 0.0])
    rolled = frame @ exp(np.array([1.0, 0.0, 0.0]))
    assert sheet('thrust_aligned', rotations, rolled) == []
    aside = changed(rolled, k, rolled[k] @ exp(np.array([0.0, 1e-3, 0.0])))
    found = sheet('thrust_aligned', rotations, aside)
    assert len(found) == 1
    assert found[0].startswith('a projected rotation strays 0.000')


@pytest.mark.parametrize('k', range(5))
def test_a_thrust_aligned_rotation_has_the_better_roll(k):
    """Half a turn about the thrust keeps Q'R symmetric across it, and is the worst roll."""
    frame = frames(k)
    rotations = frame @ np.diag([0.5, 0.3, 0.1])
    assert sheet('thrust_aligned', rotations, frame) == []
    worst = changed(frame, k, frame[k] @ np.diag([1.0, -1.0, -1.0]))
    assert sheet('thrust_aligned', rotations, worst) == [STRAYS.format('0.4')]


@pytest.mark.parametrize('projection', ['nearest', 'thrust_aligned'])
def test_a_spatial_heading_that_is_undefined_is_held(projection):
    frame = frames(9)
    rotations = 0.5 * frame
    rotations[3] = 0.0
    held = changed(frame, 3, frame[2])
    assert sheet(projection, rotations, held) == []
    for wrong in (frame[3], frame[4], frame[2] @ exp(np.array([1e-3, 0.0, 0.0]))):
        found = sheet(projection, rotations, changed(frame, 3, wrong))
        assert len(found) == 1
        assert found[0].startswith('a projected rotation strays')


def test_a_heading_is_defined_from_the_least_speed_that_has_one():
    x = np.tile([0.0, 1e-9], (5, 1))
    plan = assembled(Problem(), START, GOALS, x)
    assert not plan.held.any()
    assert violations(Problem(), START, GOALS, plan) == []
    still = assembled(Problem(), START, GOALS, np.nextafter(x, 0.0))
    assert still.held[1:].all()
    assert violations(Problem(), START, GOALS, still) == []
    led = replace(still, projected=np.array([np.eye(2), *plan.projected[1:]]))
    assert only_complaint(Problem(), led) == STRAYS.format('1')


def test_a_body_coasts_to_where_it_was_measured_to():
    """A plan for another body rate is consistent with itself, not with the measurement."""
    problem = Problem(rotation_order=2)
    start = State.at([0.0, 0.0], np.eye(2), coasted=exp(np.array([0.2])))
    plan = assembled(problem, start, GOALS, np.tile(coordinates(start.coasted), (5, 1)))
    assert violations(problem, start, GOALS, plan) == []
    other = replace(start, coasted=exp(np.array([0.3])))
    assert violations(problem, other, GOALS, plan) == [
        'R_1 strays 0.095 from where the body rate carries it',
        'the second rotation is not where the body rate carries the first',
    ]


@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_a_command_is_finite(value):
    problem = Problem()
    plan = solved(problem)
    command = command_of(problem, START, plan)
    for broken in (
        replace(command, speed_fraction=value),
        replace(command, body_rate=np.array([value])),
        replace(command, rotation=changed(command.rotation, (0, 1), value)),
    ):
        assert command_violations(problem, plan, broken) == ['command is not finite']


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('order', [1, 2])
def test_the_last_step_of_a_plan_has_a_command(n, order):
    """At rotation order 2 it holds the attitude: no later one is planned."""
    problem = Problem(n, order, horizon=1, step=0.5)
    start, goals, plan = straight(problem, [1.0])
    command = command_of(problem, start, plan)
    assert command_violations(problem, plan, command) == []
    assert not command.body_rate.any()
    assert violations(problem, start, goals, plan) == []
