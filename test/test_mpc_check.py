"""The check before publishing: each of its conditions, on a good plan broken in one way."""

from dataclasses import replace

import numpy as np
import pytest
from problems import floor, state

from orbimpc_ros.mpc import problem as problems
from orbimpc_ros.mpc.check import TOLERANCE, command_violations, violations
from orbimpc_ros.mpc.command import command_of
from orbimpc_ros.mpc.orbitopes import coordinates, matrix
from orbimpc_ros.mpc.plan import UNPROVED, assemble, shifted
from orbimpc_ros.mpc.problem import Box, Problem, State, Weights
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


def only_complaint_but_the_cost(problem, plan, start=START, goals=GOALS):
    """Return what is wrong beside the cost, which changes with places and goals."""
    found = [f for f in violations(problem, start, goals, plan) if 'the objective is' not in f]
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


def assembled(problem, start, goals, x):
    """A consistent plan through any rotations: only the limits can object to it."""
    return assemble(problem, start, goals, x, projection='nearest', proof=UNPROVED)


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
    assert 'terminal' in only_complaint_but_the_cost(problem, plan, START, aside)


def test_arriving_in_motion():
    moving = Problem(translation_order=2)
    plan = solved(moving)
    there = np.tile(plan.positions[-1], (5, 1))
    stopped = replace(moving, terminal='constraint')
    assert 'terminal' in only_complaint_but_the_cost(stopped, plan, START, there)


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


# --- every step by itself: a plan that is right everywhere but at one k


def straight(problem, fractions):
    """A consistent plan straight ahead at given speed fractions of R_1..R_N."""
    x = np.outer(fractions, coordinates(np.eye(problem.dimension)))
    start = State.at(np.zeros(problem.dimension), np.eye(problem.dimension))
    goals = np.zeros((problem.horizon, problem.dimension))
    return start, goals, assembled(problem, start, goals, x)


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('k', range(5))
def test_the_orbitope_binds_at_every_step(n, k):
    start, goals, plan = straight(Problem(n), changed(np.ones(5), k, 1.0 + 2 * TOLERANCE))
    assert 'conv SO(n)' in only_complaint(Problem(n), plan, start, goals)


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


# --- the proof


def test_the_objective_is_evaluated_anew():
    for problem in (
        Problem(weights=Weights(1.0, 0.05, 0.3, 10.0)),
        Problem(weights=Weights(0.0, 0.0, 0.3, 0.0), horizon=5),
        Problem(translation_order=2, arrival_weight=3.0, step=0.5),
    ):
        plan = solved(problem)
        for factor in (0.0, 0.5, 1.0 - 1e-6, 1.0 + 1e-6, 10.0):
            told = replace(plan, objective=factor * plan.objective)
            assert 'the objective is' in only_complaint(problem, told)


@pytest.mark.parametrize('excess', [1e-4, 1.0, 9.0, np.inf, np.nan])
def test_a_bound_above_the_cost_is_refused(excess):
    problem = Problem()
    plan = solved(problem)
    bound = plan.objective + excess * (plan.objective + plan.proof.cost_unit)
    claimed = plan.proved(replace(plan.proof, lower_bound=bound))
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
        assert plan.proved(replace(plan.proof, lower_bound=bound)).status == status
    assert replace(plan, objective=np.inf).status == 'feasible'
    assert plan.proved(UNPROVED).status == 'feasible'


# --- rotations and the command


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


@pytest.mark.parametrize('projection', ['nearest', 'thrust_aligned'])
@pytest.mark.parametrize('k', range(6))
@pytest.mark.parametrize('axis', range(3))
def test_every_projected_rotation_is_the_projection_of_its_own(projection, k, axis):
    problem, start, goals, plan = spatial_plan(projection)
    assert violations(problem, start, goals, plan) == []
    for angle in (1e-4, 2.0, np.pi):
        turned = plan.projected[k] @ exp(angle * np.eye(3)[axis])
        off = replace(plan, projected=changed(plan.projected, k, turned))
        complaint = only_complaint(problem, off, start, goals)
        assert ('strays' if k else 'measured attitude') in complaint


@pytest.mark.parametrize('k', range(6))
def test_every_planar_rotation_heads_where_its_own_does(k):
    plan = solved(Problem())
    for angle in (1e-4, 2.0, np.pi):
        turned = plan.projected[k] @ exp(np.array([angle]))
        off = replace(plan, projected=changed(plan.projected, k, turned))
        assert ('strays' if k else 'measured attitude') in only_complaint(Problem(), off)


def test_a_heading_that_is_undefined_is_held():
    problem = Problem()
    x = np.array([[0.6, 0.8], [0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [0.0, 0.0]])
    plan = assembled(problem, START, GOALS, x)
    assert violations(problem, START, GOALS, plan) == []
    for k in (2, 3, 5):
        other = replace(plan, projected=changed(plan.projected, k, exp(np.array([-0.3]))))
        assert any('strays' in each for each in violations(problem, START, GOALS, other))


def test_the_second_rotation_of_a_coasting_body_is_given():
    problem, start, goals, plan = spatial_plan('thrust_aligned', order=2)
    assert violations(problem, start, goals, plan) == []
    turned = start.coasted @ exp(np.array([1e-6, 0.0, 0.0]))
    off = replace(plan, projected=changed(plan.projected, 1, turned))
    assert 'carries the first' in only_complaint(problem, off, start, goals)


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


def test_a_floor_that_nothing_knows_is_neither_ignored_nor_taken_for_another(monkeypatch):
    """A new shape needs its cells and its margin: without them there is no solver and no check."""
    plan = solved(Problem())
    monkeypatch.setattr(problems, 'FLOOR_SHAPES', ('none', 'diamond'))
    problem = Problem(floor=floor('diamond', 0.5))
    with pytest.raises(NotImplementedError, match='diamond'):
        violations(problem, START, GOALS, plan)
    for other in (problem, replace(problem, max_rate=0.5), replace(problem, dimension=3)):
        with pytest.raises(NotImplementedError, match='diamond'):
            Solver(other)
