# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A limit of the change of speed: plans, bounds, prices and commands keep to it."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from problems import floor
from scipy.optimize import minimize
from stepping import Stepped
from test_mpc_turns import cost, random_problem, random_start

from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.check import command_violations, violations
from orbimpc_ros.mpc.command import Command, command_of, flaw
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.mpc.plan import UNPROVED, assemble
from orbimpc_ros.mpc.problem import (
    Approach,
    Ball,
    Box,
    Floor,
    MovingObstacle,
    Problem,
    State,
    Weights,
)
from orbimpc_ros.mpc.problem.case import case_of
from orbimpc_ros.mpc.problem.pace import entry_speed
from orbimpc_ros.mpc.problem.reach import clear_of_hazards
from orbimpc_ros.mpc.sensitivity.constraints import explained
from orbimpc_ros.mpc.solve.solver import Solver

needs_machine_code = pytest.mark.skipif(
    not COMPILED, reason='sectors are searched in machine code: install numba'
)
ROUND, OCTAGON = ('circle', 4), ('polygon', 8)


def limited(rng, shape, faces, horizon):
    problem = random_problem(rng, shape, faces, horizon=horizon)
    change = rng.choice([0.02, 0.08, 0.2])
    return replace(problem, max_acceleration=change * problem.forward / problem.step)


def changes(problem, start, plan):
    speeds = plan.speed_fraction.copy()
    speeds[0] = entry_speed(problem, start)
    return np.abs(np.diff(speeds)) * problem.forward / problem.step


def descended(problem, start, targets, rng):
    """The least cost of descents in speeds and turns from several starts, by another solver."""
    count, widest = problem.horizon, min(np.pi, problem.step * problem.max_rate)
    first = np.arctan2(start.attitude[1, 0], start.attitude[0, 0])
    entry, least = entry_speed(problem, start), problem.floor.fraction
    chain = np.hstack([np.eye(count) - np.eye(count, k=-1), np.zeros((count, count))])
    begun, most = np.eye(count)[0] * entry, problem.speed_change

    def headings(y):
        around = first + np.cumsum(y[count:])
        return y[:count, None] * np.column_stack([np.cos(around), np.sin(around)])

    kept = [
        {'type': 'ineq', 'fun': lambda y: most + begun - chain @ y, 'jac': lambda y: -chain},
        {'type': 'ineq', 'fun': lambda y: most - begun + chain @ y, 'jac': lambda y: chain},
    ]
    box, found = [(least, 1.0)] * count + [(-widest, widest)] * count, []
    for turn in (-1.0, -0.3, 0.3, 1.0):
        y = np.concatenate([np.full(count, entry), np.full(count, turn * widest)])
        answer = minimize(
            lambda y: cost(problem, start, targets, headings(y)),
            y, method='SLSQP', bounds=box, constraints=kept, options={'maxiter': 60},
        )  # fmt: skip
        y, before = np.clip(answer.x, *np.transpose(box)), entry
        for k in range(count):  # what it ends with may break the limit by little
            before = y[k] = np.clip(y[k], max(least, before - most), min(1.0, before + most))
        found.append(cost(problem, start, targets, headings(y)))
    return min(found)


@needs_machine_code
def test_another_solver_never_beats_what_is_called_optimal():
    rng = np.random.default_rng(61)
    for _ in range(8):
        problem = limited(rng, *ROUND, 5)
        start, targets = random_start(rng, problem)
        plan = Solver(problem).solve(start, targets)
        other = descended(problem, start, targets, rng)
        assert plan.status == 'optimal'
        assert plan.lower_bound <= other * (1.0 + 1e-9)
        assert plan.objective <= other * (1.0 + 1e-4)


@needs_machine_code
@pytest.mark.parametrize('shape', [ROUND, OCTAGON])
def test_two_steps_against_a_grid(shape):
    rng = np.random.default_rng(67)
    for _ in range(3):
        problem = limited(rng, *shape, 2)
        start, targets = random_start(rng, problem)
        plan = Solver(problem).solve(start, targets)
        assert plan.status == 'optimal'
        widest, most = min(np.pi, problem.step * problem.max_rate), problem.speed_change
        first = np.arctan2(start.attitude[1, 0], start.attitude[0, 0])
        entry, least = entry_speed(problem, start), np.inf
        for a in np.linspace(-widest, widest, 13):
            for b in np.linspace(-widest, widest, 13):
                units = [np.array([np.cos(t), np.sin(t)]) for t in (first + a, first + a + b)]
                lows = [problem.floor.least(unit) for unit in units]
                for s in entry + most * np.linspace(-1.0, 1.0, 7):
                    for t in s + most * np.linspace(-1.0, 1.0, 7):
                        if lows[0] <= s <= 1.0 and lows[1] <= t <= 1.0:
                            z = np.array([s * units[0], t * units[1]])
                            least = min(least, cost(problem, start, targets, z))
        assert plan.lower_bound <= least
        assert plan.objective <= least * (1.0 + 1e-4)


@needs_machine_code
@pytest.mark.parametrize('shape', [ROUND, OCTAGON, ('polygon', 4)])
@pytest.mark.parametrize('turning', [True, False])
def test_plans_of_a_search_cut_short_keep_to_the_limit(shape, turning):
    rng = np.random.default_rng(71)
    for _ in range(6):
        problem = limited(rng, *shape, 12)
        problem = problem if turning else replace(problem, max_rate=0.0)
        start, targets = random_start(rng, problem)
        polls = iter(range(3))
        plan = Solver(problem).solve(
            start, targets, out_of_time=lambda polls=polls: next(polls, None) is None
        )
        assert violations(problem, start, targets, plan) == []
        assert changes(problem, start, plan).max() <= problem.max_acceleration * (1.0 + 1e-5)
        assert plan.nodes > 0  # not what stands in for a plan


ROUTES = {
    'hull': {},
    'chord': {'max_rate': 1.0},
    'arrival': {'terminal': 'constraint'},
    'space': {'dimension': 3},
    'box': {'obstacles': (Box(np.array([1.0, 1.5]), np.array([2.0, 2.5])),)},
    'length': {'weights': Weights(1.0, 0.05, 0.3, 10.0), 'discretisation': 'exact'},
}


@pytest.mark.parametrize('name', ROUTES)
def test_every_route_slows_down_in_time_and_its_bound_is_at_least_that_without_the_limit(name):
    problem = Problem(max_acceleration=0.2, **ROUTES[name])
    n = problem.dimension
    start = State.at(np.zeros(n), 0.7 * np.eye(n))
    targets = np.tile([2.2, 0.4, 0.3][:n], (5, 1))
    plan, free = (Solver(p).solve(start, targets) for p in (problem, _freed(problem)))
    assert violations(problem, start, targets, plan) == []
    assert changes(problem, start, plan).max() <= 0.2 * (1.0 + 1e-5)
    assert changes(problem, start, free).max() > 0.25
    assert free.lower_bound <= plan.lower_bound * (1.0 + 1e-6) <= plan.objective * (1.0 + 1e-6)
    assert free.objective <= plan.objective * (1.0 + 1e-5)


FAR = {'hazards': (MovingObstacle.drifting(Ball([40.0, 9.0], 1.0), [0.1, 0.3]),)}
BESIDE = {
    'far': ({}, FAR),
    'far, floor': ({'floor': Floor('circle', fraction=0.4), 'max_rate': 1.0}, FAR),
    'moving': ({}, {'hazards': (MovingObstacle.drifting(Ball([1.2, 1.0], 0.4), [0.0, -0.1]),)}),
    'moving box': (
        {'discretisation': 'exact'},
        {'hazards': (MovingObstacle.drifting(Box([0.9, 0.5], [1.5, 1.2]), [0.0, -0.02]),)},
    ),
    'moving, floor': (
        {'floor': Floor('circle', fraction=0.4), 'max_rate': 1.0},
        {'hazards': (MovingObstacle.drifting(Ball([1.2, 0.9], 0.4), [0.0, -0.1]),)},
    ),
    'discs': ({'obstacles': (Ball([1.2, 0.6], 0.35),)}, {}),
    'box': ({'obstacles': (Box([0.9, -0.3], [1.5, 0.3]),), 'no_corner_cutting': True}, {}),
    'approach': ({'approach': Approach(0.4, (1.0, 0.8))}, {}),
    'glide slope': ({'dimension': 3, 'glide_slope': 0.3}, {}),
}


@pytest.mark.parametrize('name', BESIDE)
def test_whatever_else_limits_a_plan_it_slows_down_in_time_and_is_no_stand_in(name):
    model, more = BESIDE[name]
    if 'floor' in model and not COMPILED:
        pytest.skip('sectors are searched in machine code: install numba')
    problem = Problem(horizon=6, max_acceleration=0.25, **model)
    n = problem.dimension
    above = np.eye(3)[2] * (1.2 if n == 3 else 0.0)
    start = State.at(above[:n], 0.6 * np.eye(n), **more)
    targets = np.tile([2.4, 0.3, 0.0][:n], (6, 1))
    polls = itertools.count()
    plan = Solver(problem).solve(start, targets, None, lambda: next(polls) > 400)
    assert violations(problem, start, targets, plan) == []
    assert plan.proof.reason == ''  # not what stands in for a plan
    # Without machine code nothing is counted in time, and nothing published.
    bound = plan.lower_bound if COMPILED else plan.proof.lower_bound
    assert 0.0 < bound <= plan.objective <= 1.5 * bound


def test_what_is_surely_out_of_reach_is_left_out_of_the_search():
    problem, wanted = Problem(horizon=5), State.at([0.0, 0.0], np.eye(2))
    moving = [MovingObstacle.drifting(Ball([7.0, 0.0], 1.0), [v, 0.0]) for v in (0.0, -0.15, -0.25)]
    found = [clear_of_hazards(problem, replace(wanted, hazards=(each,))) for each in moving]
    assert [len(each.hazards) for each in found] == [0, 0, 1]  # 5 m and 6 m less the way of it
    near, far = moving[2], moving[0]
    assert len(clear_of_hazards(problem, replace(wanted, hazards=(far, near))).hazards) == 2
    grown = replace(far, reserve=1.1)
    assert len(clear_of_hazards(problem, replace(wanted, hazards=(grown,))).hazards) == 1


def _freed(problem):
    return replace(problem, max_acceleration=0.0)


def test_speeds_along_a_straight_way_are_the_best_ones():
    """Straight on, a plan is its speeds: what another solver finds of those, in a box and chain."""
    problem = Problem(horizon=6, max_acceleration=0.15)
    start, targets = State.at([0.0, 0.0], 0.2 * np.eye(2)), np.tile([2.0, 0.0], (6, 1))
    plan = Solver(problem).solve(start, targets)
    ahead, chain = np.array([1.0, 0.0]), np.eye(6) - np.eye(6, k=-1)
    begun = 0.2 * np.eye(6)[0]
    kept = [
        {'type': 'ineq', 'fun': lambda y: 0.15 + begun - chain @ y},
        {'type': 'ineq', 'fun': lambda y: 0.15 - begun + chain @ y},
    ]
    best = minimize(
        lambda y: cost(problem, start, targets, np.outer(y, ahead)),
        np.full(6, 0.2), method='SLSQP', bounds=[(0.0, 1.0)] * 6, constraints=kept,
    )  # fmt: skip
    assert plan.objective == pytest.approx(best.fun, rel=1e-5)


@pytest.mark.parametrize('change', [-0.1001, 0.1001])
@pytest.mark.parametrize('k', [0, 2])
def test_a_plan_that_changes_speed_too_fast_is_refused(change, k):
    problem = Problem(horizon=4, max_acceleration=0.1)
    start, targets = State.at([0.0, 0.0], 0.5 * np.eye(2)), np.ones((4, 2))
    x = np.tile([0.5, 0.0], (4, 1))
    x[k:, 0] += change
    plan = assemble(problem, start, targets, x, projection='nearest', proof=UNPROVED)
    (found,) = violations(problem, start, targets, plan)
    assert found.startswith('max_acceleration violated by 0.0001')
    assert violations(replace(problem, max_acceleration=0.1002), start, targets, plan) == []


def test_changes_count_from_what_was_commanded_and_from_the_floor_up():
    problem = Problem(max_acceleration=0.1, floor=floor('circle', 0.5, 4))
    assert entry_speed(problem, State.at([0.0, 0.0], 0.8 * np.eye(2))) == pytest.approx(0.8)
    told = State.at([0.0, 0.0], 0.8 * np.eye(2), commanded=0.6)
    assert entry_speed(problem, told) == 0.6
    assert entry_speed(problem, State.at([0.0, 0.0], 0.1 * np.eye(2))) == 0.5
    plan = Solver(problem).solve(State.at([0.0, 0.0], 0.1 * np.eye(2)), np.ones((5, 2)))
    assert 0.5 - 1e-6 <= plan.speed_fraction[1] <= 0.6 + 1e-6


def test_the_last_look_refuses_a_jump_of_speed():
    problem = Problem(max_acceleration=0.1)
    for fraction, entry, fine in ((0.6, 0.5, True), (0.61, 0.5, False), (0.39, 0.5, False)):
        command = Command(fraction, np.zeros(1), np.eye(2))
        assert (flaw(problem, command, entry=entry) == '') is fine
        assert flaw(problem, command, entry=entry, stopping=True) == ''
        assert flaw(_freed(problem), command, entry=entry) == ''


def test_a_speed_that_a_cut_turn_reduces_is_not_reduced_faster_than_allowed():
    problem = Problem(max_rate=0.5, max_acceleration=0.05)
    start = State.at([0.0, 0.0], 0.3 * np.eye(2))
    x = np.tile([0.02, 0.3], (5, 1))
    plan = assemble(problem, start, np.ones((5, 2)), x, projection='thrust_aligned', proof=UNPROVED)
    command = command_of(problem, start, plan)
    assert command.speed_fraction == pytest.approx(0.25)
    assert command_violations(problem, plan, command, 0.3) == []
    assert command_violations(problem, plan, replace(command, speed_fraction=0.15), 0.3) != []


def flown(controller, period, seconds, goal, speed=0.0):
    """Commands of a vehicle that takes each one over as fast as it may, at once where it may."""
    problem, place, heading, log = controller.problem, np.zeros(2), 0.0, []
    for k in range(round(seconds / period)):
        measured = Odometry(
            k * period, place.copy(), exp(np.array([heading])), np.array([speed, 0.0]), np.zeros(1)
        )
        tick = controller.tick(measured, np.tile(goal, (problem.horizon, 1)))
        log.append((speed, tick))
        wanted = problem.forward * tick.command.speed_fraction
        most = period * (problem.max_acceleration or np.inf)
        speed = min(speed + most, max(speed - most, wanted))
        heading += period * float(tick.command.body_rate[0])
        place = place + period * speed * np.array([np.cos(heading), np.sin(heading)])
    return log, place


@pytest.mark.parametrize('period', [0.5, 0.1])
def test_a_vehicle_without_a_floor_comes_to_rest_at_its_goal(period):
    problem = Problem(step=0.5, horizon=8, forward=2.0, max_acceleration=0.8)
    controller = Stepped(problem)
    log, place = flown(controller, period, 14.0, np.array([6.0, 1.0]))
    for speed, tick in log:
        assert tick.fallback == '', tick.reason
        assert abs(2.0 * tick.command.speed_fraction - speed) <= 0.5 * 0.8 + 1e-5
    assert np.linalg.norm(place - [6.0, 1.0]) < 0.1


@pytest.mark.parametrize('kind', ['loiter', 'hold_rate_zero', 'stop'])
def test_safe_commands_change_speed_as_plans_do_but_for_a_stop(kind):
    problem = Problem(max_acceleration=0.1, floor=floor('circle', 0.5, 4))
    controller = Stepped(problem, safe=kind)
    measured = Odometry(0.0, np.zeros(2), np.eye(2), np.array([1.0, 0.0]), np.zeros(1))
    first = controller.tick(measured, np.tile([9.0, 0.0], (5, 1))).command.speed_fraction
    told = []
    for _ in range(8):
        command = controller.safe(np.eye(2), Reason(Cause.ODOMETRY, 'lost')).command
        told.append(command.speed_fraction)
    steps = np.abs(np.diff([first, *told]))
    if kind == 'stop':
        assert told == [0.0] * 8
    else:
        assert steps.max() <= 0.1 + 1e-9
        assert told[-1] == pytest.approx(0.5 if kind == 'loiter' else first)


@needs_machine_code
def test_the_prices_of_a_limit_are_what_a_higher_one_saves():
    problem = Problem(
        horizon=5, forward=2.0, floor=floor('circle', 0.4, 4), max_rate=0.5, max_acceleration=0.2
    )
    start, targets = State.at([0.0, 0.0], 0.5 * np.eye(2)), np.tile([7.0, 1.5], (5, 1))

    def best(most):
        solver = Solver(replace(problem, max_acceleration=most), gap_tolerance=1e-7)
        return solver.solve(start, targets)

    told = explained(problem, start, targets, best(0.2))
    saved = (best(0.2 - 1e-4).objective - best(0.2 + 1e-4).objective) / 2e-4
    prices = [each.price for each in told.binding if each.name == 'max_acceleration']
    assert sum(prices) == pytest.approx(saved, rel=1e-3)
    assert sum(prices) > 0.1
    assert told.unexplained < 1e-4


def test_a_problem_file_may_limit_the_change_of_speed():
    mapping = {
        'dimension': 2, 'rotation_order': 1, 'translation_order': 1, 'horizon': 3, 'step': 0.5,
        'forward': 4.0, 'weights': {'position': 1.0}, 'max_acceleration': 2.0, 'goal': [1.0, 2.0],
        'state': {'position': [0.0, 0.0], 'rotation': [[1.0, 0.0], [0.0, 1.0]]},
    }  # fmt: skip
    assert case_of(mapping).problem.speed_change == 0.25


@pytest.mark.parametrize(
    ('more', 'told'),
    [
        ({'max_acceleration': -1.0}, 'max_acceleration is -1.0; allowed: a number in [0, inf)'),
        (
            {'max_acceleration': 1.0, 'translation_order': 2},
            'max_acceleration is 1.0; allowed: 0 at translation_order 2',
        ),
    ],
)
def test_a_limit_that_cannot_be_is_refused_in_a_line(more, told):
    with pytest.raises(BadInput) as error:
        Problem(**more)
    assert str(error.value).startswith(told)
