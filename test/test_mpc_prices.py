# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Prices of constraints equal the gain from relaxing them, by another solver or by re-solving."""

from dataclasses import replace

import numpy as np
import pytest
from oracles import Stated
from problems import ORDERS, falling, floor, goals, lander, needs_machine_code, state, weights

from orbimpc_ros.mpc.problem import Approach, Ball, Box, MovingObstacle, Problem, State, Weights
from orbimpc_ros.mpc.sensitivity import explained
from orbimpc_ros.mpc.solve.solver import Solver

EPS = 3e-4
# Clarabel's warnings are about accuracies far beyond the tolerances here.
pytestmark = pytest.mark.filterwarnings('ignore:Solution may be inaccurate')
BOX, DISC = Box(np.array([1.2, -0.6]), np.array([2.13, 0.5])), Ball([9.0, 9.0], 1.0)
BRANCHES = {
    'floor': {'floor': floor('polygon')},
    'hexagon': {'floor': floor('polygon', 0.8, 6)},
    'rate': {'max_rate': 0.4},
    'box': {'obstacles': (BOX,)},
    'corners': {'obstacles': (BOX,), 'no_corner_cutting': True},
    'all': {'floor': floor('polygon', 0.4), 'max_rate': 0.9, 'obstacles': (BOX,)},
    'cube': {'dimension': 3, 'floor': floor('polygon', 0.5, 6)},
}


def compared(problem, start, targets):
    """Assert that each price is the gain from relaxing its constraint; zero if not reported."""
    plan = Solver(problem, coasting=start.coasted is not None).solve(start, targets)
    told = explained(problem, start, targets, plan)
    stated = Stated(problem, start, targets)
    stated.taking([each.best(plan) for each in stated.choices])
    assert stated.optimum() == pytest.approx(plan.objective, rel=1e-5, abs=1e-6)
    assert told.unexplained < 1e-3
    prices = {(each.name, each.step): each.price for each in told.binding}
    assert prices.keys() <= stated.ease.keys()
    dearest = max([1.0, *prices.values()])
    for name, step in stated.ease:
        if name == 'thrust' and problem.weights.length:
            continue  # the length term has a kink there
        tighter, easier = (stated.optimum(name, step, by) for by in (-EPS, EPS))
        expected = (tighter - easier) / (2.0 * EPS)
        expected = abs(expected) if name.startswith('terminal') else expected
        assert prices.get((name, step), 0.0) == pytest.approx(expected, abs=2e-3 * dearest)


@pytest.mark.parametrize('name', BRANCHES)
@pytest.mark.parametrize('seed', range(2))
def test_prices_of_limits_are_what_easing_them_gains_step_by_step(name, seed):
    rng = np.random.default_rng(seed)
    problem = Problem(horizon=4, weights=Weights(length=0.1 * seed), **BRANCHES[name])
    n = problem.dimension
    target = np.array([3.0, 0.3, 0.4])[:n] + 0.3 * rng.normal(size=n)
    compared(problem, State.at(np.zeros(n), np.eye(n)), np.tile(target, (4, 1)))


@pytest.mark.parametrize('orders', ORDERS, ids=lambda o: '-'.join(map(str, o.values())))
@pytest.mark.parametrize('terminal', ['penalty', 'constraint'])
def test_prices_of_hull_and_arrival_are_what_easing_them_gains(orders, terminal):
    rng = np.random.default_rng(1)
    drawn = replace(weights(rng), attitude=0.5)
    problem = Problem(horizon=8, terminal=terminal, weights=drawn, **orders)
    start = replace(state(rng, problem), wanted=np.eye(problem.dimension))
    targets = goals(rng, problem)
    if terminal == 'constraint':
        start = replace(start, velocity=np.zeros(problem.dimension))
        targets = start.position + 0.5 * np.ones((8, problem.dimension))
    compared(problem, start, targets)


# --- limits that the oracle does not state: relaxed at all steps at once


def eased(problem, start, name, by):
    """Return a problem and a state with one limit relaxed ``by`` at all steps."""
    by = -by if name in ('floor', 'glide_slope') else by
    if name == 'hazard 0':
        (hazard,) = start.hazards
        smaller = replace(hazard.body, radius=hazard.body.radius - by)
        return problem, replace(start, hazards=(replace(hazard, body=smaller),))
    if name in ('floor', 'approach'):
        part, field = getattr(problem, name), {'floor': 'fraction', 'approach': 'cone'}[name]
        part = replace(part, **{field: getattr(part, field) + by})
        return replace(problem, **{name: part}), start
    return replace(problem, **{name: getattr(problem, name) + by}), start


def at(speed, **more):
    return State.at([0.0, 0.0], speed * np.eye(2), **more)


DESCENT = lander(), falling([9.0, -7.0, 15.0], [1.0, 1.0, -2.0]), [0.0, 0.0, 0.0]
WING = Problem(
    horizon=5, forward=2.0, floor=floor('circle', 0.4), max_rate=0.5, max_acceleration=0.2
)
NORTH = Problem(
    horizon=4, step=0.6, weights=Weights(1.0, 0.5, 0.0, 3.0), approach=Approach(0.3, (0.0, 1.0))
)
ABOVE = replace(NORTH, floor=floor('circle', 0.4))
TURNING, ASIDE = Problem(horizon=4, max_rate=0.4), (at(0.8), [0.5, 2.5], 1e-4)
BESIDE = MovingObstacle.drifting(Ball([2.0, 0.3], 0.6), [-0.1, 0.0])
SUMS = {
    'circle': ('floor', Problem(floor=floor('circle')), at(1.0), [-0.2, 0.3], 1e-5),
    # The hull binds as well, from the other side.
    'constant speed': ('floor', Problem(floor=floor('circle', 1.0)), at(1.0), [-0.2, 0.3], 1e-5),
    'turns': ('max_rate', replace(TURNING, floor=floor('circle', 0.6)), *ASIDE),
    'turns of an octagon': ('max_rate', replace(TURNING, floor=floor('polygon', 0.6, 8)), *ASIDE),
    'speeds': ('max_acceleration', WING, at(0.5), [7.0, 1.5], 1e-4),
    'tilt': ('tilt', *DESCENT, 1e-4),
    'slope': ('glide_slope', *DESCENT, 1e-4),
    'approach': ('approach', NORTH, at(0.9), [2.0, -0.3], 1e-3),
    'slowest approach': ('approach', NORTH, at(0.9), [-1.0, -1.0], 1e-3),
    'approach and floor': ('floor', ABOVE, at(0.9), [-1.0, -1.0], 1e-3),
    'hazard': ('hazard 0', Problem(horizon=4), at(0.5, hazards=(BESIDE,)), [5.0, 0.0], 5e-3),
}


@needs_machine_code
@pytest.mark.parametrize('kind', SUMS)
def test_prices_of_a_limit_add_up_to_what_easing_it_gains(kind):
    name, problem, start, target, eps = SUMS[kind]
    targets = np.tile(target, (problem.horizon, 1))
    gap = 1e-4 if name == 'hazard 0' else 1e-8

    def best(by):
        known, begin = eased(problem, start, name, by)
        return Solver(known, gap_tolerance=gap).solve(begin, targets)

    told = explained(problem, start, targets, best(0.0))
    price = sum(each.price for each in told.binding if each.name == name)
    low = 0.0 if kind == 'constant speed' else -eps  # no floor is above 1
    saved = (best(low).objective - best(eps).objective) / (eps - low)
    assert price > 0.03
    assert price == pytest.approx(saved, rel=0.15 if name == 'hazard 0' else 1e-2)


# --- explanations


@pytest.mark.parametrize('off', [0.0, 1e-12])
def test_nothing_binds_at_rest_on_the_goal(off):
    problem, start = Problem(), State.at([0.0, 0.0], np.zeros((2, 2)))
    targets = np.full((5, 2), off)
    told = explained(problem, start, targets, Solver(problem).solve(start, targets))
    assert told.binding == ()
    assert told.unexplained < 1e-3


def test_a_box_is_named_by_its_place_among_all_obstacles():
    problem, targets = Problem(horizon=4, obstacles=(DISC, BOX)), np.tile([3.0, 0.3], (4, 1))
    told = explained(problem, at(1.0), targets, Solver(problem).solve(at(1.0), targets))
    assert [each.name for each in told.binding] == ['hull', 'obstacle 1']


def test_a_plan_that_could_be_better_is_not_explained():
    problem, start = Problem(), at(1.0)
    near, far = np.tile([0.5, 0.5], (5, 1)), np.tile([-3.0, 1.0], (5, 1))
    plan = Solver(problem).solve(start, near)
    assert explained(problem, start, near, plan).unexplained < 1e-3
    assert explained(problem, start, far, plan).unexplained > 0.1
