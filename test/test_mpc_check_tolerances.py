# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Every tolerance of the check: what it allows passes, the next number beyond does not.

The vehicle rests at the origin, where sums and differences with zero are exact, and no weight
makes a cost of it, so that nothing but the tolerance in question can object.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from plans import assembled, changed

from orbimpc_ros.mpc.check import command_violations, violations
from orbimpc_ros.mpc.plan import UNPROVED, Command
from orbimpc_ros.mpc.problem import Box, Floor, Problem, State, Weights

# As documented, not as imported: a check that allows more must not have its tests follow it.
TOLERANCE, ORTHOGONAL, SUMMING, ROUNDING = 1e-6, 1e-9, 1e-9, 1e-15
FREE = Problem(weights=Weights(0.0, 0.0, 0.0, 0.0))
COASTING = replace(FREE, rotation_order=2)
GOALS = np.zeros((5, 2))
FAR = 1e9  # [m] from the origin, where numbers are 1e-7 apart


def resting(problem, x=(0.0, 0.0), place=(0.0, 0.0)):
    """The state at rest, and a plan whose rotations all have the coordinates x."""
    coasted = np.eye(2) if problem.rotation_order == 2 else None
    state = State.at(place, np.zeros((2, 2)), attitude=np.eye(2), coasted=coasted)
    return state, assembled(problem, state, GOALS, np.tile(x, (problem.horizon, 1)))


def with_one(name, index):
    """A plan with one number of an array moved."""

    def made(error):
        state, plan = resting(FREE)
        array = getattr(plan, name)
        return FREE, state, GOALS, replace(plan, **{name: changed(array, index, error)})

    return made


def with_rotations(problem, coordinates):
    def made(error):
        return problem, *_with_goals(*resting(problem, coordinates(error)))

    return made


def _with_goals(state, plan):
    return state, GOALS, plan


def above_a_floor(error):
    problem = replace(FREE, floor=Floor('circle', 4, 2 * TOLERANCE))
    return problem, *_with_goals(*resting(problem, (2 * TOLERANCE - error, 0.0)))


def inside_a_box(error):
    problem = replace(FREE, obstacles=(Box([-1.0, -error], [1.0, 1.0]),))
    return problem, *_with_goals(*resting(problem))


def across_a_corner(error):
    problem = replace(FREE, obstacles=(Box([-1.0, -error], [1.0, 1.0]),), no_corner_cutting=True)
    return problem, *_with_goals(*resting(problem))


def beside_the_arrival(error):
    problem = replace(FREE, terminal='constraint')
    return problem, *resting(problem)[:1], changed(GOALS, (4, 1), error), resting(problem)[1]


def bounded_above_its_cost(error):
    state, plan = resting(FREE)
    return (
        FREE,
        state,
        GOALS,
        replace(plan, proof=replace(UNPROVED, lower_bound=error, cost_unit=4.0)),
    )


def skewed(error):
    state, plan = resting(FREE)
    shear = np.array([[1.0, error], [0.0, 1.0]])
    return FREE, state, GOALS, replace(plan, projected=changed(plan.projected, 5, shear))


def turned_from(problem, k):
    """A plan whose projected rotations Q_k and after are turned a little."""

    def made(error):
        state, plan = resting(problem)
        projected = plan.projected.copy()
        projected[k:] = [[1.0, -error], [error, 1.0]]
        return problem, state, GOALS, replace(plan, projected=projected)

    return made


@pytest.mark.parametrize(
    ('made', 'allowed', 'complaint'),
    [
        (with_one('positions', (2, 1)), TOLERANCE, 'positions differ by 1e-06 from a rollout'),
        (with_one('velocities', (2, 1)), TOLERANCE, 'velocities differ by 1e-06 from a rollout'),
        (with_one('rotations', (3, 1, 1)), TOLERANCE, 'rotations differ by 1e-06 from a rollout'),
        (with_rotations(COASTING, lambda e: (0.0, e)), TOLERANCE, 'R_1 strays 1e-06 from where'),
        (with_rotations(COASTING, lambda e: (-e, 0.0)), TOLERANCE, 'R_1 thrusts backwards by 1e-0'),
        (above_a_floor, TOLERANCE, 'floor violated by 1e-06'),
        (inside_a_box, TOLERANCE, 'obstacle violated by 1e-06'),
        (across_a_corner, TOLERANCE, 'obstacle violated by 1e-06'),
        (beside_the_arrival, TOLERANCE * (1 + ROUNDING), 'terminal constraint missed by 1e-06'),
        (bounded_above_its_cost, 4 * TOLERANCE, 'the lower bound exceeds the cost of 0 by 4e-06'),
        (skewed, ORTHOGONAL, 'a projected rotation is not orthogonal'),
        (turned_from(FREE, 0), ORTHOGONAL, 'the first rotation is not the measured attitude'),
        (turned_from(COASTING, 1), ORTHOGONAL, 'the second rotation is not where the body rate'),
        (turned_from(FREE, 3), TOLERANCE, 'a projected rotation strays 1e-06 from its projection'),
    ],
)
def test_a_plan_may_be_off_by_exactly_its_tolerance(made, allowed, complaint):
    assert violations(*made(allowed)) == []
    found = violations(*made(np.nextafter(allowed, 1.0)))
    assert len(found) == 1
    assert found[0].startswith(complaint)


def test_at_its_goal_a_plan_may_cost_nothing():
    state, plan = resting(Problem())
    nothing = replace(plan, proof=replace(UNPROVED, lower_bound=0.0))
    assert nothing.objective == 0.0
    assert violations(Problem(), state, GOALS, nothing) == []
    more = replace(nothing, objective=5e-324)
    assert violations(Problem(), state, GOALS, more) == ['the objective is 0, not 4.94066e-324']


@pytest.mark.parametrize('side', [-1.0, 1.0])
def test_an_objective_may_be_off_by_what_summing_costs(side):
    problem = Problem()
    state, plan = resting(problem, (0.5, 0.0))
    for share, fine in ((0.9, True), (1.1, False)):
        told = replace(plan, objective=plan.objective * (1.0 + side * share * SUMMING))
        assert (violations(problem, state, GOALS, told) == []) is fine


@pytest.mark.parametrize('which', ['hull', 'max_rate'])
def test_limits_that_rounding_blurs(which):
    """One and chords are no multiples of the tolerance: it is met from either side."""
    problem = replace(FREE, max_rate=0.3 if which == 'max_rate' else 0.0)
    limit = problem.chord if which == 'max_rate' else 1.0
    for share, fine in ((0.9, True), (1.1, False)):
        state, plan = resting(problem, (limit + share * TOLERANCE, 0.0))
        assert violations(problem, state, GOALS, plan) == (
            [] if fine else [f'{which} violated by 1.1e-06']
        )


@pytest.mark.parametrize('order', [1, 2])
@pytest.mark.parametrize(('step', 'forward'), [(0.1, 300.0), (2.0, 0.1)])
def test_lengths_may_be_off_in_proportion_to_what_a_step_moves(order, step, forward):
    problem = replace(FREE, translation_order=order, step=step, forward=forward)
    length = forward * step**order
    state, plan = resting(problem)
    for share, fine in ((0.9, True), (1.1, False)):
        error = share * TOLERANCE * length
        off = replace(plan, positions=changed(plan.positions, (5, 0), error))
        assert (violations(problem, state, GOALS, off) == []) is fine
        off = replace(plan, velocities=changed(plan.velocities, (5, 0), error / step))
        assert (violations(problem, state, GOALS, off) == []) is fine
        boxed = replace(problem, obstacles=(Box([-error, -9e9], [9e9, 9e9]),))
        assert (violations(boxed, state, GOALS, plan) == []) is fine


@pytest.mark.parametrize('axis', [0, 1])
@pytest.mark.parametrize('side', [-1.0, 1.0])
def test_far_from_the_origin_rounding_is_allowed_for(axis, side):
    """1e9 m away it is as much as the tolerance of a step of a metre: together 2e-6 m."""
    problem = replace(FREE, terminal='constraint')
    place = side * FAR * np.eye(2)[axis]
    state, plan = resting(problem, place=place)
    there = np.tile(place, (5, 1))
    assert violations(problem, state, there, plan) == []
    for error, fine in ((1.7e-6, True), (2.4e-6, False)):
        off = replace(plan, positions=changed(plan.positions, (3, axis), side * FAR + error))
        assert (violations(problem, state, there, off) == []) is fine
        aside = changed(there, (4, axis), side * FAR + error)
        assert (violations(problem, state, aside, plan) == []) is fine


# --- the command


def still(problem=FREE):
    return resting(problem)[1], Command(0.0, np.zeros(1), np.eye(2))


def turned(sine):
    return np.array([[1.0, -sine], [sine, 1.0]])


def test_a_commanded_speed_may_be_off_by_exactly_the_tolerance():
    plan, command = still()
    fast, faster = TOLERANCE, np.nextafter(TOLERANCE, 1.0)
    assert command_violations(FREE, plan, replace(command, speed_fraction=fast)) == []
    found = command_violations(FREE, plan, replace(command, speed_fraction=faster))
    assert found == ['the commanded speed is not that of the plan']


def test_a_commanded_rotation_may_be_off_its_rate_by_exactly_the_tolerance():
    plan, command = still()
    near, off = turned(ORTHOGONAL), turned(np.nextafter(ORTHOGONAL, 1.0))
    assert command_violations(FREE, plan, replace(command, rotation=near)) == []
    found = command_violations(FREE, plan, replace(command, rotation=off))
    assert found == ['the commanded rotation is not where the commanded rate leads']


def test_a_commanded_rotation_may_be_off_its_plan_by_exactly_the_tolerance():
    plan, command = still()
    sines = 2.0 * math.sin(0.5 * TOLERANCE) + np.spacing(TOLERANCE) * np.arange(-20, 21)
    off = {}
    for sine in sines:
        told = replace(command, rotation=turned(sine), body_rate=np.array([sine]))
        # The angle as the norm of what a rotation changes has it.
        seen = 2.0 * math.asin(np.linalg.norm(turned(sine) - np.eye(2)) / math.sqrt(8.0))
        off[seen] = command_violations(FREE, plan, told)
    assert TOLERANCE in off
    complaint = 'the commanded rotation is 1e-06 rad from that of the plan'
    for seen, found in off.items():
        assert found == ([] if seen <= TOLERANCE else [complaint])
