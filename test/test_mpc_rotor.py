# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A multirotor among boxes: the machine-code search agrees with the general one; needs numba."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.plan import shifted
from orbimpc_ros.mpc.problem import Box, Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.scaling import weighed
from orbimpc_ros.mpc.problem.units import Units
from orbimpc_ros.mpc.solve.disjunctive_bnb import DisjunctiveSearch
from orbimpc_ros.mpc.solve.request import Guess, Request
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.mpc.solve.spatial_bnb import SpatialSearch

pytestmark = pytest.mark.skipif(
    not COMPILED, reason="numba is not installed: pip install 'orbimpc_ros[fast]' runs these"
)
UP = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # the thrust is upward
GOAL = np.array([4.0, 0.5, 0.0])


def problem(boxes, **changes):
    known = {
        'dimension': 3,
        'translation_order': 2,
        'horizon': 6,
        'step': 0.3,
        'forward': 20.0,
        'discretisation': 'exact',
        'no_corner_cutting': True,
        'weights': Weights(1.0, 50.0, 0.0, 10.0),
    }
    return weighed(Problem(obstacles=tuple(boxes), **{**known, **changes}), 'time')


def boxes(rng, count):
    """Boxes about the way from the origin to the goal; neither is inside of one."""
    found = []
    while len(found) < count:
        middle = rng.uniform(0.2, 0.8) * GOAL + rng.uniform(-0.6, 0.6, 3)
        half = rng.uniform(0.2, 0.6, 3)
        box = Box(middle - half, middle + half)
        if box.depth(np.array([np.zeros(3), GOAL])).max() < -0.3:
            found.append(box)
    return found


def hovering(rng, fraction=0.5):
    attitude = exp(0.2 * rng.normal(size=3)) @ UP
    return State.at(
        np.zeros(3),
        fraction * attitude,
        attitude=attitude,
        velocity=0.5 * rng.normal(size=3),
        disturbance=np.array([0.0, 0.0, -9.81]) + 0.3 * rng.normal(size=3),
    )


def both(given, state, goals, tolerance=1e-6):
    """What the machine-code search and the general one find, in natural units."""
    units = Units.of(given)
    assert SpatialSearch.solves(units.problem)
    request = Request(units.state(state), units.lengths(goals))
    fast = SpatialSearch(units.problem, tolerance).solve(request)
    return fast, DisjunctiveSearch(units.problem, tolerance).solve(request)


@pytest.mark.parametrize('seed', range(6))
@pytest.mark.parametrize('cutting', [False, True])
def test_the_optimum_among_boxes_is_that_of_the_general_search(seed, cutting):
    rng = np.random.default_rng([61, seed])
    given = problem(boxes(rng, 2), no_corner_cutting=not cutting)
    fast, general = both(given, hovering(rng), np.tile(GOAL, (6, 1)))
    assert fast.cost == pytest.approx(general.cost, rel=1e-5)
    assert fast.lower_bound <= general.cost * (1.0 + 1e-6)
    assert fast.gap < 1e-5


@pytest.mark.parametrize('orders', list(itertools.product(('euler', 'exact'), (1, 2))))
def test_a_floor_and_both_models_are_known(orders):
    rng = np.random.default_rng([62, orders[1]])
    floor = Floor('polygon', 6, 0.3)
    given = problem(
        boxes(rng, 1), floor=floor, discretisation=orders[0], translation_order=orders[1],
        forward=20.0 if orders[1] == 2 else 3.0, horizon=5,
    )  # fmt: skip
    state = hovering(rng)
    if orders[1] == 1:
        state = State.at(np.zeros(3), state.rotation, attitude=state.attitude)
    fast, general = both(given, state, np.tile(GOAL, (5, 1)), 1e-5)
    assert fast.cost == pytest.approx(general.cost, rel=1e-4)
    assert fast.lower_bound <= general.cost * (1.0 + 1e-6)


@pytest.mark.parametrize('seed', range(8))
def test_long_plans_are_proved_and_pass_the_check(seed):
    rng = np.random.default_rng([63, seed])
    given = problem(boxes(rng, 4), horizon=20, step=0.1)
    state, goals = hovering(rng), np.tile(GOAL, (20, 1))
    plan = Solver(given, gap_tolerance=1e-3).solve(state, goals)
    assert plan.status == 'optimal'
    assert violations(given, state, goals, plan) == []


def test_what_no_thrust_avoids_is_infeasible():
    """Flying into a wall that is too near to stop at, and too wide to fly round."""
    wall = Box(np.array([1.0, -50.0, -50.0]), np.array([30.0, 50.0, 50.0]))
    state = State.at(np.zeros(3), 0.5 * UP, attitude=UP, velocity=np.array([9.0, 0.0, 0.0]))
    units = Units.of(problem([wall]))
    search = SpatialSearch(units.problem, 1e-5)
    goals = units.lengths(np.tile(GOAL, (6, 1)))
    with pytest.raises(Infeasible):
        search.solve(Request(units.state(state), goals, out_of_time=lambda: False))
    slow = replace(state, velocity=np.zeros(3))
    assert search.solve(Request(units.state(slow), goals, out_of_time=lambda: False)).x is not None


@pytest.mark.parametrize(('seed', 'nodes'), [(0, 4), (1, 4), (11, 8)])
def test_a_guess_shows_the_way_to_a_trajectory(seed, nodes):
    """A search that is stopped early has one, on the sides of the guess, and none without."""
    rng = np.random.default_rng([66, seed])
    given = problem(boxes(rng, 8), horizon=20, step=0.1)
    units, state = Units.of(given), hovering(rng)
    search = SpatialSearch(units.problem, 1e-6)
    asked = units.state(state), units.lengths(np.tile(GOAL, (20, 1)))
    whole = search.solve(Request(*asked, out_of_time=lambda: False))
    costs = []
    for guess in (None, Guess(whole.x, whole.cost)):
        looks = itertools.count(1)
        stopped = Request(*asked, guess, lambda looks=looks: next(looks) >= nodes)
        costs.append(search.solve(stopped).cost)
    assert costs[0] == np.inf
    assert costs[1] == pytest.approx(whole.cost, rel=1e-3)


def test_a_search_that_is_stopped_has_a_bound():
    rng = np.random.default_rng(64)
    given = problem(boxes(rng, 6), horizon=20, step=0.1)
    units, state, goals = Units.of(given), hovering(rng), np.tile(GOAL, (20, 1))
    search = SpatialSearch(units.problem, 1e-6)
    asked = units.state(state), units.lengths(goals)
    whole = search.solve(Request(*asked, out_of_time=lambda: False))
    stopped = search.solve(Request(*asked, out_of_time=lambda: True))
    assert stopped.nodes < whole.nodes
    assert 0.0 < stopped.lower_bound <= whole.cost * (1.0 + 1e-6)


def test_flying_on_takes_few_nodes():
    """From tick to tick, through the sides of the plan before, a trajectory is soon found."""
    rng = np.random.default_rng(65)
    given = problem(boxes(rng, 6), horizon=20, step=0.1)
    solver, state, goals = Solver(given, gap_tolerance=1e-3), hovering(rng), np.tile(GOAL, (20, 1))
    plan = solver.solve(state, goals)
    for _ in range(5):
        state = State.at(
            plan.positions[1] + 1e-3 * rng.normal(size=3), plan.rotations[1],
            velocity=plan.velocities[1], disturbance=state.disturbance,
        )  # fmt: skip
        guess = shifted(given, state, goals, plan, projection='thrust_aligned')
        looks = iter(range(100))
        plan = solver.solve(state, goals, guess, lambda looks=looks: next(looks) >= 16)
        assert violations(given, state, goals, plan) == []
        assert plan.gap < 0.05
