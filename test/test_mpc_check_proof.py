# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The check before publishing: the objective and its lower bound."""

import math
from dataclasses import replace

import numpy as np
import pytest
from plans import assembled, only_complaint, solved
from problems import ORDERS, rotation, state
from problems import goals as goals_of

from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.plan import UNPROVED
from orbimpc_ros.mpc.problem import Problem, Weights


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
    claimed = replace(plan, proof=replace(plan.proof, lower_bound=bound))
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
        assert replace(plan, proof=replace(plan.proof, lower_bound=bound)).status == status
    assert replace(plan, objective=np.inf).status == 'feasible'
    assert replace(plan, proof=UNPROVED).status == 'feasible'


@pytest.mark.parametrize(('units', 'status'), [(1e8, 'feasible'), (1e10, 'optimal')])
def test_a_gap_far_below_the_unit_of_costs_is_none(units, status):
    plan = solved(Problem())
    unit = units * plan.objective
    proof = replace(plan.proof, lower_bound=0.0, cost_unit=unit)
    assert replace(plan, proof=proof).status == status


def judged(problem, goals, plan):
    """The objective as the problem states it, number by number."""
    w, h, z = problem.weights, problem.step, problem.forward
    cost, last = 0.0, problem.horizon
    for k in range(1, last + 1):
        miss = sum((a - b) ** 2 for a, b in zip(plan.positions[k], goals[k - 1], strict=True))
        cost += w.position * miss
        if k == last:
            cost += (w.terminal + problem.arrival_weight) * miss
    for k in range(last):
        cost += w.input * sum(u**2 for row in plan.inputs[k] for u in row)
        cost += w.length * h * z * math.hypot(*plan.rotations[k, :, 0])
    if problem.translation_order == 2:
        cost += problem.arrival_weight * h * h * sum(v**2 for v in plan.velocities[last])
    return cost


@pytest.mark.parametrize('orders', ORDERS)
@pytest.mark.parametrize('arrival', [0.0, 0.5, 3.0])
def test_every_term_of_the_objective_is_summed(orders, arrival):
    rng = np.random.default_rng(int(10 * arrival) + orders['dimension'])
    for length in (0.0, 0.7):
        problem = Problem(
            **orders,
            horizon=4,
            step=0.7,
            forward=3.0,
            weights=Weights(0.9, 0.4, length, 2.0),
            arrival_weight=arrival,
        )
        start, places = state(rng, problem), goals_of(rng, problem)
        n = problem.dimension
        squeezed = np.diag([1.0, 0.5, 0.5][:n])  # so that the first column is not as long as others
        points = [rng.uniform(0.1, 0.9) * rotation(rng, n) @ squeezed for _ in range(4)]
        if start.coasted is not None:
            points[0] = 0.8 * start.coasted
        plan = assembled(problem, start, places, coordinates(np.array(points)))
        told = replace(plan, objective=judged(problem, places, plan))
        assert violations(problem, start, places, told) == []
        for factor in (1.0 - 1e-8, 1.0 + 1e-8):
            off = replace(plan, objective=factor * told.objective)
            assert only_complaint(problem, off, start, places).startswith('the objective is ')


def test_an_overflow_excuses_nothing():
    plan = solved(Problem())
    endless = Problem(weights=Weights(position=1e308))
    with np.errstate(over='ignore'):
        assert only_complaint(endless, plan).startswith('the objective is inf, not ')
    unit = replace(
        plan, proof=replace(plan.proof, lower_bound=2.0 * plan.objective, cost_unit=np.inf)
    )
    assert only_complaint(Problem(), unit).startswith('the lower bound exceeds the cost')
