# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The controllers to compare with: right where there is an oracle, and flown by the same loop."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.baselines import BASELINES, baseline_named, class_of, tuned_of, tuning
from benchmarks.baselines.baseline import CONE, TRAFFIC, Sight
from benchmarks.baselines.guidance import crabbed
from benchmarks.baselines.linearised import Linearised
from benchmarks.baselines.nonlinear import Nonlinear
from benchmarks.baselines.sampling import _nearest
from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Box, Floor, Problem, State, Weights
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.ros.parameters import planner_settings
from orbimpc_ros.tool.study.draws import draws_of

CIRCLE = Problem(floor=Floor('circle'))
PROBLEMS = {
    'hull': Problem(),
    'circle': CIRCLE,
    'polygon': Problem(floor=Floor('polygon')),
    'slow to turn': Problem(max_rate=0.5),
}


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


@pytest.mark.parametrize('kind', [Linearised, Nonlinear])
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
        baseline._previous = None


@pytest.mark.parametrize('name', ['hull', 'slow to turn'])
def test_the_nonlinear_optimum_is_global_where_the_problem_is_convex(name):
    rng, problem = np.random.default_rng(5), PROBLEMS[name]
    baseline, solver = built(Nonlinear, problem), Solver(problem)
    for _ in range(10):
        state, goals = drawn(rng)
        baseline._previous = None
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
def test_problems_that_a_baseline_cannot_state_are_refused(bad):
    with pytest.raises(BadInput, match=next(iter(bad))):
        Linearised(replace(Problem(), **bad))


def sight(goal, heading=0.0, wind=(0.0, 0.0), velocity=(0.0, 0.0), steps=12):
    """Of a goal that moves straight on, from the origin at 12 m/s."""
    goal, velocity = np.array(goal), np.array(velocity)
    state = State.at(np.zeros(2), 0.8 * exp(np.array([heading])))
    state = replace(state, attitude=exp(np.array([heading])))

    def ahead(times):
        return goal + np.multiply.outer(np.asarray(times), velocity)

    return Sight(0.0, state, ahead(0.5 * np.arange(1, steps + 1)), ahead, np.array(wind))


def made(name, **tuned):
    return baseline_named(name, planner_settings(draws_of('fixed_wing').values), '', tuned)


@pytest.mark.parametrize('name', [name for name in BASELINES if name != 'waypoint'])
def test_baselines_turn_to_the_side_of_the_goal(name):
    if name == 'nonlinear':
        pytest.importorskip('casadi')
    for side in (1.0, -1.0):
        baseline = made(name)
        for _ in range(4):  # a sampling pilot improves from tick to tick
            fraction, rate = baseline.steered(sight([30.0, side * 40.0]))
        assert side * rate > 0.05
        assert 0.5 < fraction <= 1.0


def test_the_lead_is_where_both_are_at_the_same_time():
    lead = made('lead')
    course, fraction = lead._meeting(sight([60.0, 0.0], wind=(0.0, 2.0), velocity=(0.0, 7.0)))
    flown = 15.0 * fraction * np.array([math.cos(course), math.sin(course)]) + [0.0, 2.0]
    closing = flown - [0.0, 7.0]
    assert closing[1] == pytest.approx(0.0, abs=0.3)
    assert closing[0] > 5.0


def test_proportional_navigation_holds_a_course_on_which_nothing_turns():
    rate = made('proportional').steered(sight([60.0, 0.0], velocity=(3.0, 0.0)))[1]
    assert rate == pytest.approx(0.0, abs=1e-12)
    assert made('proportional').steered(sight([60.0, 0.0], velocity=(0.0, 4.0)))[1] > 0.0


def test_a_crabbed_course_leads_along_the_way():
    wind, way = np.array([-2.0, 4.0]), np.array([3.0, 1.0])
    course = crabbed(way, 12.0, wind)
    over_ground = 12.0 * np.array([math.cos(course), math.sin(course)]) + wind
    across = over_ground[0] * way[1] - over_ground[1] * way[0]
    assert across == pytest.approx(0.0, abs=1e-9)
    assert over_ground @ way > 0.0


def test_samples_see_a_catch_between_the_ends_of_a_step():
    assert _nearest(np.array([[[-3.0, 1.0], [3.0, 1.0], [4.0, 1.0]]]))[0] == pytest.approx(
        [1.0, math.hypot(3.0, 1.0)]
    )


def test_the_search_for_settings_is_the_same_every_time_and_starts_with_the_defaults():
    for name in BASELINES:
        tried = tuning.candidates(name, {CONE, TRAFFIC})
        assert tried == tuning.candidates(name, {CONE, TRAFFIC})
        space = class_of(name).SPACE
        assert tried[0] == {key: each.default for key, each in space.items()}
        for each in tried:
            assert all(
                space[key].low * 0.999 <= v <= space[key].high * 1.001 for key, v in each.items()
            )
        assert set(tuning.candidates(name, ())[0]) == {k for k in space if not space[k].need}
    rows = [{'caught': True, 'time': 10.0}, {'caught': False, 'time': None}]
    assert tuning.score(rows, 60.0) == 65.0


def test_what_is_tuned_is_known_to_the_rival():
    for name in ('crossing', 'fixed_wing_cone', 'fixed_wing_near', 'gates', 'retrieval_small'):
        assert tuned_of(name)
        for baseline, numbers in tuned_of(name).items():
            assert set(numbers) <= set(class_of(baseline).SPACE)


def test_samples_can_be_drawn_where_the_speed_is_constant():
    values = draws_of('retrieval', ('floor.fraction=1.0',)).values
    baseline = baseline_named('sampling', planner_settings(values), '')
    fraction, rate = baseline.steered(sight([3.0, 4.0], steps=5))
    assert fraction == pytest.approx(1.0)
    assert math.isfinite(rate)
