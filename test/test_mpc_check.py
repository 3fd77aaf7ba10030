# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The check before publishing: rollouts from the measured state, limits at every step, the cost."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from plans import GOALS, START, assembled, changed, only_complaint, solved, steered, straight
from problems import ORDERS, floor, rotation, state
from problems import goals as goals_of

from orbimpc_ros.mpc.check import margins, violations
from orbimpc_ros.mpc.geometry.rotations import coordinates, exp, matrix
from orbimpc_ros.mpc.plan import UNPROVED, Plan
from orbimpc_ros.mpc.problem import Box, Problem, State, Weights

# Copied from the documentation, not imported: a loosened check must fail these tests.
TOLERANCE, ORTHOGONAL, SUMMING, ROUNDING = 1e-6, 1e-9, 1e-9, 1e-15
# --- a rollout from the measured state


@pytest.mark.parametrize('name', ['positions', 'velocities', 'rotations', 'projected'])
@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_not_finite(name, value):
    problem = Problem()
    plan = solved(problem)
    broken = replace(plan, **{name: changed(getattr(plan, name), -1, value)})
    assert only_complaint(problem, broken) == 'plan is not finite'
    assert only_complaint(problem, replace(plan, objective=value)) == 'plan is not finite'


@pytest.mark.parametrize('what', ['position', 'rotation', 'rotation_rate', 'velocity'])
def test_a_plan_starts_from_the_measured_state_in_all_its_parts(what):
    """Otherwise a plan with its own R_0, W_0 or p_0 would pass as consistent with itself."""
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


# --- limits


def speeding(name, least=1.0, **given):
    """Return cases of straight flight at a speed limit, with step k beyond it."""

    def made(k, by):
        by = by if name == 'hull' else -by
        problem = Problem(**given)
        start, goals, plan = straight(problem, changed(np.full(5, least), k, least + by))
        return problem, start, goals, plan

    return name, made


def jumping(name, side, decided=False, **given):
    """Return cases whose speed jumps in step k: without a floor, max_rate limits this chord too."""

    def made(k, by):
        problem = Problem(**{name: 0.3}, **given)
        most = problem.chord if name == 'max_rate' else 0.3
        speeds = np.where(np.arange(5) < k, 0.5, 0.5 + side * (most + by))
        first = {'rotation_rate': (speeds[0] - 0.5) * np.eye(2)} if decided else {}
        start = State.at(np.zeros(2), 0.5 * np.eye(2), **(first or {'coasted': np.eye(2)}))
        return problem, start, GOALS, steered(problem, start, speeds, np.zeros(5))

    return name, made


def turning(turn, speed, **given):
    """Return cases that turn in step k: with a floor, max_rate limits the angle, even if slow."""

    def made(k, by):
        problem = Problem(max_rate=turn, floor=floor('circle', 0.2), **given)
        angles = np.where(np.arange(5) < k, 0.0, turn + by)
        known = {'attitude': np.eye(2), 'coasted': exp(angles[:1])}
        start = State.at(np.zeros(2), speed * np.eye(2), **known)
        sizes = np.where(np.arange(5) % 2, 1.0, 0.2)
        return problem, start, GOALS, steered(problem, start, sizes, angles)

    return 'max_rate', made


def passing(first, **given):
    """Return cases that pass a box at s_{k + 1}, or a corner after it; a second box is far away."""

    def made(k, by):
        start, goals, plan = straight(Problem(), np.ones(5))
        low, high = (k + 1.4, k + 1.6) if given else (k + 0.9, k + 1.1)
        boxes = Box([low, -by], [high, 0.5]), Box([50.0, 50.0], [51.0, 51.0])
        return Problem(obstacles=boxes[::first], **given), start, goals, plan

    return 'obstacle', made


LIMITS = {
    'hull': speeding('hull'),
    'hull in space': speeding('hull', dimension=3),
    'faces': speeding('floor', 0.5, floor=floor('polygon', 0.5, 6)),
    'circle': speeding('floor', 0.5, floor=floor('circle', 0.5)),
    'faces in space': speeding('floor', 0.5, dimension=3, floor=floor('polygon', 0.5, 6)),
    'shorter chord': jumping('max_rate', -1.0),
    'longer chord': jumping('max_rate', 1.0),
    'braking': jumping('max_acceleration', -1.0),
    'speeding up': jumping('max_acceleration', 1.0),
    'chord of a body that coasts': jumping('max_rate', 1.0, rotation_order=2),
    'speed of a body that coasts': jumping('max_acceleration', 1.0, rotation_order=2),
    'decided speed': jumping('max_acceleration', 1.0, decided=True, rotation_order=2),
    'turn from rest': turning(0.3, 0.0),
    'wide turn': turning(1.5, 0.2),
    'wider turn': turning(2.5, 1.0),
    'turn of a body that coasts': turning(0.3, 0.2, rotation_order=2),
    'first box': passing(1),
    'second box': passing(-1),
    'corner': passing(1, no_corner_cutting=True),
}
UNBOUND = {('decided speed', 0), ('turn of a body that coasts', 0), ('corner', 4)}


@pytest.mark.parametrize('k', range(5))
@pytest.mark.parametrize('kind', LIMITS)
def test_each_limit_binds_at_every_step(kind, k):
    """A violation in any step k is refused, unless the state decides it, or it is past the end."""
    name, made = LIMITS[kind]
    for share, told in ((-1.1, []), (0.9, []), (1.1, [f'{name} violated by 1.1e-06'])):
        assert violations(*made(k, share * TOLERANCE)) == ([] if (kind, k) in UNBOUND else told)


def test_arriving_in_motion():
    moving = Problem(translation_order=2)
    plan = solved(moving)
    there = np.tile(plan.positions[-1], (5, 1))
    stopped = replace(moving, terminal='constraint')
    found = violations(stopped, START, there, plan)
    assert {each.split()[0] for each in found} == {'terminal', 'the'}  # and the objective's


@pytest.mark.parametrize('shape', ['circle', 'polygon'])
def test_a_floor_is_under_the_thrust_axis_alone(shape):
    """The other columns of R describe the roll, and may vanish."""
    problem = Problem(3, floor=floor(shape, 0.5, 6))
    start = State.at(np.zeros(3), np.diag([1.0, 0.0, 0.0]), attitude=np.eye(3))
    x = np.tile(coordinates(np.diag([1.0, 0.0, 0.0])), (5, 1))
    plan = assembled(problem, start, np.zeros((5, 3)), x)
    assert violations(problem, start, np.zeros((5, 3)), plan) == []


def test_the_corner_before_the_first_step_is_not_the_plans():
    """R_0 or p_0 decides s_1: no plan can change the path to it."""
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


# --- tolerances: the exact value passes, the next larger number does not

FREE = Problem(weights=Weights(0.0, 0.0, 0.0, 0.0))
COASTING, ARRIVING = replace(FREE, rotation_order=2), replace(FREE, terminal='constraint')
REST = np.zeros((5, 2))
STRAYS = 'a projected rotation strays 1e-06 from its projection'
FAR = 1e9  # [m] from the origin, where floats are 1e-7 apart


class Checked(NamedTuple):
    """Arguments of the check."""

    problem: Problem
    state: State
    goals: np.ndarray
    plan: Plan

    def but(self, **changes):
        """Return a copy with changed fields of the plan."""
        return self._replace(plan=replace(self.plan, **changes))

    def off(self, name, index, value):
        """Return a copy with a changed element in an array of the plan."""
        return self.but(**{name: changed(getattr(self.plan, name), index, value)})


def resting(problem=FREE, x=(0.0, 0.0), place=(0.0, 0.0), goals=REST):
    """A vehicle at rest, and a plan whose rotations all have the coordinates x.

    At the origin sums and differences with zero are exact, and the cost has no weights, so that
    only the tolerance under test can be violated.
    """
    coasted = np.eye(2) if problem.rotation_order == 2 else None
    state = State.at(place, np.zeros((2, 2)), attitude=np.eye(2), coasted=coasted)
    return Checked(problem, state, goals, assembled(problem, state, goals, np.tile(x, (5, 1))))


def turned(sine):
    return np.array([[1.0, -sine], [sine, 1.0]])


@pytest.mark.parametrize(
    ('made', 'allowed', 'complaint'),
    [
        (lambda e: resting().off('positions', (2, 1), e), TOLERANCE, 'positions differ by 1e-06'),
        (lambda e: resting().off('velocities', (2, 1), e), TOLERANCE, 'velocities differ by 1e-0'),
        (lambda e: resting().off('rotations', (0, 1, 1), e), TOLERANCE, 'rotations differ by 1e-'),
        (lambda e: resting().off('rotations', (3, 1, 1), e), TOLERANCE, STRAYS),
        (lambda e: resting(COASTING, (0.0, e)), TOLERANCE, 'R_1 strays 1e-06 from the'),
        (lambda e: resting(COASTING, (-e, 0.0)), TOLERANCE, 'R_1 thrusts backwards by 1e-0'),
        (
            lambda e: resting(ARRIVING, goals=changed(REST, (4, 1), e)),
            TOLERANCE * (1 + ROUNDING),
            'terminal constraint missed by 1e-06',
        ),
        (
            lambda e: resting().but(proof=replace(UNPROVED, lower_bound=e, cost_unit=4.0)),
            4 * TOLERANCE,
            'the lower bound exceeds the cost of 0 by 4e-06',
        ),
        (
            lambda e: resting().off('projected', 5, np.array([[1.0, e], [0.0, 1.0]])),
            ORTHOGONAL,
            'a projected rotation is not orthogonal',
        ),
        (
            lambda e: resting().off('projected', slice(None), turned(e)),
            ORTHOGONAL,
            'the first rotation is not the measured attitude',
        ),
        (
            lambda e: resting(COASTING).off('projected', slice(1, None), turned(e)),
            ORTHOGONAL,
            'the second rotation is not the first turned',
        ),
        (lambda e: resting().off('projected', slice(3, None), turned(e)), TOLERANCE, STRAYS),
    ],
)
def test_a_plan_may_be_off_by_exactly_its_tolerance(made, allowed, complaint):
    assert violations(*made(allowed)) == []
    found = violations(*made(np.nextafter(allowed, 1.0)))
    assert len(found) == 1
    assert found[0].startswith(complaint)


@pytest.mark.parametrize('order', [1, 2])
@pytest.mark.parametrize(
    ('step', 'forward', 'place', 'axis'),
    [
        (0.1, 300.0, [0.0, 0.0], 0),
        (2.0, 0.1, [0.0, 0.0], 1),
        (1.0, 1.0, [FAR, 0.0], 0),
        (1.0, 1.0, [0.0, -FAR], 1),
    ],
)
def test_lengths_may_be_off_by_a_share_of_a_step_and_by_rounding(order, step, forward, place, axis):
    problem = replace(ARRIVING, translation_order=order, step=step, forward=forward)
    known = resting(problem, place=place, goals=np.tile(place, (5, 1)))
    allowed = TOLERANCE * forward * step**order + ROUNDING * abs(place[axis])
    for share, fine in ((0.85, True), (1.2, False)):
        error = share * allowed
        there = place[axis] + error
        low = changed(np.full(2, -9e9), axis, place[axis] - error)
        for off in (
            known.off('positions', (3, axis), there),
            known.off('velocities', (3, axis), error / step),
            known._replace(goals=changed(known.goals, (4, axis), there)),
            known._replace(problem=replace(problem, obstacles=(Box(low, np.full(2, 9e9)),))),
        ):
            assert (violations(*off) == []) is fine


# --- objective and bound


def test_at_its_goal_a_plan_may_cost_nothing():
    nothing = resting(Problem()).but(proof=replace(UNPROVED, lower_bound=0.0))
    assert nothing.plan.objective == 0.0
    assert violations(*nothing) == []
    assert violations(*nothing.but(objective=5e-324)) == ['the objective is 0, not 4.94066e-324']


def test_a_steady_turn_may_cost_nothing_but_rounding():
    problem = Problem(rotation_order=2, step=0.3, weights=Weights(position=0.0, terminal=0.0))
    rate = np.array([0.1, 0.2])
    start = State.at([0.0, 0.0], 0.3 * np.eye(2), rotation_rate=matrix(rate))
    x = [0.3, 0.0] + 0.3 * np.outer(np.arange(1.0, 6.0), rate)
    plan = assembled(problem, start, GOALS, x)
    assert 0.0 < plan.objective < 1e-20
    assert violations(problem, start, GOALS, plan) == []


@pytest.mark.parametrize(
    ('excess', 'unit'), [(1e-4, 1.0), (9.0, 1.0), (np.inf, 1.0), (np.nan, 1.0), (1.0, np.inf)]
)
def test_a_bound_above_the_cost_is_refused(excess, unit):
    """Also if the bound or its unit overflows."""
    plan = solved(Problem())
    unit *= plan.proof.cost_unit
    bound = plan.objective + excess * (plan.objective + plan.proof.cost_unit)
    claimed = replace(plan, proof=replace(plan.proof, lower_bound=bound, cost_unit=unit))
    assert 'lower bound exceeds' in only_complaint(Problem(), claimed)


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
    for units, status in ((1e8, 'feasible'), (1e10, 'optimal')):  # of the cost: a gap far below one
        proof = replace(plan.proof, lower_bound=0.0, cost_unit=units * plan.objective)
        assert replace(plan, proof=proof).status == status


@pytest.mark.parametrize('orders', ORDERS)
@pytest.mark.parametrize('arrival', [0.0, 0.5, 3.0])
def test_every_term_of_the_objective_is_summed(orders, arrival):
    """As in the model's cost, which other tests compare with independent convex optima."""
    rng = np.random.default_rng(int(10 * arrival) + orders['dimension'])
    for length, how in ((0.0, 'euler'), (0.7, 'euler'), (0.7, 'exact')):
        chosen = Weights(0.9, 0.4, length, 2.0, attitude=1.3)
        known = {**orders, 'weights': chosen, 'arrival_weight': arrival, 'discretisation': how}
        problem = Problem(horizon=4, step=0.7, forward=3.0, **known)
        start, places = state(rng, problem), goals_of(rng, problem)
        n = problem.dimension
        start = replace(start, wanted=rotation(rng, n))
        squeezed = np.diag([1.0, 0.5, 0.5][:n])  # makes the first column longer than the others
        points = [rng.uniform(0.1, 0.9) * rotation(rng, n) @ squeezed for _ in range(4)]
        if start.coasted is not None:
            points[0] = 0.8 * start.coasted
        plan = assembled(problem, start, places, coordinates(np.array(points)))
        assert violations(problem, start, places, plan) == []
        for share in (-1.1, -0.9, 0.9, 1.1):
            off = replace(plan, objective=plan.objective * (1.0 + share * SUMMING))
            found = violations(problem, start, places, off)
            assert [each[:16] for each in found] == ['the objective is'] * (abs(share) > 1.0)


def test_an_overflow_of_the_cost_excuses_nothing():
    endless = Problem(weights=Weights(position=1e308))
    with np.errstate(over='ignore'):
        found = only_complaint(endless, solved(Problem()))
    assert found.startswith('the objective is inf, not ')
