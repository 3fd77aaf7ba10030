# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Projected rotations, commands of plans, and the final check of a command."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from plans import GOALS, START, assembled, changed, only_complaint, solved, straight
from problems import floor, rotation

from orbimpc_ros.mpc.check import command_violations, flaw, violations
from orbimpc_ros.mpc.geometry.rotations import coordinates, exp
from orbimpc_ros.mpc.plan import UNPROVED, Command, assemble, command_of
from orbimpc_ros.mpc.problem import Floor, Problem, State


def frames(seed, n=3):
    rng = np.random.default_rng(seed)
    return np.array([rotation(rng, n) for _ in range(5)])


def plan_of(frames, singular_values, projection, order=1):
    """Return arguments of the check with R_k = Q_k diag(s_k), whose projections are Q_1..Q_N."""
    n = frames.shape[-1]
    problem = Problem(n, rotation_order=order)
    start = State.at(np.zeros(n), np.eye(n), coasted=frames[0])
    rotations = frames * np.broadcast_to(singular_values, (5, n))[:, None]
    if order == 2:
        rotations[0] = 0.7 * frames[0]
    given = problem, start, np.zeros((5, n)), coordinates(rotations)
    return *given[:3], assemble(*given, projection=projection, proof=UNPROVED)


@pytest.mark.parametrize('broken', [np.diag([1.0, -1.0]), np.array([[0.0, 1.0], [1.0, 0.0]])])
def test_a_projected_mirror_is_no_rotation(broken):
    plan = solved(Problem())
    mirror = replace(plan, projected=changed(plan.projected, 1, broken))
    assert only_complaint(Problem(), mirror) == 'a projected rotation does not have determinant +1'


@pytest.mark.parametrize('projection', ['nearest', 'thrust_aligned'])
@pytest.mark.parametrize('order', [1, 2])
@pytest.mark.parametrize('k', range(6))
@pytest.mark.parametrize('n', [2, 3])
def test_every_projected_rotation_is_the_projection_of_its_own(projection, order, k, n):
    """Except the first one, and the second of a coasting body, which are given.

    A half turn about a principal axis also keeps Q'R symmetric, but is farther away.
    """
    values = [0.5, 0.3, 0.1] if n == 3 else [0.5, 0.5]
    problem, start, goals, plan = plan_of(frames(k, n), values, projection, order)
    assert violations(problem, start, goals, plan) == []
    told = [*['measured attitude', 'the first turned'][:order], *6 * ['strays']][k]
    for axis, angle in itertools.product(np.eye(n * (n - 1) // 2), (1e-4, 2.0, np.pi)):
        turned = plan.projected[k] @ exp(angle * axis)
        off = replace(plan, projected=changed(plan.projected, k, turned))
        assert told in only_complaint(problem, off, start, goals)


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
    np.testing.assert_array_equal(plan.projected[1:, :, 0], np.tile([0.0, 1.0], (5, 1)))
    assert violations(Problem(), START, GOALS, plan) == []
    still = assembled(Problem(), START, GOALS, np.nextafter(x, 0.0))
    np.testing.assert_array_equal(still.projected, np.tile(np.eye(2), (6, 1, 1)))
    assert violations(Problem(), START, GOALS, still) == []
    led = replace(still, projected=np.array([np.eye(2), *plan.projected[1:]]))
    assert only_complaint(Problem(), led) == 'a projected rotation strays 1 from its projection'


@pytest.mark.parametrize(
    ('made', 'allowed', 'complaint'),
    [
        (lambda e: {'speed_fraction': e}, 1e-6, 'speed is not that of the plan'),
        (
            lambda e: {'rotation': exp(np.array([e]))},
            1e-9,
            'rotation does not match the commanded rate',
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


# --- the final check


def good(n):
    rng = np.random.default_rng(n)
    return Command(0.7, 0.2 * np.ones(1 if n == 2 else 3), rotation(rng, n))


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('value', [np.nan, np.inf, -np.inf])
def test_not_finite(n, value):
    _, _, plan = straight(Problem(n), np.ones(5))
    for broken in (
        replace(good(n), speed_fraction=value),
        replace(good(n), body_rate=changed(good(n).body_rate, -1, value)),
        replace(good(n), rotation=changed(good(n).rotation, (1, 0), value)),
    ):
        assert flaw(Problem(n), broken) == 'the command is not finite'
        assert command_violations(Problem(n), plan, broken) == ['command is not finite']


@pytest.mark.parametrize(
    ('given', 'name', 'most', 'told'),
    [
        ({}, 'speed_fraction', 1.0, 'is not in [0, 1]'),
        ({'max_rate': 0.3}, 'body_rate', 0.3 * (1.0 + 1e-6), 'is beyond 0.3'),
        ({'step': 0.5}, 'body_rate', 2.0 * np.pi * (1.0 + 1e-6), 'is beyond 6.28319'),
        ({'step': 2.0}, 'body_rate', 0.5 * np.pi * (1.0 + 1e-6), 'is beyond 1.5708'),
    ],
)
def test_a_command_may_be_at_its_limits_and_not_beyond(given, name, most, told):
    """Without max_rate the limit is half a turn per step; in space the vector counts."""
    problem, rate = Problem(**given), name == 'body_rate'
    for value, fine in ((most, True), (np.nextafter(most, 9.0), False)):
        command = replace(good(2), **{name: np.array([-value]) if rate else value})
        assert (flaw(problem, command) == '') is fine
        assert fine or told in flaw(problem, command)
    assert rate or told in flaw(problem, replace(good(2), speed_fraction=-1e-9))
    size = float(np.linalg.norm(good(3).body_rate))
    assert flaw(Problem(3, max_rate=size), good(3)) == ''
    assert 'beyond' in flaw(Problem(3, max_rate=0.99 * size), good(3))


@pytest.mark.parametrize(('n', 'shape'), [(2, 'circle'), (2, 'polygon'), (3, 'circle')])
def test_no_command_is_below_the_floor_but_a_stop_that_was_asked_for(n, shape):
    problem = Problem(n, floor=floor(shape, 0.7))
    assert flaw(problem, good(n)) == ''
    for fraction in (np.nextafter(0.7, 0.0), 0.3, 0.0):
        slow = replace(good(n), speed_fraction=fraction)
        told = f'a speed fraction of {fraction:.6g} is below the floor of 0.7'
        assert flaw(problem, slow) == told
        assert flaw(problem, slow, stopping=True) == ''
        assert flaw(replace(problem, floor=Floor(fraction=0.7)), slow) == ''


def broken_rotations(n):
    turned = good(n).rotation
    yield changed(np.eye(n), (1, 0), np.nextafter(1e-9, 1.0))
    yield turned * (1.0 + 1e-8)
    yield turned * np.array([-1.0] + [1.0] * (n - 1))  # a reflection
    for i in range(n):
        for j in range(n):
            yield changed(turned, (i, j), turned[i, j] + 1e-6)
    if n == 3:  # the last row is orthogonal to the others
        yield np.diag([2.0, 0.5, 1.0])
        yield np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 0.8]])


@pytest.mark.parametrize('n', [2, 3])
def test_no_rotation(n):
    within = changed(np.eye(n), (1, 0), 1e-9)
    assert flaw(Problem(n), replace(good(n), rotation=within)) == ''
    for broken in broken_rotations(n):
        found = flaw(Problem(n), replace(good(n), rotation=broken))
        assert found == 'the commanded rotation is not a rotation'


# --- commands made of plans


@pytest.mark.parametrize('shape', ['none', 'circle', 'polygon'])
def test_what_rounding_leaves_of_speeds_is_made_up_for(shape):
    problem = Problem(floor=floor(shape, 0.5))
    for fraction, told in ((0.5 - 1e-9, 0.5), (0.7, 0.7), (1.0 + 1e-9, 1.0)):
        start, _, plan = straight(problem, np.full(5, fraction))
        expected = fraction if shape == 'none' and fraction < 1.0 else told
        assert command_of(problem, start, plan).speed_fraction == expected


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('step', [0.4, 1.0, 2.5])
def test_a_rate_is_cut_on_the_shortest_way_to_the_plan(n, step):
    """The commanded rotation is where the cut rate leads; only the excess over the limit is cut."""
    rng = np.random.default_rng(n)
    for _ in range(20):
        turn = rng.normal(size=1 if n == 2 else 3)
        turn *= rng.uniform(0.1, 3.0) / np.linalg.norm(turn)
        problem = Problem(n, step=step)
        start = State.at(np.zeros(n), np.eye(n))
        points = np.tile(coordinates(exp(turn)), (5, 1))
        plan = assembled(problem, start, np.zeros((5, n)), points)
        whole = command_of(problem, start, plan)
        np.testing.assert_allclose(whole.body_rate, turn / step, atol=1e-9)
        np.testing.assert_array_equal(whole.rotation, plan.projected[1])
        for share in (0.25, 0.9):
            limited = replace(problem, max_rate=float(share * np.linalg.norm(turn) / step))
            command = command_of(limited, start, plan)
            np.testing.assert_allclose(command.body_rate, share * turn / step, atol=1e-9)
            np.testing.assert_allclose(command.rotation, exp(share * turn), atol=1e-9)
            along = max(0.0, exp(turn)[:, 0] @ command.rotation[:, 0])
            assert command.speed_fraction == pytest.approx(along, abs=1e-12)
            assert command_violations(limited, plan, command) == []
            told = ['the commanded speed is not that of the plan']
            quick = replace(command, speed_fraction=along + 1e-4)
            assert command_violations(limited, plan, quick) == told
            uncut = replace(whole, speed_fraction=1.0)
            assert 'rad from that of the plan' in command_violations(limited, plan, uncut)[-1]
        at_the_limit = replace(problem, max_rate=math.sqrt(whole.body_rate @ whole.body_rate))
        same = command_of(at_the_limit, start, plan)
        np.testing.assert_array_equal(same.rotation, plan.projected[1])


@pytest.mark.parametrize(('order', 'shape'), [(1, 'circle'), (1, 'polygon'), (2, 'none')])
def test_a_cut_turn_keeps_the_speed_with_a_floor_or_where_turns_come_later(order, shape):
    problem = Problem(3, rotation_order=order, max_rate=0.2, floor=floor(shape, 0.5, 6))
    start = State.at(np.zeros(3), np.eye(3))
    turns = [exp(k * np.array([0.0, 0.0, 0.9])) for k in range(1, 6)]
    plan = assembled(problem, start, np.zeros((5, 3)), 0.8 * coordinates(np.array(turns)))
    command = command_of(problem, start, plan)
    assert np.linalg.norm(command.body_rate) == pytest.approx(0.2)
    assert command.speed_fraction == pytest.approx(0.8)
    assert command_violations(problem, plan, command) == []


@pytest.mark.parametrize('order', [1, 2])
@pytest.mark.parametrize('steps', [1, 5])
def test_a_command_leads_to_the_rotation_after_the_first_that_it_can_change(order, steps):
    """At rotation order 2 that of one step holds the attitude: no later rotation is planned."""
    problem = Problem(rotation_order=order, horizon=steps, step=0.5)
    start = State.at([0.0, 0.0], np.eye(2))
    angles = np.array([0.1, 0.3, 0.6, 1.0, 1.5])[:steps]
    x = 0.9 * np.column_stack([np.cos(angles), np.sin(angles)])
    plan = assembled(problem, start, np.zeros((steps, 2)), x)
    command, headings = command_of(problem, start, plan), [0.0, *angles, angles[-1]]
    assert command_violations(problem, plan, command) == []
    first, then = headings[order - 1 : order + 1]
    assert command.speed_fraction == pytest.approx(0.9)
    assert command.body_rate == pytest.approx([(then - first) / 0.5])
    np.testing.assert_allclose(command.rotation, exp(np.array([then])), atol=1e-12)


def test_a_turn_that_is_cut_by_next_to_nothing_keeps_to_full_speed():
    """Two headings that are equal up to rounding may have a cosine above 1."""
    problem = Problem(horizon=1, step=0.5, max_rate=0.7)
    rng = np.random.default_rng(8)
    for _ in range(200):
        start = State.at(np.zeros(2), exp(rng.uniform(-3.0, 3.0, 1)))
        turn = problem.widest_turn * (1.0 + 10.0 ** -rng.uniform(9.0, 13.0, 1))
        points = coordinates((start.attitude @ exp(turn))[None])
        command = command_of(problem, start, assembled(problem, start, np.zeros((1, 2)), points))
        assert flaw(problem, command) == ''
