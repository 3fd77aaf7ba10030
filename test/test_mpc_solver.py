# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The solver beside its methods: what stands in for a plan that was not found, and says so."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from problems import ORDERS, floor, goals, rotation, state

from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.model.dynamics import translation_rollout
from orbimpc_ros.mpc.problem import Box, Problem, State, Weights
from orbimpc_ros.mpc.solve.solver import Solver


def at_once(problem, start, targets):
    """The plan that comes when there was no time for anything."""
    solver = Solver(problem, coasting=start.coasted is not None)
    return solver.solve(start, targets, out_of_time=lambda: True)


@pytest.mark.parametrize('orders', ORDERS)
@pytest.mark.parametrize('shape', ['none', 'polygon', 'circle'])
def test_where_the_rotation_can_be_held_there_is_a_plan_at_once(orders, shape):
    faces = 4 if orders['dimension'] == 2 else 6
    rng = np.random.default_rng(13)
    for horizon, length in itertools.product((1, 3, 12), (0.0, 0.3)):
        problem = Problem(
            **orders,
            horizon=horizon,
            weights=Weights(length=length),
            floor=floor(shape, 0.5, faces),
            # Without a floor the limit is on what a coasting body does in its first step, too.
            max_rate=0.0 if orders['rotation_order'] == 2 else rng.choice([0.0, 0.5]),
        )
        start, targets = state(rng, problem, full_speed=False), goals(rng, problem)
        plan = at_once(problem, start, targets)
        assert violations(problem, start, targets, plan) == []
        assert 0.0 <= plan.lower_bound <= plan.objective * (1.0 + 1e-6)


def bending(rng, problem, begin):
    """R_0..R_N that turn by up to 0.2 rad a step, about an axis that drifts."""
    n, turned = problem.dimension, [begin]
    axis = rng.normal(size=1 if n == 2 else 3)
    while len(turned) <= problem.horizon:
        axis = axis + 0.3 * rng.normal(size=axis.shape)
        turned.append(turned[-1] @ exp(0.2 * rng.random() * axis / np.linalg.norm(axis)))
    return np.array(turned)


@pytest.mark.parametrize('fraction', [0.5, 1.0])
@pytest.mark.parametrize('orders', ORDERS)
def test_an_arrival_is_met_without_a_search(orders, fraction):
    n, shape = orders['dimension'], floor('circle', fraction)
    rng = np.random.default_rng(n)
    problem = Problem(**orders, horizon=12, terminal='constraint', floor=shape)
    turned = bending(rng, problem, rotation(rng, n))
    flown = 0.5 * (1.0 + fraction) * turned
    still = State.at(np.zeros(n), flown[0])
    gained = translation_rollout(problem, still, flown[:, :, 0])[1][-1]
    start = State.at(
        np.zeros(n),
        flown[0],
        velocity=-gained if problem.translation_order == 2 else None,
        coasted=turned[1] if problem.rotation_order == 2 else None,
    )
    targets = np.tile(translation_rollout(problem, start, flown[:, :, 0])[0][-1], (12, 1))
    assert violations(problem, start, targets, at_once(problem, start, targets)) == []


@pytest.mark.parametrize('rate', [0.0, 0.5])
@pytest.mark.parametrize('n', [2, 3])
def test_a_box_ahead_is_passed_without_a_search(n, rate):
    low, high = np.full(n, -6.0), np.full(n, 6.0)
    low[0], high[0] = 10.0, 14.0
    fast, box = floor('circle', 0.9), Box(low, high)
    problem = Problem(n, horizon=30, floor=fast, max_rate=rate, obstacles=(box,))
    start, targets = State.at(np.zeros(n), np.eye(n)), np.zeros((30, n))
    targets[:, 0] = 25.0
    plan = at_once(problem, start, targets)
    assert violations(problem, start, targets, plan) == []
    assert plan.positions[:, 0].max() > 0.0


def test_what_did_not_come_of_the_search_says_so():
    box = Box([4.4, 0.5, -0.5], [5.6, 1.7, 0.5])
    problem = Problem(3, horizon=8, floor=floor('circle', 0.9), obstacles=(box,))
    start, targets = State.at(np.zeros(3), np.eye(3)), np.tile([9.0, 2.0, 0.0], (8, 1))
    solver = Solver(problem)
    instead = solver.solve(start, targets, out_of_time=lambda: True)
    assert instead.proof.reason.endswith('a plan that took no search stands in')
    again = solver.solve(start, targets, instead, out_of_time=lambda: True)
    assert again.objective == instead.objective
    assert again.proof.reason == 'the plan before goes on: no better one was found in time'


def test_holding_the_rotation_stands_in_for_a_method_that_fails(monkeypatch):
    """Any failure of the method: the plan then says so, and claims no proof."""
    problem = Problem(floor=floor('circle', 0.5))
    solver = Solver(problem)
    start = State.at([0.0, 0.0], 0.2 * np.eye(2), attitude=np.eye(2))
    targets = np.tile([4.0, 1.0], (5, 1))
    truly = solver.solve(start, targets)

    def beaten(found, share):
        much = share * found.cost
        return replace(found, lower_bound=much, cost=much, proof=None)

    solve = solver._method.solve
    broken = {
        'fails its check': lambda *a: replace(solve(*a), x=1.1 * solve(*a).x),
        'the trajectory found is not finite': lambda *a: replace(solve(*a), x=np.nan * solve(*a).x),
        'no trajectory': lambda *a: replace(solve(*a), x=None, cost=np.inf, lower_bound=np.inf),
    }
    for said, method in broken.items():
        monkeypatch.setattr(solver._method, 'solve', method)
        plan = solver.solve(start, targets)
        assert plan.status == 'feasible'
        assert said in plan.proof.reason
        assert plan.lower_bound <= truly.objective <= plan.objective
    for share in (10.0, 0.16):  # a cost that is none, with a bound to match
        monkeypatch.setattr(solver._method, 'solve', lambda *a, s=share: beaten(solve(*a), s))
        plan = solver.solve(start, targets)
        assert plan.status == 'feasible'
        assert plan.lower_bound <= truly.objective <= plan.objective * (1.0 + 1e-9)


@pytest.mark.parametrize('n', [2, 3])
def test_a_state_lacks_nothing_that_the_problem_depends_on(n):
    start, targets = State.at(np.zeros(n), np.eye(n)), np.zeros((3, n))
    solver = Solver(Problem(n, rotation_order=2, horizon=3), coasting=True)
    with pytest.raises(BadInput, match=r'state\.coasted'):
        solver.solve(start, targets)
    with pytest.raises(BadInput, match=r'state\.wanted is None; allowed: a rotation'):
        Solver(Problem(n, horizon=3, weights=Weights(attitude=1.0))).solve(start, targets)
