# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The convex program over SO(3) in machine code agrees with the general one; needs numba."""

from dataclasses import replace

import numpy as np
import pytest
from problems import weights

from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.orbitopes import margin, matrix
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Box, Floor, Problem, State, Weights
from orbimpc_ros.mpc.solve.disjunction import disjunctions_of
from orbimpc_ros.mpc.solve.program import Program
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.so3_multipliers import SO3Multipliers

pytestmark = pytest.mark.skipif(
    not COMPILED, reason="numba is not installed: pip install 'orbimpc_ros[fast]' runs these"
)
ORDERS = [(1, 1), (1, 2), (2, 1), (2, 2)]


def both(problem, coasting=False):
    slots = [slot for d in disjunctions_of(problem) for slot in d.slots]
    assert SO3Multipliers.solves(problem, slots)
    return (
        SO3Multipliers(problem, slots, coasting=coasting),
        Program(problem, slots, coasting=coasting),
    )


def random_state(rng, coasting):
    attitude = exp(rng.normal(size=3))
    rate = exp(0.3 * rng.normal(size=3))
    return State.at(
        rng.normal(size=3),
        rng.uniform(0.0, 1.0) * attitude,
        velocity=0.3 * rng.normal(size=3),
        rotation_rate=0.1 * rng.normal(size=(3, 3)) * (not coasting),
        attitude=attitude,
        coasted=attitude @ rate if coasting else None,
    )


def compare(fast, general, state, goals, halfspaces=()):
    """Assert that both find the optimum, and that the bound is one."""
    at = Request(state, goals)
    ours, theirs = fast.relax(at, halfspaces), general.relax(at, halfspaces)
    cost = trajectory_of(fast.problem, state, goals, ours.x).cost
    assert ours.bound == pytest.approx(theirs.bound, rel=1e-6, abs=1e-7)
    assert cost == pytest.approx(ours.bound, rel=1e-7, abs=1e-8)
    assert margin(matrix(ours.x[fast.problem.rotation_order - 1 :])).min() > -1e-7
    return ours


@pytest.mark.parametrize('coasting', [False, True])
@pytest.mark.parametrize('orders', ORDERS)
@pytest.mark.parametrize('seed', range(6))
def test_it_finds_what_the_general_program_finds(seed, orders, coasting):
    rng = np.random.default_rng(seed)
    problem = Problem(
        dimension=3,
        rotation_order=orders[0],
        translation_order=orders[1],
        horizon=int(rng.integers(4, 9)),
        step=float(rng.uniform(0.3, 1.0)),
        weights=weights(rng),
        floor=Floor('none'),
    )
    fast, general = both(problem, coasting)
    for _ in range(4):  # each from the multipliers of the one before
        goals = rng.normal(size=(problem.horizon, 3)) * 10.0 ** rng.uniform(-1.0, 2.0)
        compare(fast, general, random_state(rng, coasting), goals)
    assert fast._general is None


@pytest.mark.parametrize('coasting', [False, True])
@pytest.mark.parametrize('seed', range(3))
def test_an_arrival_is_met_at_rest(monkeypatch, seed, coasting):
    rng = np.random.default_rng(seed)
    problem = Problem(
        dimension=3,
        rotation_order=2,
        translation_order=2,
        horizon=14,
        weights=Weights(0.0, 1.0, 0.1, 0.0),
        terminal='constraint',
        floor=Floor('none'),
    )
    fast, general = both(problem, coasting)
    start = State.at(np.zeros(3), np.eye(3), coasted=np.eye(3) if coasting else None)
    goals = np.tile(rng.normal(size=3) * 4.0, (14, 1))
    monkeypatch.setattr(fast, '_leave', None)  # machine code alone finds it
    found = compare(fast, general, start, goals)
    flown = trajectory_of(problem, start, goals, found.x)
    assert np.abs(flown.positions[-1] - goals[-1]).max() < 1e-9
    assert np.abs(flown.velocities[-1]).max() < 1e-9


@pytest.mark.parametrize('orders', ORDERS)
@pytest.mark.parametrize('seed', range(3))
def test_half_spaces_hold_and_are_let_go(seed, orders):
    rng = np.random.default_rng(seed)
    problem = Problem(
        dimension=3,
        rotation_order=orders[0],
        translation_order=orders[1],
        horizon=5,
        floor=Floor('polygon', 6, 0.4),
    )
    coasting = orders[0] == 2
    fast, general = both(problem, coasting)
    state, goals = random_state(rng, coasting), 0.3 * rng.normal(size=(5, 3))
    free = compare(fast, general, state, goals)
    sides = np.sign(free.x[:, :3])
    imposed = [(k, -sides[k, k % 3] * np.eye(3)[k % 3], 0.4) for k in range(2, 5)]
    held = compare(fast, general, state, goals, imposed)
    assert all(normal @ held.x[k, :3] > offset - 1e-7 for k, normal, offset in imposed)
    assert held.bound > free.bound
    again = compare(fast, general, state, goals)
    assert again.bound == pytest.approx(free.bound, rel=1e-8)


def test_a_half_space_on_a_given_rotation_is_refuted_at_once():
    problem = Problem(dimension=3, rotation_order=2, horizon=5, floor=Floor('polygon', 6, 0.4))
    fast, _ = both(problem)
    at = Request(State.at(np.zeros(3), np.eye(3)), np.ones((5, 3)))
    with pytest.raises(Infeasible, match='R_1'):
        fast.relax(at, [(0, np.array([-1.0, 0.0, 0.0]), 0.4)])
    fast.relax(at, [(0, np.array([1.0, 0.0, 0.0]), 0.4)])


def test_a_half_space_on_a_coasting_rotation_bounds_its_thrust():
    problem = Problem(dimension=3, rotation_order=2, horizon=5, floor=Floor('polygon', 6, 0.4))
    fast, general = both(problem, coasting=True)
    start = State.at(np.zeros(3), 0.1 * np.eye(3), coasted=np.eye(3), attitude=np.eye(3))
    goals = np.tile([-3.0, 0.0, 0.0], (5, 1))
    free = compare(fast, general, start, goals)
    held = compare(fast, general, start, goals, [(0, np.array([1.0, 0.0, 0.0]), 0.4)])
    assert free.x[0, 0] < 0.3
    assert held.x[0, 0] == pytest.approx(0.4, abs=1e-7)


def test_what_has_no_solution_is_proved_so_by_the_general_program():
    problem = Problem(dimension=3, horizon=5, terminal='constraint', floor=Floor('none'))
    fast, fresh = both(problem)[0], both(problem)[0]
    start, near = State.at(np.zeros(3), np.eye(3)), np.full((5, 3), 1.0)
    at = Request(start, np.full((5, 3), 100.0))
    with pytest.raises(Infeasible):
        fast.relax(at)
    at = Request(start, near)
    assert fast.relax(at).bound == pytest.approx(fresh.relax(at).bound, rel=1e-8)


def test_a_solve_with_a_deadline_does_not_wait_for_the_general_program_to_be_built(monkeypatch):
    rng = np.random.default_rng(4)
    fast, general = both(Problem(dimension=3, horizon=6, floor=Floor('none')))
    start, goals = random_state(rng, False), rng.normal(size=(6, 3))
    at = Request(start, goals)
    monkeypatch.setattr(
        'orbimpc_ros.mpc.solve.so3_multipliers.GAP', -1.0
    )  # of two numbers never so small
    hurried = fast.relax(at._replace(out_of_time=lambda: False))
    assert fast._general is None
    assert margin(matrix(hurried.x)).min() >= -1e-12
    cost, optimum = (
        trajectory_of(fast.problem, start, goals, hurried.x).cost,
        general.relax(at).bound,
    )
    assert -np.inf < hurried.bound <= optimum * (1 + 1e-7) <= cost * (1 + 2e-7)
    assert fast.relax(at).bound == pytest.approx(optimum, rel=1e-8)
    assert fast._general is not None


@pytest.mark.parametrize(
    'change', [{'terminal': 'constraint'}, {'horizon': 20}, {'floor': Floor('polygon', 6, 0.4)}]
)
def test_the_general_program_is_there_from_the_start_where_ticks_may_need_it(change):
    problem = replace(Problem(dimension=3, rotation_order=2, floor=Floor('none')), **change)
    assert both(problem, coasting=True)[0]._general is not None


def test_goals_out_of_all_proportion_are_no_trouble():
    problem = Problem(dimension=3, horizon=6, floor=Floor('none'))
    fast, general = both(problem)
    for distance in (0.0, 1e-3, 1e3, 1e6):
        goals = np.tile(distance * np.array([0.6, -0.64, 0.48]), (6, 1))
        compare(fast, general, State.at(np.zeros(3), np.eye(3)), goals)


@pytest.mark.parametrize(
    'change',
    [
        {'dimension': 2},
        {'max_rate': 0.5},
        {'weights': Weights(input=0.0)},
        {'arrival_weight': 1.0},
        {'horizon': 60},
        {'horizon': 1},
    ],
)
def test_it_leaves_alone_what_it_cannot_do(change):
    problem = Problem(dimension=3, floor=Floor('none'))
    assert SO3Multipliers.solves(problem)
    assert not SO3Multipliers.solves(replace(problem, **change))


def test_obstacles_are_left_to_the_general_program():
    box = Box(np.zeros(3), np.ones(3))
    problem = Problem(dimension=3, floor=Floor('none'), obstacles=(box,))
    slots = [slot for d in disjunctions_of(problem) for slot in d.slots]
    assert not SO3Multipliers.solves(problem, slots)


def test_an_interrupted_solve_keeps_its_bound_and_stays_in_the_orbitopes(monkeypatch):
    problem = Problem(dimension=3, horizon=12, floor=Floor('none'))
    fast, general = both(problem)
    state, goals = random_state(np.random.default_rng(3), False), np.full((12, 3), 5.0)
    at = Request(state, goals)
    optimum = general.relax(at).bound
    monkeypatch.setattr('orbimpc_ros.mpc.solve.so3_multipliers.SLICE', 1.0)  # a Newton step
    for steps in range(4):
        left = iter(range(steps))
        early = fast.relax(at._replace(out_of_time=lambda left=left: next(left, None) is None))
        assert early.bound <= optimum * (1 + 1e-7)
        assert margin(matrix(early.x)).min() >= -1e-12
        assert trajectory_of(problem, state, goals, early.x).cost >= optimum * (1 - 1e-7)
    polled = iter(range(1000))
    assert fast.relax(at._replace(out_of_time=lambda: next(polled) < 0)).bound == pytest.approx(
        optimum, rel=1e-7
    )
