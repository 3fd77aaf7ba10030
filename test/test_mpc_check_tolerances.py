# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Every tolerance of the check: what it allows passes, the next number beyond does not.

The vehicle rests at the origin, where sums and differences with zero are exact, and no weight
makes a cost of it, so that nothing but the tolerance in question can object.
"""

import math
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import pytest
from plans import assembled, changed

from orbimpc_ros.mpc.check import command_violations, violations
from orbimpc_ros.mpc.plan import UNPROVED, Command, Plan
from orbimpc_ros.mpc.problem import Box, Floor, Problem, State, Weights

# As documented, not as imported: a check that allows more must not have its tests follow it.
TOLERANCE, ORTHOGONAL, SUMMING, ROUNDING = 1e-6, 1e-9, 1e-9, 1e-15
FREE = Problem(weights=Weights(0.0, 0.0, 0.0, 0.0))
COASTING = replace(FREE, rotation_order=2)
GOALS = np.zeros((5, 2))
FAR = 1e9  # [m] from the origin, where numbers are 1e-7 apart


def resting(problem=FREE, x=(0.0, 0.0), place=(0.0, 0.0)):
    """The vehicle at rest, and a plan whose rotations all have the coordinates x."""
    coasted = np.eye(2) if problem.rotation_order == 2 else None
    state = State.at(place, np.zeros((2, 2)), attitude=np.eye(2), coasted=coasted)
    return Checked(problem, state, GOALS, assembled(problem, state, GOALS, np.tile(x, (5, 1))))


class Checked(NamedTuple):
    """What the check is asked of."""

    problem: Problem
    state: State
    goals: np.ndarray
    plan: Plan

    def but(self, **changes):
        """Return the same with something else in the plan."""
        return self._replace(plan=replace(self.plan, **changes))


def with_one(name, index):
    """A plan with one number of an array moved."""

    def made(error):
        known = resting()
        return known.but(**{name: changed(getattr(known.plan, name), index, error)})

    return made


def above_a_floor(error):
    floor = Floor('circle', 4, 2 * TOLERANCE)
    return resting(replace(FREE, floor=floor), (2 * TOLERANCE - error, 0.0))


def inside_a_box(error, **given):
    return resting(replace(FREE, obstacles=(Box([-1.0, -error], [1.0, 1.0]),), **given))


def beside_the_arrival(error):
    known = resting(replace(FREE, terminal='constraint'))
    return known._replace(goals=changed(GOALS, (4, 1), error))


def bounded_above_its_cost(error):
    return resting().but(proof=replace(UNPROVED, lower_bound=error, cost_unit=4.0))


def skewed(error):
    known, shear = resting(), np.array([[1.0, error], [0.0, 1.0]])
    return known.but(projected=changed(known.plan.projected, 5, shear))


def turned_from(problem, k):
    """A plan whose projected rotations Q_k and after are turned a little."""

    def made(error):
        known = resting(problem)
        return known.but(projected=changed(known.plan.projected, slice(k, None), turned(error)))

    return made


def turned(sine):
    return np.array([[1.0, -sine], [sine, 1.0]])


@pytest.mark.parametrize(
    ('made', 'allowed', 'complaint'),
    [
        (with_one('positions', (2, 1)), TOLERANCE, 'positions differ by 1e-06 from a rollout'),
        (with_one('velocities', (2, 1)), TOLERANCE, 'velocities differ by 1e-06 from a rollout'),
        (with_one('rotations', (3, 1, 1)), TOLERANCE, 'rotations differ by 1e-06 from a rollout'),
        (lambda e: resting(COASTING, (0.0, e)), TOLERANCE, 'R_1 strays 1e-06 from where'),
        (lambda e: resting(COASTING, (-e, 0.0)), TOLERANCE, 'R_1 thrusts backwards by 1e-0'),
        (above_a_floor, TOLERANCE, 'floor violated by 1e-06'),
        (inside_a_box, TOLERANCE, 'obstacle violated by 1e-06'),
        (partial(inside_a_box, no_corner_cutting=True), TOLERANCE, 'obstacle violated by 1e-06'),
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
    nothing = resting(Problem()).but(proof=replace(UNPROVED, lower_bound=0.0))
    assert nothing.plan.objective == 0.0
    assert violations(*nothing) == []
    assert violations(*nothing.but(objective=5e-324)) == ['the objective is 0, not 4.94066e-324']


@pytest.mark.parametrize('side', [-1.0, 1.0])
def test_an_objective_may_be_off_by_what_summing_costs(side):
    known = resting(Problem(), (0.5, 0.0))
    for share, fine in ((0.9, True), (1.1, False)):
        told = known.but(objective=known.plan.objective * (1.0 + side * share * SUMMING))
        assert (violations(*told) == []) is fine


@pytest.mark.parametrize('which', ['hull', 'max_rate'])
def test_limits_that_rounding_blurs(which):
    """One and chords are no multiples of the tolerance: it is met from either side."""
    problem = replace(FREE, max_rate=0.3 if which == 'max_rate' else 0.0)
    limit = problem.chord if which == 'max_rate' else 1.0
    for share, told in ((0.9, []), (1.1, [f'{which} violated by 1.1e-06'])):
        assert violations(*resting(problem, (limit + share * TOLERANCE, 0.0))) == told


@pytest.mark.parametrize('order', [1, 2])
@pytest.mark.parametrize(('step', 'forward'), [(0.1, 300.0), (2.0, 0.1)])
def test_lengths_may_be_off_in_proportion_to_what_a_step_moves(order, step, forward):
    problem = replace(FREE, translation_order=order, step=step, forward=forward)
    known = resting(problem)
    for share, fine in ((0.9, True), (1.1, False)):
        error = share * TOLERANCE * forward * step**order
        boxed = replace(problem, obstacles=(Box([-error, -9e9], [9e9, 9e9]),))
        for off in (
            known.but(positions=changed(known.plan.positions, (5, 0), error)),
            known.but(velocities=changed(known.plan.velocities, (5, 0), error / step)),
            known._replace(problem=boxed),
        ):
            assert (violations(*off) == []) is fine


@pytest.mark.parametrize('axis', [0, 1])
@pytest.mark.parametrize('side', [-1.0, 1.0])
def test_far_from_the_origin_rounding_is_allowed_for(axis, side):
    """1e9 m away it is as much as the tolerance of a step of a metre: together 2e-6 m."""
    place = side * FAR * np.eye(2)[axis]
    known = resting(replace(FREE, terminal='constraint'), place=place)
    known = known._replace(goals=np.tile(place, (5, 1)))
    assert violations(*known) == []
    for error, fine in ((1.7e-6, True), (2.4e-6, False)):
        there = side * FAR + error
        off = known.but(positions=changed(known.plan.positions, (3, axis), there))
        assert (violations(*off) == []) is fine
        aside = known._replace(goals=changed(known.goals, (4, axis), there))
        assert (violations(*aside) == []) is fine


# --- the command


STILL = Command(0.0, np.zeros(1), np.eye(2))


@pytest.mark.parametrize(
    ('made', 'allowed', 'complaint'),
    [
        (
            lambda e: {'speed_fraction': e},
            TOLERANCE,
            'the commanded speed is not that of the plan',
        ),
        (
            lambda e: {'rotation': turned(e)},
            ORTHOGONAL,
            'the commanded rotation is not where the commanded rate leads',
        ),
    ],
)
def test_a_command_may_be_off_by_exactly_its_tolerance(made, allowed, complaint):
    for error, told in ((allowed, []), (np.nextafter(allowed, 1.0), [complaint])):
        assert command_violations(FREE, resting().plan, replace(STILL, **made(error))) == told


def test_a_commanded_rotation_may_be_off_its_plan_by_exactly_the_tolerance():
    plan = resting().plan
    sines = 2.0 * math.sin(0.5 * TOLERANCE) + np.spacing(TOLERANCE) * np.arange(-20, 21)
    off = {}
    for sine in sines:
        told = replace(STILL, rotation=turned(sine), body_rate=np.array([sine]))
        # The angle as the norm of what a rotation changes has it.
        seen = 2.0 * math.asin(np.linalg.norm(turned(sine) - np.eye(2)) / math.sqrt(8.0))
        off[seen] = command_violations(FREE, plan, told)
    assert TOLERANCE in off
    complaint = 'the commanded rotation is 1e-06 rad from that of the plan'
    for seen, found in off.items():
        assert found == ([] if seen <= TOLERANCE else [complaint])
