# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The controllers to compare with: right where there is an oracle, and flown by the same loop."""

from dataclasses import replace

import numpy as np
import pytest

from orbimpc_ros.lab.study.baselines.linearised import Linearised
from orbimpc_ros.lab.study.baselines.nonlinear import Nonlinear
from orbimpc_ros.lab.study.baselines.pursuit import Pursuit
from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.loop.controller import Controller
from orbimpc_ros.mpc.loop.forecast import forecast_named
from orbimpc_ros.mpc.problem import Box, Floor, Problem, State, Weights
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.world.faults import Faults, View
from orbimpc_ros.world.flight import departure, fly, perfect_sensor, planned
from orbimpc_ros.world.rope import Rope, TrueMotion
from orbimpc_ros.world.scenario import retrieval
from orbimpc_ros.world.vehicle import launched

CIRCLE = Problem(floor=Floor('circle'))
PROBLEMS = {
    'hull': Problem(),
    'circle': CIRCLE,
    'polygon': Problem(floor=Floor('polygon')),
    'slow to turn': Problem(max_rate=0.5),
}
QUICK = (Linearised, Pursuit)


def built(kind, problem):
    if kind is Nonlinear:
        pytest.importorskip('casadi', reason='CasADi is not installed: pip install casadi')
    return kind(problem)


def drawn(rng, distance=4.0):
    """Return a random state and goals that move straight."""
    state = State.at(rng.normal(size=2), rng.uniform(0.6, 1.0) * exp(rng.uniform(-3, 3, size=1)))
    first, drift = rng.normal(size=2), 0.3 * rng.normal(size=2)
    goals = state.position + distance * first / np.linalg.norm(first)
    return state, goals + np.outer(np.arange(5), drift)


def started_from(baseline, plan):
    """Let a baseline start from a plan as it is, instead of from its last one moved on."""
    baseline.shifted = lambda state: plan.rotations[1:, :, 0]
    return baseline


@pytest.mark.parametrize('kind', [Linearised, Nonlinear, Pursuit])
@pytest.mark.parametrize('name', PROBLEMS)
def test_no_plan_of_a_baseline_undercuts_the_bound(kind, name):
    """What is feasible cannot cost less than what was proved, and nobody is infeasible."""
    rng, problem = np.random.default_rng(3), PROBLEMS[name]
    baseline, solver = built(kind, problem), Solver(problem)
    for _ in range(10):
        state, goals = drawn(rng)
        plan = baseline.plan(state, goals)
        optimum = solver.solve(state, goals)
        found = violations(problem, state, goals, plan)
        assert all('max_rate' in each for each in found), found
        if not found:
            assert plan.objective >= optimum.lower_bound - 1e-7 * optimum.objective


def test_the_linearised_plan_is_the_optimum_where_linearising_is_exact():
    """Straight ahead nothing turns, and along the axis the dynamics are linear."""
    state, problem = State.at([0.0, 0.0], 0.8 * np.eye(2)), PROBLEMS['hull']
    for distance in (3.5, 4.2, 9.0):
        goals = np.tile([distance, 0.0], (5, 1))
        ours, theirs = Solver(problem).solve(state, goals), Linearised(problem).plan(state, goals)
        assert theirs.objective == pytest.approx(ours.objective, rel=1e-6)
        np.testing.assert_allclose(theirs.rotations, ours.rotations, atol=5e-3)


def test_an_optimal_plan_stays_when_linearised_about_itself():
    """The gradient is exact, so that a stationary point is a fixed point."""
    rng = np.random.default_rng(2)
    baseline, solver = Linearised(CIRCLE), Solver(CIRCLE, gap_tolerance=1e-8)
    for _ in range(5):
        state, goals = drawn(rng)
        optimum = solver.solve(state, goals)
        found = started_from(baseline, optimum).plan(state, goals)
        assert found.objective == pytest.approx(optimum.objective, rel=1e-6)
        np.testing.assert_allclose(found.rotations, optimum.rotations, atol=5e-3)


def test_the_linearised_plan_turns_no_faster_than_asked():
    problem = PROBLEMS['slow to turn']
    baseline = Linearised(problem)
    rng = np.random.default_rng(0)
    for _ in range(10):
        state, goals = drawn(rng)
        headings = baseline.plan(state, goals).projected[:, :, 0]
        turned = np.arccos(np.clip(np.sum(headings[1:] * headings[:-1], axis=1), -1.0, 1.0))
        assert turned.max() <= 0.5 + 1e-6
        baseline.reset()


@pytest.mark.parametrize('name', ['hull', 'slow to turn'])
def test_the_nonlinear_optimum_is_global_where_the_problem_is_convex(name):
    rng, problem = np.random.default_rng(5), PROBLEMS[name]
    baseline, solver = built(Nonlinear, problem), Solver(problem)
    for _ in range(10):
        state, goals = drawn(rng)
        baseline.reset()
        expected = solver.solve(state, goals).objective
        assert baseline.plan(state, goals).objective == pytest.approx(expected, rel=1e-6)


def test_the_nonlinear_program_finds_the_optimum_from_the_optimum():
    """Its polygon is the planner's polygon, its circle the planner's circle."""
    rng = np.random.default_rng(6)
    for name in ('circle', 'polygon'):
        problem = PROBLEMS[name]
        baseline, solver = built(Nonlinear, problem), Solver(problem)
        for _ in range(5):
            state, goals = drawn(rng, 2.0)
            optimum = solver.solve(state, goals)
            found = started_from(baseline, optimum).plan(state, goals)
            assert found.objective == pytest.approx(optimum.objective, rel=2e-6)


def test_ipopt_giving_up_leaves_the_previous_plan():
    baseline = built(Nonlinear, CIRCLE)
    state, goals = drawn(np.random.default_rng(1))
    before = baseline.plan(state, goals).rotations[1:, :, 0]
    after = baseline.plan(state, np.full((5, 2), np.nan)).rotations[1:, :, 0]
    np.testing.assert_allclose(after[:-1], before[1:])


def test_pursuit_hits_what_it_can_reach_in_a_step():
    """From s_1 to g_2, to be there in time: not below the floor, nor above full speed."""
    state = State.at([1.0, 0.0], np.eye(2))
    for away, fraction in (([0.6, 0.6], np.hypot(0.6, 0.6)), ([0.1, 0.0], 0.3**0.5), ([3, 4], 1.0)):
        goals = np.tile(np.add([2.0, 0.0], away), (5, 1))
        plan = Pursuit(CIRCLE).plan(state, goals)
        assert plan.speed_fraction[1:] == pytest.approx(np.full(5, fraction))
        np.testing.assert_allclose(
            plan.rotations[1, :, 0], fraction * np.array(away) / np.hypot(*away)
        )


def test_pursuit_at_its_goal_flies_on():
    state = State.at([0.0, 0.0], np.eye(2))
    plan = Pursuit(CIRCLE).plan(state, np.tile([1.0, 0.0], (5, 1)))
    np.testing.assert_allclose(plan.rotations[1, :, 0], [1.0, 0.0])


@pytest.mark.parametrize('kind', [Controller, Linearised, Nonlinear, Pursuit])
def test_everyone_catches_a_slow_rope_straight_ahead(kind):
    controller = built(kind, CIRCLE)
    slow = Rope([5.0, 0.0], [0.2, 0.2], 0.02, [0.0, 1.0])
    for forecast in (forecast_named('harmonic'), TrueMotion(slow)):
        controller.reset()
        log = fly(controller, replace(retrieval(), rope=slow), forecast)
        assert log.captured
        assert len(log.ticks) <= 12


def test_a_plan_held_to_the_rate_limit_is_cut_like_the_planners():
    problem = PROBLEMS['slow to turn']
    start = launched(retrieval().model, np.zeros(2), exp(np.array([3.0])))
    flight = departure(replace(retrieval(), start=start))
    tick = planned(Pursuit(problem), flight, forecast_named('hold'))
    assert np.abs(tick.command.body_rate) == pytest.approx(0.5)


@pytest.mark.parametrize('kind', QUICK)
@pytest.mark.parametrize(
    'bad',
    [
        {'dimension': 3},
        {'rotation_order': 2},
        {'translation_order': 2},
        {'terminal': 'constraint'},
        {'obstacles': (Box([0.0, 0.0], [1.0, 1.0]),)},
        {'weights': Weights(length=1.0)},
    ],
)
def test_problems_that_a_baseline_cannot_state_are_refused(kind, bad):
    with pytest.raises(BadInput, match=next(iter(bad))):
        kind(replace(Problem(), **bad))


def test_who_is_told_the_future_knows_it():
    rope = retrieval().rope
    told, times = TrueMotion(rope), np.array([1.0, 2.5])
    told.observe(perfect_sensor(departure(retrieval()))[0])
    told.reset()
    np.testing.assert_allclose(told.at(times), [rope.at(1.0), rope.at(2.5)])


def test_a_noisy_sensor_is_flown_by():
    view = View(Faults(position_noise=0.1), 1, 1.0)

    def sensor(flight):
        return tuple(sent.content for sent in view.of(flight))

    clean = fly(Pursuit(CIRCLE), retrieval(), forecast_named('hold'))
    noisy = fly(Pursuit(CIRCLE), retrieval(), forecast_named('hold'), sensor)
    assert not np.allclose(clean.flights[2].vehicle.attitude, noisy.flights[2].vehicle.attitude)
    assert not np.allclose(clean.ticks[0].state.position, noisy.ticks[0].state.position)
