# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The circular floor: its bounds are sound, the best of them is the lifted relaxation's."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from problems import floor, goals, reference, state, weights

from orbimpc_ros.mpc.arrays import sealed
from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.annulus import improve
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.problem import Problem, State, Weights
from orbimpc_ros.mpc.solve.annulus_newton import NOTHING, AnnulusNewton
from orbimpc_ros.mpc.solve.request import Guess, Request
from orbimpc_ros.mpc.solve.solver import Solver


def random_problem(rng, horizon=5, length=True):
    chosen = weights(rng)
    if not length:
        chosen = replace(chosen, length=0.0)
    fraction = rng.choice([np.sqrt(0.3), rng.uniform(0.1, 0.99), 1.0])
    return Problem(horizon=horizon, weights=chosen, floor=floor('circle', fraction))


def random_start(rng, count, fraction):
    angle, size = rng.uniform(0, 2 * np.pi, count), rng.uniform(fraction, 1.0, count)
    return np.column_stack([np.cos(angle), np.sin(angle)]) * size[:, None]


def best_descent(rng, problem, start, targets, count=50):
    """The least cost that projected gradient descent reaches from random starts, all at once."""
    condensed = Condensed(problem)
    hessian, (q, c) = condensed.hessian, condensed.affine(start, targets)
    low = problem.floor.fraction
    length = np.full(problem.horizon, problem.weights.length * problem.step * problem.forward)
    length[-1] = 0.0
    z = np.stack([random_start(rng, problem.horizon, low) for _ in range(count)])
    rate = 1.0 / (np.linalg.eigvalsh(hessian)[-1] + length.max() / low)

    def moduli(z):
        return np.sqrt(np.sum(z * z, axis=2, keepdims=True))

    for _ in range(200):
        size = moduli(z)
        z = z - rate * (hessian @ z + q + length[:, None] * z / size)
        size = moduli(z)
        z *= np.clip(size, low, 1.0) / size
    cost = np.sum(z * (0.5 * hessian @ z + q), axis=(1, 2)) + moduli(z)[:, :, 0] @ length + c
    return cost.min()


def dense_bound(problem, start, targets):
    """The lifted relaxation as one dense Hermitian matrix of moments of (1, z_1..z_N)."""
    steps = problem.horizon
    condensed = Condensed(problem)
    q, c = condensed.affine(start, targets)
    moments = cp.Variable((steps + 1, steps + 1), hermitian=True)
    hessian = condensed.hessian
    linear = q[:, 0] + 1j * q[:, 1]
    cost = 0.5 * cp.real(cp.sum(cp.multiply(hessian, moments[1:, 1:])))
    cost += cp.real(cp.sum(cp.multiply(linear.conj(), moments[1:, 0])))
    squares = cp.real(cp.diag(moments))[1:]
    low = problem.floor.fraction
    constraints = [moments >> 0, moments[0, 0] == 1, squares >= low**2, squares <= 1]
    program = cp.Problem(cp.Minimize(cost), constraints)
    program.solve(solver=cp.CLARABEL)
    return program.value + c


@pytest.mark.parametrize('seed', range(40))
def test_no_bound_exceeds_the_best_of_many_local_optima(seed):
    """50 states and goals a seed, 50 local starts each: 2,000 problems in all."""
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, horizon=int(rng.integers(2, 6)))
    circle = AnnulusNewton(problem, 1e-6)
    for _ in range(50):
        start, targets = state(rng, problem, full_speed=False), goals(rng, problem)
        found = circle.solve(Request(start, targets))
        best = min(best_descent(rng, problem, start, targets), found.cost)
        assert found.lower_bound <= best + 1e-6 * abs(best)


def tick_of(circle, start, targets, out_of_time=None):
    return circle._tick(Request(start, targets, out_of_time=out_of_time))


@pytest.mark.parametrize('seed', range(10))
def test_the_best_multipliers_bound_as_well_as_the_lifted_relaxation(seed):
    rng = np.random.default_rng(seed)
    problem = random_problem(rng, length=False)
    start, targets = state(rng, problem), goals(rng, problem)
    dense = dense_bound(problem, start, targets)
    circle = AnnulusNewton(problem, 1e-12)
    found = circle._from_dual(tick_of(circle, start, targets), NOTHING)
    assert found.lower_bound == pytest.approx(dense, rel=2e-6, abs=1e-6)


@pytest.mark.parametrize('seed', range(30))
def test_solves_to_global_optimality_and_says_so(seed):
    rng = np.random.default_rng(100 + seed)
    problem = random_problem(rng, length=False)
    start, targets = state(rng, problem), goals(rng, problem, distance=1.0)
    plan = Solver(problem).solve(start, targets)
    assert plan.status == 'optimal'
    assert plan.gap <= 1e-4
    assert violations(problem, start, targets, plan) == []


@pytest.mark.parametrize('fraction', [0.3, 0.7, 1.0])
def test_a_certificate_is_a_zero_gap_and_its_absence_is_a_real_one(fraction):
    rng = np.random.default_rng(1)
    problem = Problem(floor=floor('circle', fraction))
    circle = AnnulusNewton(problem, 1e-9)
    certified = local = 0
    for _ in range(40):
        start, targets = state(rng, problem), goals(rng, problem, distance=0.5)
        starts = [random_start(rng, 5, fraction) for _ in range(6)]
        points = [circle.local(start, targets, each) for each in starts]
        best = min(p.cost for p in points)
        bound = max(p.lower_bound for p in points)
        for point in points:
            proved = point.cost - point.lower_bound < 1e-7 * abs(point.cost)
            certified += proved
            local += point.cost > best * (1 + 1e-6)
            assert not (proved and point.cost > best * (1 + 1e-6))
        assert bound <= best * (1 + 1e-9)
    assert certified > 0
    assert local > 0


@pytest.mark.parametrize(
    'change',
    [
        {'horizon': 10, 'forward': 50.0},
        {'horizon': 10, 'forward': 100.0},
        {'horizon': 10, 'forward': 200.0},
        {'horizon': 15, 'translation_order': 2},
    ],
)
def test_slow_starts_converge_and_are_proved(change):
    """Weights far apart leave directions that hardly matter: a start is slow along them."""
    rng = np.random.default_rng(4)
    problem = Problem(floor=floor('circle'), **change)
    circle = AnnulusNewton(problem, 1e-6)
    reach = problem.forward * 2.0
    for _ in range(10):
        start = state(rng, problem)
        targets = start.position + np.tile([reach, 0.0], (problem.horizon, 1))
        found = circle.solve(Request(start, targets))
        assert circle.settles(found)
        best = best_descent(rng, problem, start, targets)
        assert found.lower_bound <= best * (1 + 1e-9)
        assert found.cost <= best * (1 + 1e-4)


def test_a_start_that_is_cut_short_has_a_cost_and_a_bound(monkeypatch):
    rng = np.random.default_rng(2)
    problem = Problem(horizon=6, floor=floor('circle'))
    circle = AnnulusNewton(problem, 1e-4)
    for _ in range(5):
        start, targets = state(rng, problem), goals(rng, problem)
        whole = circle.solve(Request(start, targets))
        with monkeypatch.context() as patched:
            patched.setattr('orbimpc_ros.mpc.solve.annulus_newton.SLICE', 1.0)  # a Newton step
            found = circle.solve(Request(start, targets, out_of_time=lambda: True))
        assert np.linalg.norm(found.x, axis=1).min() >= problem.floor.fraction - 1e-12
        assert np.linalg.norm(found.x, axis=1).max() <= 1.0 + 1e-12
        assert -np.inf < found.lower_bound <= whole.cost * (1 + 1e-9)
        assert whole.lower_bound <= found.cost < np.inf


@pytest.mark.parametrize('fraction', [0.5, 1.0])
@pytest.mark.parametrize('dimension', [2, 3])
def test_a_heading_that_nothing_weighs_is_no_trouble(dimension, fraction):
    rng = np.random.default_rng(7)
    for chosen in (Weights(1.0, 0.0, 0.0, 1.0), Weights(0.0, 0.0, 0.0, 0.0)):
        problem = Problem(dimension=dimension, weights=chosen, floor=floor('circle', fraction))
        start, targets = state(rng, problem), goals(rng, problem)
        found = AnnulusNewton(problem, 1e-6).solve(Request(start, targets))
        assert found.cost - found.lower_bound <= max(1e-4 * found.cost, 1e-9)


def test_an_arrival_out_of_reach_is_refused_and_one_just_within_is_met():
    problem = Problem(horizon=6, terminal='constraint', floor=floor('circle', 0.5))
    circle = AnnulusNewton(problem, 1e-6)
    start = State.at(np.zeros(2), np.eye(2))
    with pytest.raises(Infeasible):
        circle.solve(Request(start, np.tile([6.001, 0.0], (6, 1))))
    targets = np.tile([5.999, 0.0], (6, 1))
    found = circle.solve(Request(start, targets))
    assert np.allclose(found.x[:-1].sum(axis=0), [4.999, 0.0], atol=1e-9)
    assert circle.settles(found)


def test_arrival_and_length_are_certified_at_the_papers_dubins_problem():
    problem, start, targets = reference('dubins_circle')
    plan = Solver(problem).solve(start, targets)
    assert plan.status == 'optimal'
    assert np.allclose(plan.positions[-1], targets[-1], atol=1e-9)
    assert plan.speed_fraction[1:].min() >= np.sqrt(0.5) - 1e-8


def test_multipliers_bound_arrival_and_length():
    problem, start, _ = reference('dubins_circle')
    short = replace(problem, horizon=6)
    near = np.tile([2.0, 3.0], (6, 1))
    circle = AnnulusNewton(short, 1e-12)
    bound = circle._from_dual(tick_of(circle, start, near), NOTHING).lower_bound
    plan = Solver(short).solve(start, near)
    assert bound <= plan.objective * (1 + 1e-6)
    assert bound == pytest.approx(plan.objective, rel=1e-2)


@pytest.mark.parametrize('seed', range(20))
@pytest.mark.parametrize('fraction', [0.5, 1.0])
def test_a_sphere_is_certified_where_the_cost_sees_the_thrust_axis_alone(seed, fraction):
    rng = np.random.default_rng(seed)
    seen = Weights(position=1.0, input=0.0, length=0.0, terminal=10.0)
    problem = Problem(dimension=3, horizon=4, weights=seen, floor=floor('circle', fraction))
    start = state(rng, problem)
    targets = np.tile(start.position + rng.normal(size=3), (4, 1))
    plan = Solver(problem).solve(start, targets)
    assert violations(problem, start, targets, plan) == []
    assert plan.status == 'optimal'


@pytest.mark.skipif(not COMPILED, reason='searched by machine code only: pip install numba')
@pytest.mark.parametrize(
    ('position', 'heading', 'targets', 'known'),
    [
        (
            [2.38028833, -0.54582049],
            [0.98153921, 0.19126104],
            [
                [3.71374836, 0.04473868],
                [3.5959582, -0.05858627],
                [3.58673334, -0.2540099],
                [3.65740896, -0.49784341],
                [3.78678497, -0.75824361],
            ],
            0.8476808,
        ),
        (
            [4.84911772, -0.39878528],
            [0.30919549, 0.45210414],
            [
                [5.16370425, -0.18621886],
                [5.40701176, -0.13395184],
                [5.55477072, -0.16355349],
                [5.57321975, -0.26826013],
                [5.45814346, -0.4241474],
            ],
            0.7352761,
        ),
    ],
)
def test_an_optimum_that_no_local_search_reaches_is_found(position, heading, targets, known):
    """Two ticks of a study in which IPOPT, from its previous plan, once came out cheaper."""
    (a, b) = heading
    found = Solver(Problem(floor=floor('circle', np.sqrt(0.3)))).solve(
        State.at(position, [[a, -b], [b, a]]), np.array(targets)
    )
    assert found.objective == pytest.approx(known, rel=1e-6)


@pytest.mark.skipif(not COMPILED, reason='nothing is compiled: pip install numba')
@pytest.mark.parametrize('dimension', [2, 3])
def test_a_guess_compiles_nothing_in_a_tick(dimension):
    seen = Weights(input=0.0)
    problem = Problem(dimension=dimension, weights=seen, floor=floor('circle'))
    circle = AnnulusNewton(problem, 1e-6)
    start, targets = State.at(np.zeros(dimension), np.eye(dimension)), np.ones((5, dimension))
    found = circle.solve(Request(start, targets))
    compiled = len(improve.signatures)
    again = circle.solve(Request(start, targets, Guess(sealed(found.x), found.cost)))
    assert len(improve.signatures) == compiled
    assert again.cost == pytest.approx(found.cost, rel=1e-9)
