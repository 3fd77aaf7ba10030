# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Natural units: what is solved is the problem itself, whatever its lengths, times and weights."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from problems import ORDERS, box, floor, goals, rotation, state, weights

from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Box, Problem, State, Weights
from orbimpc_ros.mpc.problem.units import Units
from orbimpc_ros.mpc.solve.solver import Solver

PATIENCE = 300 if COMPILED else 10  # polls, between which plain Python takes far longer
SPEEDS = [(0.02, 0.1), (0.7, 3.0), (2.0, 1000.0)]


def measured(problem, rng):
    """A state and goals as large as the problem's steps are long."""
    start, targets = state(rng, Problem(**orders(problem))), goals(rng, problem)
    start = replace(
        start,
        position=problem.length_unit * start.position,
        velocity=problem.length_unit / problem.step * start.velocity,
        rotation_rate=start.rotation_rate / problem.step,
    )
    return start, problem.length_unit * targets


def orders(problem):
    names = ('dimension', 'rotation_order', 'translation_order')
    return {name: getattr(problem, name) for name in names}


@pytest.mark.parametrize('orders', ORDERS)
@pytest.mark.parametrize(('step', 'forward'), SPEEDS)
def test_a_trajectory_costs_the_same_in_any_units(orders, step, forward):
    rng = np.random.default_rng(3)
    problem = Problem(
        **orders, step=step, forward=forward, weights=weights(rng), arrival_weight=2.0
    )
    units = Units.of(problem)
    start, targets = measured(problem, rng)
    x = rng.normal(size=(5, len(coordinates(start.rotation))))
    plain = trajectory_of(problem, start, targets, x)
    scaled = trajectory_of(units.problem, units.state(start), units.lengths(targets), x)
    assert units.cost * scaled.cost == pytest.approx(plain.cost, rel=1e-9)
    np.testing.assert_allclose(scaled.positions * units.length, plain.positions, rtol=1e-9)
    diagonal = np.diag(Condensed(units.problem).hessian)
    assert max(diagonal.max(), units.problem.weights.length) == pytest.approx(1.0)


def test_limits_are_scaled_along():
    near = Box([1.0, 2.0], [3.0, 4.0])
    problem = Problem(step=0.5, forward=4.0, max_rate=2.0 * np.pi, obstacles=(near,))
    scaled = Units.of(problem).problem
    assert (scaled.step, scaled.forward, scaled.max_rate) == (1.0, 1.0, np.pi)
    np.testing.assert_allclose(scaled.obstacles[0].maximum, [1.5, 2.0])
    assert scaled.chord == pytest.approx(problem.chord)
    nothing = Units.of(Problem(weights=Weights(0.0, 0.0, 0.0, 0.0)))
    assert nothing.cost == 1.0


@pytest.mark.parametrize('shape', ['none', 'polygon', 'circle'])
@pytest.mark.parametrize(('step', 'forward'), SPEEDS)
def test_the_same_flight_at_any_speed_has_the_same_plan(shape, step, forward):
    """One problem stated in two systems of units: the same rotations, the costs in proportion."""
    rng = np.random.default_rng(11)
    natural = Problem(floor=floor(shape), obstacles=(box(rng, 2, np.array([2.0, 0.0])),))
    other = replace(
        natural,
        step=step,
        forward=forward,
        weights=Weights(1.0, 0.05 * (step * forward * step) ** 2, 0.0, 10.0),
        obstacles=tuple(
            Box(b.minimum * step * forward, b.maximum * step * forward) for b in natural.obstacles
        ),
    )
    start = State.at([0.0, 0.0], np.eye(2))
    targets = np.tile([4.0, 1.0], (5, 1))
    here = Solver(natural).solve(start, targets)
    there = Solver(other).solve(start, step * forward * targets)
    assert there.status == here.status == 'optimal'
    assert there.objective == pytest.approx((step * forward) ** 2 * here.objective, rel=1e-6)
    np.testing.assert_allclose(there.rotations, here.rotations, atol=1e-2)


FACTORS = [1e-12, 1e-6, 1e6, 1e12]


@pytest.mark.parametrize('factor', FACTORS)
@pytest.mark.parametrize('shape', ['none', 'polygon', 'circle'])
def test_weights_that_are_all_larger_change_no_plan(shape, factor):
    rng = np.random.default_rng(12)
    small = Problem(floor=floor(shape), weights=Weights(1.0, 0.05, 0.3, 10.0))
    large = replace(small, weights=Weights(factor, 0.05 * factor, 0.3 * factor, 10.0 * factor))
    start, targets = state(rng, small), goals(rng, small)
    expected, plan = (Solver(p).solve(start, targets) for p in (small, large))
    assert plan.status == expected.status == 'optimal'
    assert plan.objective == pytest.approx(factor * expected.objective, rel=1e-6)


def test_a_plan_of_another_state_starts_no_search():
    """A guess is believed neither its cost nor its place."""
    problem = Problem(floor=floor('polygon'), max_rate=0.8)
    solver = Solver(problem)
    start, targets = State.at([0.0, 0.0], np.eye(2)), np.tile([4.0, 1.0], (5, 1))
    elsewhere = solver.solve(State.at([3.9, 0.9], np.eye(2)), targets)
    cheap = replace(solver.solve(start, targets), objective=1e-3)
    expected = solver.solve(start, targets).objective
    for guess in (elsewhere, cheap):
        assert solver.solve(start, targets, guess).objective == pytest.approx(expected, rel=1e-4)


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
        'lower bound exceeds': lambda *a: beaten(solve(*a), 10.0),
        'the trajectory found is not finite': lambda *a: replace(solve(*a), x=np.nan * solve(*a).x),
        'no trajectory': lambda *a: replace(solve(*a), x=None, cost=np.inf, lower_bound=np.inf),
    }
    for said, method in broken.items():
        monkeypatch.setattr(solver._method, 'solve', method)
        plan = solver.solve(start, targets)
        assert plan.status == 'feasible'
        assert said in plan.proof.reason
        assert plan.lower_bound <= truly.objective <= plan.objective
    monkeypatch.setattr(solver._method, 'solve', lambda *a: beaten(solve(*a), 0.16))
    plan = solver.solve(start, targets)  # told a cost that is too low, with a bound to match
    assert (plan.status, plan.objective) == ('feasible', pytest.approx(truly.objective))


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
        solver = Solver(problem, coasting=True)
        plan = solver.solve(start, targets, out_of_time=lambda: True)
        assert 0.0 <= plan.lower_bound <= plan.objective * (1.0 + 1e-6)
        polls = itertools.count()
        better = solver.solve(start, targets, out_of_time=lambda p=polls: next(p) > PATIENCE)
        assert plan.lower_bound <= better.objective * (1.0 + 1e-6)


def test_a_cost_far_below_the_usual_is_proved_in_proportion_to_itself():
    """Turning weighs 1e13 times as much as what is flown: still the shorter flight is found."""
    problem = Problem(
        horizon=2,
        weights=Weights(0.0, 0.125, 2.8e-14, 0.0),
        floor=floor('polygon', 0.728, 5),
        max_rate=0.42,
    )
    start = State.at([0.0, 0.0], rotation(np.random.default_rng(14), 2))
    plan = Solver(problem).solve(start, np.tile([3.0, 1.0], (2, 1)))
    assert plan.objective <= 2.0 * 2.8e-14 * (1.0 + 1e-6)
