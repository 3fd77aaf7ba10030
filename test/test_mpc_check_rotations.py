# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The check before publishing: projected rotations, and the command made of them."""

from dataclasses import replace

import numpy as np
import pytest
from plans import GOALS, START, assembled, changed, only_complaint, solved, straight
from problems import rotation

from orbimpc_ros.mpc.check import command_violations, violations
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.plan import UNPROVED, Command, assemble, command_of
from orbimpc_ros.mpc.problem import Problem, State


def frames(seed):
    rng = np.random.default_rng(seed)
    return np.array([rotation(rng, 3) for _ in range(5)])


def plan_of(frames, singular_values, projection, order=1):
    """A plan in space whose rotations are Q_k diag(s_k): Q_1..Q_N are their projections."""
    problem = Problem(3, rotation_order=order)
    start = State.at(np.zeros(3), np.eye(3), coasted=frames[0])
    rotations = frames * np.broadcast_to(singular_values, (5, 3))[:, None]
    if order == 2:
        rotations[0] = 0.7 * frames[0]
    given = problem, start, np.zeros((5, 3)), coordinates(rotations)
    return *given[:3], assemble(*given, projection=projection, proof=UNPROVED)


@pytest.mark.parametrize('broken', [np.diag([1.0, -1.0]), np.array([[0.0, 1.0], [1.0, 0.0]])])
def test_a_projected_mirror_is_no_rotation(broken):
    plan = solved(Problem())
    mirror = replace(plan, projected=changed(plan.projected, 1, broken))
    assert only_complaint(Problem(), mirror) == 'a projected rotation has not determinant +1'


@pytest.mark.parametrize(
    ('projection', 'order'), [('nearest', 1), ('thrust_aligned', 1), ('nearest', 2)]
)
@pytest.mark.parametrize('k', range(6))
@pytest.mark.parametrize('axis', range(3))
def test_every_projected_rotation_is_the_projection_of_its_own(projection, order, k, axis):
    """But for the first one, and the second of a body that coasts, which are given.

    A half turn about a principal axis keeps Q'R symmetric, and is farther away.
    """
    problem, start, goals, plan = plan_of(frames(k), [0.5, 0.3, 0.1], projection, order)
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
    known = frames(8), [0.8, 0.5, 0.4], 'thrust_aligned', order
    problem, start, _, plan = plan_of(*known)
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


@pytest.mark.parametrize('projection', ['nearest', 'thrust_aligned'])
def test_a_spatial_heading_that_is_undefined_is_held(projection):
    frame, values = frames(9), np.full((5, 3), 0.5)
    values[3] = 0.0
    problem, start, goals, plan = plan_of(frame, values, projection)
    np.testing.assert_allclose(plan.projected[4], frame[2])
    assert violations(problem, start, goals, plan) == []
    for wrong in (frame[3], frame[4], frame[2] @ exp(np.array([1e-3, 0.0, 0.0]))):
        off = replace(plan, projected=changed(plan.projected, 4, wrong))
        assert 'strays' in only_complaint(problem, off, start, goals)


def test_a_heading_is_defined_from_the_least_speed_that_has_one():
    x = np.tile([0.0, 1e-9], (5, 1))
    plan = assembled(Problem(), START, GOALS, x)
    assert not plan.held.any()
    assert violations(Problem(), START, GOALS, plan) == []
    still = assembled(Problem(), START, GOALS, np.nextafter(x, 0.0))
    assert still.held[1:].all()
    assert violations(Problem(), START, GOALS, still) == []
    led = replace(still, projected=np.array([np.eye(2), *plan.projected[1:]]))
    assert only_complaint(Problem(), led) == 'a projected rotation strays 1 from its projection'


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


@pytest.mark.parametrize(
    ('made', 'allowed', 'complaint'),
    [
        (lambda e: {'speed_fraction': e}, 1e-6, 'speed is not that of the plan'),
        (
            lambda e: {'rotation': exp(np.array([e]))},
            1e-9,
            'rotation is not where the commanded rate leads',
        ),
        (
            lambda e: {'rotation': exp(np.array([e])), 'body_rate': np.array([e])},
            1e-6,
            'rotation is 1e-06 rad from that of the plan',
        ),
    ],
)
def test_a_command_may_be_off_by_its_tolerance_and_not_by_more(made, allowed, complaint):
    plan = assembled(Problem(), START, GOALS, np.zeros((5, 2)))
    still = Command(0.0, np.zeros(1), np.eye(2))
    for share, told in ((1.0 - 1e-6, []), (1.0 + 1e-6, [f'the commanded {complaint}'])):
        assert command_violations(Problem(), plan, replace(still, **made(share * allowed))) == told
