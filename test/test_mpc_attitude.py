# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A weight on the attitude at the end: every method finds the optimum that other code finds."""

import itertools
from dataclasses import replace

import cvxpy as cp
import numpy as np
import problems
import pytest
from scipy.optimize import minimize
from stepping import Stepped

from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Box, Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.case import case_of
from orbimpc_ros.mpc.problem.scaling import weighed
from orbimpc_ros.mpc.sensitivity.constraints import explained
from orbimpc_ros.mpc.solve.disjunctive_bnb import DisjunctiveSearch
from orbimpc_ros.mpc.solve.program import Program
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Solver

needs_machine_code = pytest.mark.skipif(
    not COMPILED, reason='the general search leaves a gap; needs numba'
)
WEIGHTS = Weights(1.0, 0.1, 0.0, 3.0, attitude=4.0)


def wanting(rng, problem):
    """A random state that wants a random attitude."""
    start = problems.state(rng, problem, full_speed=False)
    if problem.rotation_order == 2:
        start = replace(start, coasted=None, rotation=0.3 * start.attitude)
    return replace(start, wanted=problems.rotation(rng, problem.dimension))


def hull(r):
    """conv SO(n): a disk, or a linear matrix inequality."""
    if r.shape == (2, 2):
        return [r[0, 0] == r[1, 1], r[0, 1] == -r[1, 0], cp.norm(r[:, 0]) <= 1.0]
    a, b, c = (r[i, i] for i in range(3))
    x, y, z = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    xy, xz, yz = r[1, 0] + r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2]
    rows = [
        [1 + a + b + c, x, y, z],
        [x, 1 + a - b - c, xy, xz],
        [y, xy, 1 - a + b - c, yz],
        [z, xz, yz, 1 - a - b + c],
    ]
    return [cp.bmat(rows) >> 0]


def convex(problem, start, goals):
    """The optimal value of the hull, stated anew, step by step."""
    n, h, w = problem.dimension, problem.step, problem.weights
    r, s, p = [start.rotation], start.position, start.velocity
    rate, rows, cost = start.rotation_rate, [], 0.0
    for k in range(problem.horizon):
        following = cp.Variable((n, n))
        if problem.rotation_order == 1:
            cost += w.input * cp.sum_squares((following - r[-1]) / h)
        else:
            rows.append(following == r[-1] + h * rate)
            if k < problem.horizon - 1:
                faster = cp.Variable((n, n))
                cost += w.input * cp.sum_squares((faster - rate) / h)
                rate = faster
        push = h * problem.forward * r[-1][:, 0]
        s, p = s + (push if problem.translation_order == 1 else h * p), p + push
        r.append(following)
        free = k > 0 or problem.rotation_order == 1
        rows += hull(following) if free else []
        cost += w.position * cp.sum_squares(s - goals[k])
    cost += w.terminal * cp.sum_squares(s - goals[-1])
    cost += w.attitude * cp.sum_squares(r[-1] - start.wanted)
    return cp.Problem(cp.Minimize(cost), rows).solve(solver=cp.CLARABEL)


@pytest.mark.parametrize('orders', problems.ORDERS, ids=str)
def test_hull_optima_are_those_of_another_formulation(orders):
    rng = np.random.default_rng(sum(orders.values()))
    problem = Problem(**orders, horizon=6, step=0.6, forward=1.4, weights=WEIGHTS)
    for _ in range(3):
        start, goals = wanting(rng, problem), problems.goals(rng, problem, distance=1.0)
        plan = Solver(problem, gap_tolerance=1e-7).solve(start, goals)
        assert plan.status == 'optimal', plan.proof.reason
        assert plan.objective == pytest.approx(convex(problem, start, goals), rel=2e-6)
        relaxed = Program(problem).relax(Request(start, goals))
        assert relaxed.bound == pytest.approx(plan.objective, rel=2e-6)


@pytest.mark.parametrize('n', [2, 3])
def test_a_rotation_is_wanted_where_inputs_are_free(n):
    rng = np.random.default_rng(n)
    free = replace(WEIGHTS, input=0.0)
    problem = Problem(n, horizon=5, step=0.6, forward=1.4, weights=free)
    start, goals = wanting(rng, problem), problems.goals(rng, problem, distance=1.0)
    plan = Solver(problem, gap_tolerance=1e-6).solve(start, goals)
    assert plan.objective == pytest.approx(convex(problem, start, goals), rel=1e-5)
    np.testing.assert_allclose(plan.rotations[-1], start.wanted, atol=1e-3)  # s_N does not see it


def test_a_long_hull_is_that_of_another_formulation():
    rng = np.random.default_rng(4)
    problem = Problem(horizon=45, step=0.2, weights=WEIGHTS)
    start, goals = wanting(rng, problem), problems.goals(rng, problem, distance=3.0)
    plan = Solver(problem, gap_tolerance=1e-7).solve(start, goals)
    assert plan.status == 'optimal'
    assert plan.objective == pytest.approx(convex(problem, start, goals), rel=2e-6)


def cheapest(problem, start, goals):
    """The least cost that SLSQP finds over angles and speeds, from starts all around."""
    w, h, steps = problem.weights, problem.step, problem.horizon
    first, least = start.rotation[:, 0], problem.floor.clearance(2)
    ahead = np.arctan2(*start.attitude[::-1, 0])

    def cost(x):
        angles, sizes = x[:steps], x[steps:]
        z = np.vstack([first, sizes[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])])
        pushed = np.cumsum(h * problem.forward * z[:-1], axis=0)
        missed = ((start.position + pushed - goals) ** 2).sum(axis=1)
        turned = 2.0 * w.input * (np.diff(z, axis=0) ** 2).sum() / h**2
        off = 2.0 * w.attitude * ((z[-1] - start.wanted[:, 0]) ** 2).sum()
        return w.position * missed.sum() + w.terminal * missed[-1] + turned + off

    rows = []
    if problem.max_rate:
        most = h * problem.max_rate
        turns = lambda x: np.diff(np.append(ahead, x[:steps]))  # noqa: E731
        rows = [
            {'type': 'ineq', 'fun': lambda x: most - turns(x)},
            {'type': 'ineq', 'fun': lambda x: most + turns(x)},
        ]
    bounds = [(None, None)] * steps + [(least, 1.0)] * steps
    costs = []
    for turn, speed in itertools.product(np.linspace(-0.9, 0.9, 7), (least, 1.0)):
        angles = ahead + turn * (most if problem.max_rate else 1.5) * np.arange(1, steps + 1)
        begin = np.append(angles, np.full(steps, speed))
        end = minimize(cost, begin, bounds=bounds, constraints=rows, method='SLSQP', tol=1e-12)
        held = all(each['fun'](end.x).min() > -1e-8 for each in rows)
        costs += [end.fun] if held else []
    return min(costs)


@pytest.mark.parametrize('rate', [0.0, pytest.param(1.1, marks=needs_machine_code)])
@pytest.mark.parametrize('seed', range(2))
def test_no_local_search_beats_a_floor(seed, rate):
    rng = np.random.default_rng(seed)
    problem = Problem(
        horizon=4, floor=Floor('circle', fraction=0.6), max_rate=rate, weights=WEIGHTS
    )
    start, goals = wanting(rng, problem), problems.goals(rng, problem, distance=1.5)
    start = replace(start, rotation=0.8 * start.attitude)
    plan = Solver(problem, gap_tolerance=1e-6).solve(start, goals)
    assert plan.objective == pytest.approx(cheapest(problem, start, goals), rel=1e-4)
    assert plan.lower_bound <= plan.objective * (1.0 + 1e-9)
    assert not violations(problem, start, goals, plan)


@pytest.mark.parametrize('floor', [Floor(), Floor('polygon', 6, 0.4)])
def test_searches_in_space_agree(floor):
    rng = np.random.default_rng(5)
    box = Box([0.6, -0.5, -0.5], [1.2, 0.5, 0.5])
    problem = Problem(3, horizon=5, step=0.6, weights=WEIGHTS, floor=floor, obstacles=(box,))
    start = replace(State.at(np.zeros(3), np.eye(3)), wanted=problems.rotation(rng, 3))
    goals = np.tile([1.8, 0.1, 0.2], (5, 1))
    plan = Solver(problem, gap_tolerance=1e-6).solve(start, goals)
    found = DisjunctiveSearch(problem, 1e-6).solve(Request(start, goals))
    assert plan.objective == pytest.approx(found.cost, rel=1e-5)


@pytest.mark.parametrize('order', [1, 2])
def test_the_condensed_quadratic_knows_the_weight(order):
    rng = np.random.default_rng(order)
    problem = Problem(rotation_order=order, horizon=5, weights=WEIGHTS)
    start, goals = wanting(rng, problem), problems.goals(rng, problem)
    z = rng.normal(size=(5, 2))
    if order == 2:
        z[0] = start.rotation[:, 0]
    condensed = Condensed(problem)
    q, c = condensed.affine(start, goals)
    cost = 0.5 * np.sum(z * (condensed.hessian @ z)) + np.sum(q * z) + c
    assert cost == pytest.approx(trajectory_of(problem, start, goals, z).cost)


@pytest.mark.parametrize('n', [2, 3])
def test_the_check_adds_it_up_by_itself(n):
    rng = np.random.default_rng(n)
    problem = Problem(n, weights=WEIGHTS)
    start, goals = wanting(rng, problem), problems.goals(rng, problem)
    plan = Solver(problem).solve(start, goals)
    assert not violations(problem, start, goals, plan)
    other = replace(start, wanted=problems.rotation(rng, n))
    assert any('the objective is' in flaw for flaw in violations(problem, other, goals, plan))


@pytest.mark.parametrize('n', [2, 3])
def test_prices_explain_an_optimum(n):
    rng = np.random.default_rng(n)
    problem = Problem(n, horizon=4, step=0.6, weights=WEIGHTS)
    start, goals = wanting(rng, problem), problems.goals(rng, problem, distance=1.0)
    plan = Solver(problem, gap_tolerance=1e-9).solve(start, goals)
    assert explained(problem, start, goals, plan).unexplained < 1e-4


def test_a_weight_without_a_rotation_wanted_is_told():
    problem = Problem(weights=WEIGHTS)
    with pytest.raises(BadInput, match=r'state\.wanted is None; allowed: a rotation'):
        Solver(problem).solve(State.at(np.zeros(2), np.eye(2)), np.zeros((5, 2)))


def test_a_goal_is_met_as_it_is_turned_and_held_without_it():
    problem = Problem(horizon=6, step=0.5, weights=replace(WEIGHTS, position=0.1))
    here = Odometry(0.0, np.zeros(2), np.eye(2), np.array([1.0, 0.0]), np.zeros(1))
    goals, north = np.tile([2.0, 0.5], (6, 1)), np.array([[0.0, -1.0], [1.0, 0.0]])
    controller = Stepped(problem)
    tick = controller.tick(here, goals, wanted=north)
    any_way = Stepped(replace(problem, weights=replace(WEIGHTS, attitude=0.0))).tick(here, goals)
    along = [each.plan.rotations[-1][1, 0] for each in (tick, any_way)]
    assert along[0] > 0.9 > along[1]
    later = replace(here, time=0.5, position=np.array([0.5, 0.0]))
    assert controller.hold(later).status == 'failed'
    fresh = Stepped(problem)
    fresh.continue_from(Stepped(problem))
    assert fresh.hold(later).plan is None


def test_it_has_no_unit_whatever_the_scaling():
    problem = Problem(step=0.1, forward=30.0, weights=WEIGHTS)
    assert weighed(problem, 'time').weights.attitude == WEIGHTS.attitude


def test_files_say_what_is_wanted():
    case = {
        'dimension': 2, 'rotation_order': 1, 'translation_order': 1, 'horizon': 3, 'step': 1.0,
        'forward': 1.0, 'weights': {'terminal': 1.0, 'attitude': 2.0}, 'goal': [2.0, 1.0],
        'state': {'position': [0.0, 0.0], 'rotation': [[1.0, 0.0], [0.0, 1.0]]},
        'goal_attitude': [[0.0, -1.0], [1.0, 0.0]],
    }  # fmt: skip
    known = case_of(case)
    assert known.problem.weights.attitude == 2.0
    np.testing.assert_array_equal(known.state.wanted, case['goal_attitude'])
    for wrong in ([[1.0, 0.0]], [[2.0, 0.0], [0.0, 2.0]], 'north', [['1', '0'], ['0', '1']]):
        with pytest.raises(BadInput, match=r'goal_attitude|state\.wanted'):
            case_of({**case, 'goal_attitude': wrong})
