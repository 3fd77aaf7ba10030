# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The compiled convex program: optimality judged without a solver, updates in place, far goals."""

from dataclasses import replace

import numpy as np
import pytest
from problems import ORDERS, goals, state, weights

from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import BadInput, Infeasible
from orbimpc_ros.mpc.geometry.orbitopes import matrix
from orbimpc_ros.mpc.geometry.rotations import nearest
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.plan import UNPROVED, assemble
from orbimpc_ros.mpc.problem import Problem, State, Weights
from orbimpc_ros.mpc.solve.disjunction import Slot
from orbimpc_ros.mpc.solve.program import Program
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Solver


def suboptimality(problem, start, targets, x):
    """How much better any trajectory can be at most: the Frank-Wolfe gap over SO(n)^N.

    The cost is convex in R_1..R_N, so it is at least its tangent plane, whose minimum over
    conv SO(n) is at a rotation: the one nearest to minus the gradient.
    """

    def cost(rotations):
        coordinates = rotations[:, :, 0] if problem.dimension == 2 else None
        if coordinates is None:
            coordinates = np.swapaxes(rotations, 1, 2).reshape(len(rotations), 9)
        return trajectory_of(problem, start, targets, coordinates).cost

    rotations, h = matrix(x), 1e-6
    gap = 0.0
    for k in range(len(rotations)):
        gradient = np.zeros_like(rotations[k])
        basis = np.eye(9).reshape(9, 3, 3) if problem.dimension == 3 else PLANE
        for e in basis:
            up, down = rotations.copy(), rotations.copy()
            up[k], down[k] = rotations[k] + h * e, rotations[k] - h * e
            gradient += (cost(up) - cost(down)) / (2 * h) * e / np.sum(e * e)
        gap += np.sum(gradient * (rotations[k] - nearest(-gradient)))
    return gap


PLANE = np.array([[[1.0, 0.0], [0.0, 1.0]], [[0.0, -1.0], [1.0, 0.0]]])


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('translation_order', [1, 2])
@pytest.mark.parametrize('seed', range(4))
def test_hull_optimum_has_no_frank_wolfe_gap(n, translation_order, seed):
    rng = np.random.default_rng(seed)
    smooth = replace(weights(rng), length=0.0)  # |R e1| has a kink where the vehicle stops
    problem = Problem(n, 1, translation_order, horizon=4, weights=smooth)
    start, targets = state(rng, problem), goals(rng, problem)
    program = Program(problem)
    at = Request(start, targets)
    relaxed = program.relax(at)
    cost = trajectory_of(problem, start, targets, relaxed.x).cost
    assert suboptimality(problem, start, targets, relaxed.x) <= 2e-5 * max(1.0, cost)
    assert relaxed.bound == pytest.approx(cost, rel=1e-6)


@pytest.mark.parametrize('orders', ORDERS)
@pytest.mark.parametrize('terminal', ['penalty', 'constraint'])
def test_updating_in_place_is_compiling_anew(orders, terminal):
    rng = np.random.default_rng(7)
    problem = Problem(**orders, horizon=8, max_rate=2.0, terminal=terminal, weights=weights(rng))
    reused = Program(problem, coasting=True)
    compared = 0
    for _ in range(6):
        start, targets = state(rng, problem), goals(rng, problem, distance=1.0)
        fresh = Program(problem, coasting=True)
        at = Request(start, targets)
        at = Request(start, targets)
        try:
            expected = fresh.relax(at)
        except Infeasible:
            with pytest.raises(Infeasible):
                reused.relax(at)
            continue
        relaxed = reused.relax(at)
        compared += 1
        assert relaxed.bound == pytest.approx(expected.bound, rel=1e-6, abs=1e-7)
        plan = assemble(
            problem,
            start,
            targets,
            relaxed.x,
            projection='nearest',
            proof=UNPROVED,
        )
        assert violations(problem, start, targets, plan) == []
        assert plan.objective == pytest.approx(relaxed.bound, rel=1e-5, abs=1e-6)
    assert compared >= 2


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('distance', [1e3, 1e6, 1e8])
@pytest.mark.parametrize('forward', [0.1, 20.0])
def test_a_far_goal_is_flown_at_full_speed_not_called_infeasible(n, distance, forward):
    problem = Problem(n, horizon=5, forward=forward)
    start = state(np.random.default_rng(3), problem)
    direction = np.full(n, 1.0 / np.sqrt(n))
    program = Program(problem)
    at = Request(start, np.tile(start.position + distance * direction, (5, 1)))
    x = program.relax(at).x
    assert np.allclose(x[0, :n], direction, atol=0.02)
    at = Request(start, np.tile(start.position, (5, 1)))  # and the scale is taken back
    near = program.relax(at)
    fresh = Program(problem)
    at = Request(start, np.tile(start.position, (5, 1)))
    assert near.bound == pytest.approx(fresh.relax(at).bound, rel=1e-6)


def by(angle):
    """The rotation of the plane by an angle."""
    return np.cos(angle) * PLANE[0] + np.sin(angle) * PLANE[1].T


def test_a_cost_far_below_its_curvature_is_minimised():
    problem = Problem(
        rotation_order=2,
        translation_order=2,
        horizon=8,
        step=0.0236,
        forward=9.22,
        weights=Weights(position=0.0, input=7844.0, length=11.1, terminal=0.0156),
    )
    start = State.at([0.0, 0.0], 0.454 * by(-0.082), velocity=[0.0401, 0.0089], coasted=by(-0.01))
    plan = Solver(problem, coasting=True).solve(start, np.tile([-0.177, -0.458], (8, 1)))
    assert plan.gap <= 1e-4


def test_a_half_space_binds_and_is_gone_in_the_next_solve():
    problem = Problem(horizon=3)
    start = state(np.random.default_rng(0), problem)
    program = Program(problem, [Slot('heading', 2), Slot('position', 3)])
    at = Request(start, np.tile(start.position, (3, 1)))
    free = program.relax(at)
    normal = np.array([0.0, 1.0])
    bound = program.relax(at, [(0, normal, 0.9)])
    assert bound.x[1] @ normal >= 0.9 - 1e-7
    assert bound.bound > free.bound
    wall = free_position(problem, start, free.x)[3] @ normal + 0.3
    moved = program.relax(at, [(1, normal, wall)])
    assert free_position(problem, start, moved.x)[3] @ normal >= wall - 1e-7
    assert program.relax(at).bound == pytest.approx(free.bound, rel=1e-9)


def free_position(problem, start, x):
    targets = np.zeros((problem.horizon, problem.dimension))
    return trajectory_of(problem, start, targets, x).positions


def test_contradictory_half_spaces_are_infeasible():
    problem = Problem(horizon=2)
    start = state(np.random.default_rng(0), problem)
    program = Program(problem, [Slot('heading', 1), Slot('heading', 1)])
    at = Request(start, np.zeros((2, 2)))
    east = np.array([1.0, 0.0])
    with pytest.raises(Infeasible):
        program.relax(at, [(0, east, 0.5), (1, -east, 0.5)])


def test_the_rate_limit_bounds_every_turn():
    problem = replace(Problem(horizon=6), max_rate=0.4)
    start = state(np.random.default_rng(5), problem)
    program = Program(problem)
    at = Request(start, np.tile(start.position - 5 * start.rotation[:, 0], (6, 1)))
    x = np.concatenate([start.rotation[None, :, 0], program.relax(at).x])
    turned = np.linalg.norm(np.diff(x, axis=0), axis=1)
    assert turned.max() <= 2 * np.sin(0.2) + 1e-8
    assert turned.max() >= 2 * np.sin(0.2) - 1e-4


@pytest.mark.parametrize('n', [2, 3])
def test_a_state_without_the_rotation_that_the_solver_was_made_for_is_refused(n):
    solver = Solver(Problem(n, rotation_order=2, horizon=3), coasting=True)
    start = State.at(np.zeros(n), np.eye(n))
    with pytest.raises(BadInput, match=r'state\.coasted'):
        solver.solve(start, np.zeros((3, n)))
