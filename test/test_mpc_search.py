# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Branch and bound: against exhaustive enumeration, its child bounds, and its honesty."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from problems import box, floor, goals, reference, state, weights

from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.cells import round_cells
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Box, Problem, State, Weights
from orbimpc_ros.mpc.solve import conic, program
from orbimpc_ros.mpc.solve.branching import (
    inverse_curvatures,
    inverse_hessian,
    steps_are_exchangeable,
)
from orbimpc_ros.mpc.solve.disjunction import disjunctions_of, shortfall
from orbimpc_ros.mpc.solve.disjunctive_bnb import HALFWAY, DisjunctiveSearch
from orbimpc_ros.mpc.solve.program import Program
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Solver


def enumerated(problem, start, targets):
    """The least bound over every combination of cells: the optimum of the mixed-integer problem."""
    disjunctions = disjunctions_of(problem)
    program = Program(problem, [slot for d in disjunctions for slot in d.slots])
    at = Request(start, targets)
    best = np.inf
    for choice in itertools.product(*(d.cells for d in disjunctions)):
        rows = [
            (cell, slot) for d, cell in zip(disjunctions, choice, strict=True) for slot in d.slots
        ]
        halfspaces = [(i, cell.normal, cell.offset) for i, (cell, _) in enumerate(rows)]
        try:
            best = min(best, program.relax(at, halfspaces).bound)
        except Infeasible:
            continue
    return best


def flat_problems():
    """Seed, dimension, floor, boxes, whether consecutive points share a face."""
    for seed in range(6):
        yield seed, 2, floor('polygon', 0.5, 4), 0, False
        yield seed, 2, floor('polygon', 0.4, 3), 0, False
        yield seed, 2, floor('none'), 1, False
        yield seed, 2, floor('none'), 1, True
    for seed in range(3):
        yield seed, 2, floor('polygon', 0.6, 4), 1, False
        yield seed, 3, floor('polygon', 0.5, 6), 0, False
        yield seed, 3, floor('none'), 1, True


@pytest.mark.parametrize(('seed', 'n', 'shape', 'boxes', 'sharing'), list(flat_problems()))
def test_finds_what_enumeration_finds(seed, n, shape, boxes, sharing):
    rng = np.random.default_rng(seed)
    horizon = 3 if shape.shape == 'none' or n == 2 else 2
    horizon = 2 if boxes and shape.shape != 'none' else horizon
    problem = Problem(n, horizon=horizon, floor=shape, weights=weights(rng))
    start = state(rng, problem)
    middle = start.position + start.rotation[:, 0] * 1.9
    obstacles = tuple(box(rng, n, middle) for _ in range(boxes))
    problem = replace(problem, obstacles=obstacles, no_corner_cutting=sharing)
    targets = np.tile(middle + 0.3 * rng.normal(size=n), (horizon, 1))
    expected = enumerated(problem, start, targets)
    if expected == np.inf:
        with pytest.raises(Infeasible):
            Solver(problem).solve(start, targets)
        return
    plan = Solver(problem).solve(start, targets)
    assert plan.status == 'optimal'
    assert plan.objective == pytest.approx(expected, rel=1e-5, abs=1e-6)
    found = DisjunctiveSearch(problem, 1e-6).solve(Request(start, targets))
    assert found.cost == pytest.approx(expected, rel=1e-5, abs=1e-6)
    assert found.lower_bound <= expected + 1e-6 * max(1.0, expected)
    assert plan.lower_bound <= expected + 1e-6 * max(1.0, expected)
    assert violations(problem, start, targets, plan) == []


# Seed, and what costs are in proportion to their curvature: where that is little, the relaxation's
# bound is that of another solve than its solution.
SHARES = [*((seed, 1.0) for seed in range(8)), (8, 1e-12), (20, 1e-11), (20, 1e-12)]


@pytest.mark.parametrize(('seed', 'share'), SHARES)
def test_inherited_bounds_never_exceed_what_the_child_costs(seed, share):
    rng = np.random.default_rng(seed)
    w = weights(rng)
    w = Weights(share * w.position, w.input, 0.0, share * w.terminal)
    problem = Problem(2 + seed % 2, horizon=4, floor=floor('polygon', 0.5, 6), weights=w)
    start = state(rng, problem)
    targets = np.tile(start.position + 0.5 * rng.normal(size=problem.dimension), (4, 1))
    disjunctions = disjunctions_of(problem)
    program = Program(problem, [slot for d in disjunctions for slot in d.slots])
    at = Request(start, targets)
    parent = program.relax(at)
    flown = trajectory_of(problem, start, targets, parent.x)
    raised = 0
    for j, disjunction in enumerate(disjunctions):
        values = disjunction.values(flown.headings, flown.positions)
        curvature = inverse_curvatures(
            problem, [disjunction], inverse_hessian(Condensed(problem).hessian)
        )[0]
        short = np.maximum(shortfall(disjunction.cells, values), 0.0)
        gains = (short**2 / (2 * curvature)).max(axis=1)
        for cell, gain in zip(disjunction.cells, gains, strict=True):
            try:
                child = program.relax(at, [(j, cell.normal, cell.offset)])
            except Infeasible:
                continue
            raised += gain > 1e-3 * parent.bound
            spent = trajectory_of(problem, start, targets, child.x).cost
            assert parent.dual_value + gain <= spent * (1 + 1e-6) + 1e-7 * share
    assert raised > 0


def allowed(cell, headings, depth):
    """Which headings, shape (K, n), a cell allows that is cut so many times more."""
    if not depth:
        return headings @ cell.normal >= cell.offset - 1e-12
    return np.any([allowed(part, headings, depth - 1) for part in cell.parts()], axis=0)


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('depth', range(3))
def test_the_cells_of_a_round_floor_miss_none_of_it(n, depth):
    headings = np.random.default_rng(depth).normal(size=(2000, n))
    headings *= 0.6 / np.linalg.norm(headings, axis=1, keepdims=True)
    cells = round_cells(n, 0.6)
    assert np.any([allowed(cell, headings, depth) for cell in cells], axis=0).all()


@pytest.mark.parametrize('n', [2, 3])
def test_cells_are_cut_until_rounding_is_larger(n):
    cell, cuts = round_cells(n, 0.6)[0], 0
    while cell.parts():
        cell, cuts = cell.parts()[-1], cuts + 1
    assert 0.6 * (1.0 - 1e-12) < cell.offset <= 0.6
    assert 15 < cuts < 30


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('rate', [0.0, 2.5])
def test_a_round_floor_is_bounded_by_its_polygons(n, seed, rate):
    rng = np.random.default_rng(seed)
    problem = Problem(n, horizon=3, floor=floor('circle', 0.5), max_rate=rate)
    start = state(rng, problem)
    targets = np.tile(start.position + 0.4 * rng.normal(size=n), (3, 1))
    found = DisjunctiveSearch(problem, 1e-3).solve(Request(start, targets))
    faces = 12 if n == 2 else 20
    flat = replace(problem, floor=floor('polygon', 0.5, faces))
    inside = DisjunctiveSearch(flat, 1e-5).solve(Request(start, targets))
    free = replace(problem, floor=floor('none'))
    hull = DisjunctiveSearch(free, 1e-5).solve(Request(start, targets))
    assert hull.lower_bound - 1e-6 <= found.lower_bound <= found.cost
    assert found.lower_bound <= inside.cost
    if not rate:  # with one, the relaxation knows an angle as a chord, and leaves a gap
        gap = 1e-3 * (HALFWAY if n == 3 else 1.0)
        assert found.cost <= inside.cost * (1.0 + gap)
        assert found.cost - found.lower_bound <= 1.001 * gap * found.cost


def test_running_out_of_time_returns_the_best_so_far_with_an_honest_gap():
    problem, start, targets = reference('dubins_square')
    optimum = Solver(problem).solve(start, targets)
    polls = itertools.count()
    plan = Solver(problem).solve(start, targets, out_of_time=lambda: next(polls) > 400)
    assert plan.status == 'feasible'
    assert plan.gap > 1e-4
    assert plan.lower_bound <= optimum.objective <= plan.objective


def test_a_start_in_a_box_that_cannot_be_left_in_a_step_is_infeasible():
    big = Box(np.array([-5.0, -5.0]), np.array([5.0, 5.0]))
    problem = Problem(obstacles=(big,))
    with pytest.raises(Infeasible):
        Solver(problem).solve(State.at([0.0, 0.0], np.eye(2)), np.zeros((5, 2)))


def test_a_box_about_the_place_that_the_state_leads_to_is_chosen_from_before_a_floor():
    """No choice of headings, of which a round floor leaves ever more, leads out of it."""
    posed = {'floor': floor('circle', 0.6), 'weights': Weights(1.0, 0.05, 0.0, 10.0)}
    problem = Problem(3, horizon=2, obstacles=(Box((0.8, -1.0, -1.0), (1.2, 1.0, 0.3)),), **posed)
    start = State.at(np.zeros(3), np.eye(3))
    method = DisjunctiveSearch(problem, 1e-6)
    with pytest.raises(Infeasible):
        method.solve(Request(start, np.tile([0.9, 0.2, 0.0], (2, 1))))


def test_nodes_that_are_solved_but_roughly_are_branched_on(monkeypatch):
    """As where an interior-point method stalls: the bound is good, the solution nearly."""
    problem = Problem(
        3,
        horizon=2,
        floor=floor('circle', 0.6),
        weights=Weights(1.0, 0.05, 0.0, 10.0),
        obstacles=(Box((1.2, -1.0, -1.0), (1.6, 1.0, 0.3)),),
    )
    asked = State.at(np.zeros(3), np.eye(3)), np.tile([1.5, 0.2, 0.1], (2, 1))
    exact, solver = Solver(problem).solve(*asked), Solver(problem)
    rng, solves = np.random.default_rng(0), itertools.count()

    def stalling(known, out_of_time):
        answer = conic.run(known, out_of_time)
        if next(solves) % 3 == 2 or 'Infeasible' in str(answer.status):
            return answer
        x = answer.x + rng.uniform(-3e-7, 3e-7, len(answer.x))
        return SimpleNamespace(x=x, z=answer.z, status='InsufficientProgress', r_prim=3e-7)

    monkeypatch.setattr(program, 'run', stalling)
    plan = solver.solve(*asked)
    assert exact.status == plan.status == 'optimal'
    assert plan.objective == pytest.approx(exact.objective, rel=1e-5)


def test_corners_are_cut_only_where_that_is_allowed():
    """Two points on neighbouring sides of a box are outside it; the line between them is not."""
    corner = Box(np.array([0.0, -1.0]), np.array([1.0, 1.0]))
    free = Problem(horizon=4, obstacles=(corner,))
    start = State.at([-0.8, 0.0], np.array([[0.6, -0.8], [0.8, 0.6]]))
    targets = np.tile([1.2, 1.6], (4, 1))
    cutting = Solver(free).solve(start, targets)
    clear = Solver(replace(free, no_corner_cutting=True)).solve(start, targets)

    def deepest(plan):
        points = [
            a + s * (b - a)
            for a, b in itertools.pairwise(plan.positions[1:])
            for s in np.linspace(0, 1, 101)
        ]
        return corner.depth(np.array(points)).max()

    assert deepest(cutting) > 0.02
    assert deepest(clear) <= 1e-6
    assert clear.objective >= cutting.objective


def test_guess_only_helps():
    problem, start, targets = reference('uav_hexagon_1')
    cold = Solver(problem).solve(start, targets)
    warm = Solver(problem).solve(start, targets, guess=cold)
    assert warm.objective == pytest.approx(cold.objective, rel=1e-6)
    assert warm.nodes <= cold.nodes


def test_goals_drift_with_the_horizon():
    rng = np.random.default_rng(11)
    problem = Problem(horizon=4, floor=floor('polygon'))
    start = state(rng, problem)
    moving = goals(rng, problem, distance=1.0)
    plan = Solver(problem).solve(start, moving)
    assert plan.objective == pytest.approx(enumerated(problem, start, moving), rel=1e-5)


@pytest.mark.parametrize('seed', range(6))
def test_sorted_faces_lose_nothing_where_steps_are_exchangeable(seed):
    """Pure length to an arrival: only the sum of the steps counts, so their order is free."""
    rng = np.random.default_rng(seed)
    problem = Problem(
        horizon=4,
        terminal='constraint',
        floor=floor('polygon', 0.6, int(rng.integers(4, 7))),
        weights=Weights(position=0.0, input=0.0, length=1.0, terminal=0.0),
    )
    start = state(rng, problem)
    beyond = start.position + start.rotation[:, 0] + rng.uniform(-1.8, 1.8, size=2)
    targets = np.tile(beyond, (4, 1))
    assert steps_are_exchangeable(problem)
    expected = enumerated(problem, start, targets)
    if expected == np.inf:
        with pytest.raises(Infeasible):
            Solver(problem).solve(start, targets)
        return
    plan = Solver(problem).solve(start, targets)
    assert plan.status == 'optimal'
    assert plan.objective == pytest.approx(expected, rel=1e-5)


def test_the_papers_minute_long_problem_is_proved():
    """Dubins, N = 20, det R >= 1/2 by a square, path length alone: no input weight."""
    problem, start, targets = reference('dubins_square')
    pure = replace(problem, weights=replace(problem.weights, input=0.0))
    plan = Solver(pure).solve(start, targets)
    assert plan.status == 'optimal'
    assert violations(pure, start, targets, plan) == []
    assert plan.objective < 14.46
