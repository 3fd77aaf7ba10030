# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Plans that turn stand in where a search has no time to find any."""

import numpy as np
import pytest
from problems import ORDERS, floor, rotation

from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.model.dynamics import translation_rollout
from orbimpc_ros.mpc.problem import Box, Problem, State
from orbimpc_ros.mpc.solve.solver import Solver


def at_once(problem, start, targets):
    """The plan that comes when there was no time for anything."""
    solver = Solver(problem, coasting=start.coasted is not None)
    return solver.solve(start, targets, out_of_time=lambda: True)


def bending(rng, problem, begin):
    """R_0..R_N that turn by up to 0.2 rad a step, about an axis that drifts."""
    n, turned = problem.dimension, [begin]
    axis = rng.normal(size=1 if n == 2 else 3)
    while len(turned) <= problem.horizon:
        axis = axis + 0.3 * rng.normal(size=axis.shape)
        turned.append(turned[-1] @ exp(0.2 * rng.random() * axis / np.linalg.norm(axis)))
    return np.array(turned)


def arrival(orders, shape):
    """A problem of 12 steps, a start and goals, that a trajectory between the limits solves."""
    n = orders['dimension']
    rng = np.random.default_rng(n)
    problem = Problem(**orders, horizon=12, terminal='constraint', floor=shape)
    turned = bending(rng, problem, rotation(rng, n))
    flown = 0.5 * (1.0 + shape.least(np.eye(n)[0])) * turned
    still = State.at(np.zeros(n), flown[0])
    gained = translation_rollout(problem, still, flown[:, :, 0])[1][-1]
    start = State.at(
        np.zeros(n),
        flown[0],
        velocity=-gained if problem.translation_order == 2 else None,
        coasted=turned[1] if problem.rotation_order == 2 else None,
    )
    reached = translation_rollout(problem, start, flown[:, :, 0])[0][-1]
    return problem, start, np.tile(reached, (12, 1))


@pytest.mark.parametrize('fraction', [0.5, 1.0])
@pytest.mark.parametrize('orders', ORDERS)
def test_an_arrival_is_met_without_a_search(orders, fraction):
    problem, start, targets = arrival(orders, floor('circle', fraction))
    plan = at_once(problem, start, targets)
    assert violations(problem, start, targets, plan) == []


@pytest.mark.parametrize('orders', [each for each in ORDERS if each['dimension'] == 3])
@pytest.mark.skipif(not COMPILED, reason='interrupted Clarabel proves nothing; needs numba')
def test_a_search_that_was_interrupted_leaves_its_bound(orders):
    problem, start, targets = arrival(orders, floor('none'))
    plan = at_once(problem, start, targets)
    assert plan.lower_bound == (plan.proof.lower_bound if plan.proof.checked else 0.0)
    assert 0.0 < plan.proof.lower_bound <= plan.objective * (1.0 + 1e-6)


@pytest.mark.parametrize('rate', [0.0, 0.5])
@pytest.mark.parametrize('n', [2, 3])
def test_a_box_ahead_is_passed_without_a_search(n, rate):
    low, high = np.full(n, -6.0), np.full(n, 6.0)
    low[0], high[0] = 10.0, 14.0
    problem = Problem(
        n,
        horizon=30,
        floor=floor('circle', 0.9),
        max_rate=rate,
        obstacles=(Box(low, high),),
    )
    start, targets = State.at(np.zeros(n), np.eye(n)), np.zeros((30, n))
    targets[:, 0] = 25.0
    plan = at_once(problem, start, targets)
    assert violations(problem, start, targets, plan) == []
    assert plan.positions[:, 0].max() > 0.0


@pytest.mark.parametrize('n', [2, 3])
def test_an_arrival_at_the_end_of_its_reach_is_met_without_a_search(n):
    """All but the first thrust is full: what the disks leave is a single point."""
    turned = bending(np.random.default_rng(n), Problem(n, horizon=3), np.eye(n))
    problem = Problem(n, rotation_order=2, horizon=3, terminal='constraint')
    start = State.at(np.zeros(n), turned[0], coasted=turned[1])
    reached = translation_rollout(problem, start, turned[:, :, 0])[0][-1]
    targets = np.tile(reached, (3, 1))
    plan = at_once(problem, start, targets)
    assert violations(problem, start, targets, plan) == []


def test_what_did_not_come_of_the_search_says_so():
    problem = Problem(3, horizon=8, floor=floor('circle', 0.9), obstacles=(Box([5] * 3, [6] * 3),))
    start, targets = State.at(np.zeros(3), np.eye(3)), np.tile([9.0, 2.0, 0.0], (8, 1))
    solver = Solver(problem)
    instead = solver.solve(start, targets, out_of_time=lambda: True)
    assert instead.proof.reason.endswith('a plan that took no search stands in')
    again = solver.solve(start, targets, instead, out_of_time=lambda: True)
    assert again.objective == instead.objective
    assert again.proof.reason == 'the plan before goes on: no better one was found in time'
