# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The cone of approach: optima, refutations and catches are those inside of it."""

from contextlib import suppress
from dataclasses import replace

import cvxpy as cp
import numpy as np
import problems
import pytest
from problems import floor
from stepping import Stepped
from test_mpc_attitude import hull
from test_mpc_interception import RADIUS, WING, measured, needs_speed, turned_at_random

from orbimpc_ros.mpc.check import approach_margin, violations
from orbimpc_ros.mpc.errors import BadInput, Infeasible
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Approach, Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.approach import SLOWEST
from orbimpc_ros.mpc.problem.case import case_of
from orbimpc_ros.mpc.problem.feasibility import constraints_in_force
from orbimpc_ros.mpc.search.engine import Engine
from orbimpc_ros.mpc.sensitivity.constraints import explained
from orbimpc_ros.mpc.solve.disjunctive_bnb import DisjunctiveSearch
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Solver

NORTH = Approach(0.3, (0.0, 1.0))


def drawn(rng, n):
    """A direction all around."""
    return tuple(problems.rotation(rng, n)[:, 0].tolist())


def convex(problem, start, goals):
    """The optimal value over the hull with its cone, stated anew (rotation order 1)."""
    n, h, w = problem.dimension, problem.step, problem.weights
    r, s, rows, cost = [start.rotation], start.position, [], 0.0
    for goal in goals:
        s = s + h * problem.forward * r[-1][:, 0]
        r.append(cp.Variable((n, n)))
        rows += hull(r[-1])
        cost += w.input * cp.sum_squares((r[-1] - r[-2]) / h) + w.position * cp.sum_squares(
            s - goal
        )
    ahead = problem.approach.axis(start) @ r[-1][:, 0]
    rows += [ahead >= np.cos(problem.approach.cone) * cp.norm(r[-1][:, 0])]
    rows += [ahead >= np.cos(problem.approach.cone) * SLOWEST]
    cost += w.terminal * cp.sum_squares(s - goals[-1])
    return cp.Problem(cp.Minimize(cost), rows).solve(solver=cp.CLARABEL)


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('n', [2, 3])
def test_hull_optima_are_those_of_another_formulation(n, seed):
    rng = np.random.default_rng([n, seed])
    approach = Approach(rng.uniform(0.1, 1.4), drawn(rng, n))
    problem = Problem(n, horizon=5, step=0.6, forward=1.4, approach=approach)
    start, goals = problems.state(rng, problem), problems.goals(rng, problem, distance=1.0)
    plan = Solver(problem, gap_tolerance=1e-6).solve(start, goals)
    assert plan.status == 'optimal', plan.proof.reason
    assert plan.objective == pytest.approx(convex(problem, start, goals), rel=1e-5)


def test_the_goals_own_axis_is_the_direction_where_none_is_given():
    rng = np.random.default_rng(1)
    problem = Problem(3, horizon=4, approach=Approach(0.2))
    start = replace(problems.state(rng, problem), wanted=problems.rotation(rng, 3))
    goals = problems.goals(rng, problem)
    plan = Solver(problem).solve(start, goals)
    same = replace(problem, approach=Approach(0.2, tuple(start.wanted[:, 0].tolist())))
    assert plan.objective == pytest.approx(Solver(same).solve(start, goals).objective, rel=1e-6)
    with pytest.raises(BadInput, match=r'state\.wanted is None'):
        Solver(problem).solve(replace(start, wanted=None), goals)


def headed_at_random(rng, problem, start):
    """Headings that keep to floor and turn rate and end in the cone, or None."""
    x = turned_at_random(rng, problem, start)
    return x if approach_margin(problem, start, x[-1]) >= 0.0 else None


def planned(problem, start, goals):
    """The plan, or None where it is proved that there is none."""
    with suppress(Infeasible):
        return Solver(problem).solve(start, goals)
    return None


@needs_speed
def test_what_no_turn_reaches_is_told():
    problem = replace(WING, horizon=2, approach=Approach(0.3, (-1.0, 0.0)))
    with pytest.raises(Infeasible, match=r'approach\.cone 0\.3'):
        Solver(problem).solve(State.at(np.zeros(2), np.eye(2)), np.zeros((2, 2)))


@needs_speed
@pytest.mark.parametrize('discretisation', ['euler', 'exact'])
def test_no_trajectory_in_the_cone_beats_a_floor_with_a_turn_rate(discretisation):
    rng, tried, bound_by = np.random.default_rng(2), 0, 0
    wing = replace(WING, discretisation=discretisation)
    for _ in range(8):
        approach = Approach(0.3, drawn(rng, 2))
        problem = replace(wing, approach=approach)
        start = State.at(np.zeros(2), 0.8 * np.eye(2))
        goals = np.tile(rng.uniform(-50.0, 50.0, 2), (8, 1))
        plan = planned(problem, start, goals)
        assert plan is None or not violations(problem, start, goals, plan)
        assert plan is None or plan.gap < 1e-2
        free = Solver(wing).solve(start, goals)
        bound_by += plan is not None and plan.objective > free.objective * 1.01
        for _ in range(300):
            x = headed_at_random(rng, problem, start)
            if x is not None:
                assert plan is not None
                tried += 1
                assert trajectory_of(problem, start, goals, x).cost >= plan.lower_bound
    assert tried > 20
    assert bound_by > 1


@needs_speed
def test_a_search_over_sectors_winds_round_to_its_cone():
    """A full circle to a heading just behind: left or right, each way a root of its own."""
    problem = replace(WING, horizon=16, max_rate=np.radians(30.0), floor=floor('circle', 1.0))
    problem = replace(problem, approach=Approach(0.2, (-1.0, 0.0)))
    assert Engine.solves(problem)
    start = State.at(np.zeros(2), np.eye(2))
    for side in (1.0, -1.0):
        goals = np.tile([-20.0, 57.0 * side], (16, 1))
        plan = Solver(problem).solve(start, goals)
        assert plan.gap < 1e-2
        turned = np.unwrap(np.arctan2(plan.rotations[:, 1, 0], plan.rotations[:, 0, 0]))[-1]
        assert side * turned == pytest.approx(np.pi, abs=0.2 + 1e-6)


@needs_speed
def test_a_search_over_sectors_agrees_with_the_general_one():
    rng, compared = np.random.default_rng(6), 0
    for _ in range(4):
        problem = Problem(
            horizon=3, floor=Floor('circle', fraction=0.6), max_rate=0.7, approach=NORTH
        )
        start = State.at(np.zeros(2), 0.8 * np.eye(2))
        goals = rng.uniform(-3.0, 3.0, (3, 2))
        fast = Engine(problem, 1e-7).solve(Request(start, goals))
        slow = DisjunctiveSearch(problem, 1e-5).solve(Request(start, goals))
        assert fast.lower_bound <= slow.cost * (1.0 + 1e-9)
        assert slow.lower_bound <= fast.cost * (1.0 + 1e-9)
        compared += slow.gap < 1e-2
    assert compared


@pytest.mark.parametrize('n', [2, 3])
def test_what_leads_out_of_the_cone_fails_the_check(n):
    rng = np.random.default_rng(n)
    problem = Problem(n, horizon=4)
    start, goals = problems.state(rng, problem), problems.goals(rng, problem)
    plan = Solver(problem).solve(start, goals)
    heading = plan.rotations[-1, :, 0]
    across = problems.rotation(rng, n) @ heading
    across -= heading * (across @ heading) / (heading @ heading)
    for angle, allowed in ((0.29, True), (0.31, False), (2.5, False)):
        along = np.cos(angle) * heading / np.linalg.norm(heading)
        axis = along + np.sin(angle) * across / np.linalg.norm(across)
        coned = replace(problem, approach=Approach(0.3, tuple(axis.tolist())))
        flaws = violations(coned, start, goals, plan)
        assert any('approach' in flaw for flaw in flaws) != allowed


def test_a_heading_that_vanishes_has_no_direction():
    problem, start = Problem(approach=NORTH), State.at(np.zeros(2), np.eye(2))
    assert approach_margin(problem, start, np.zeros(2)) < 0.0
    assert approach_margin(problem, start, np.array([0.0, SLOWEST])) > 0.0
    assert approach_margin(problem, start, np.array([0.0, 1.0])) == pytest.approx(1 - np.cos(0.3))
    assert approach_margin(problem, start, np.array([0.0, -1.0])) < -1.0


def test_its_price_is_what_a_wider_cone_saves():
    problem = Problem(horizon=4, step=0.6, weights=Weights(1.0, 0.5, 0.0, 3.0), approach=NORTH)
    start, goals = State.at(np.zeros(2), 0.9 * np.eye(2)), np.tile([2.0, -0.3], (4, 1))

    def solved(cone):
        wider = replace(problem, approach=replace(NORTH, cone=cone))
        return Solver(wider, gap_tolerance=1e-9).solve(start, goals)

    plan = solved(0.3)
    told = explained(problem, start, goals, plan)
    assert told.unexplained < 1e-3
    price = {each.name: each.price for each in told.binding}['approach']
    slope = (solved(0.299).objective - solved(0.301).objective) / 0.002
    assert price == pytest.approx(slope, rel=1e-2)


@pytest.mark.parametrize(
    ('cone', 'direction', 'culprit'),
    [
        (1.6, (), 'approach.cone is 1.6; allowed: a number in [0, 1.4]'),
        (-0.1, (), 'approach.cone'),
        (0.3, (1.0, 0.0, 0.0), 'approach.direction'),
        (0.3, (0.0, 0.0), 'approach.direction'),
        (0.3, (np.nan, 1.0), 'approach.direction'),
        (np.inf, (), 'approach.cone'),
    ],
)
def test_bad_cones_are_told(cone, direction, culprit):
    with pytest.raises(BadInput) as told:
        Problem(approach=Approach(cone, direction))
    assert culprit in str(told.value)


def test_files_state_it():
    case = {
        'dimension': 2, 'rotation_order': 1, 'translation_order': 1, 'horizon': 3, 'step': 1.0,
        'forward': 1.0, 'weights': {'terminal': 1.0}, 'goal': [2.0, 1.0],
        'state': {'position': [0.0, 0.0], 'rotation': [[1.0, 0.0], [0.0, 1.0]]},
        'approach': {'cone': 0.3, 'direction': [0.0, 1.0]},
    }  # fmt: skip
    assert case_of(case).problem.approach == NORTH
    assert constraints_in_force(case_of(case).problem, case_of(case).state) == ['approach.cone 0.3']
    for wrong in ({'direction': [0.0, 1.0]}, {'cone': 'x'}, {'cone': 0.3, 'direction': 'north'}):
        with pytest.raises(BadInput, match='approach'):
            case_of({**case, 'approach': wrong})


# --- catches


@needs_speed
def test_no_trajectory_catches_in_the_cone_before_the_bound():
    rng, found, later = np.random.default_rng(7), 0, 0
    approach = Approach(0.5, (np.cos(0.5), np.sin(0.5)))
    free = Stepped(WING, capture_radius=RADIUS)
    controller = Stepped(WING, capture_radius=RADIUS, approach=approach)
    headed = replace(WING, approach=approach)
    for _ in range(15):
        controller.reset()
        free.reset()
        place, course = rng.uniform([5.0, -25.0], [45.0, 25.0]), rng.uniform(-3.0, 3.0, 2)
        goals = place + 0.5 * np.arange(1, 9)[:, None] * course
        here = measured([0.0, 0.0], 0.3, 12.0)
        tick, any_way = controller.tick(here, goals), free.tick(here, goals)
        later += tick.catch.bound > any_way.catch.bound
        if not np.isnan(tick.catch.time):
            found += 1
            assert np.linalg.norm(tick.plan.positions[-1] - goals[tick.plan.horizon - 1]) <= RADIUS
            assert approach_margin(headed, tick.state, tick.plan.rotations[-1, :, 0]) > -1e-6
        else:
            assert 'approach: found no turn that meets the cone of a catch before' in tick.reason
        for _ in range(200):
            x = turned_at_random(rng, WING, tick.state)
            flown = trajectory_of(WING, tick.state, goals, x).positions[1:]
            near = np.linalg.norm(flown - goals, axis=1) <= RADIUS
            inside = [approach_margin(headed, tick.state, each) >= 0.0 for each in x]
            caught = np.flatnonzero(near & inside)
            assert not len(caught) or 0.5 * (caught[0] + 1) >= tick.catch.bound
    assert 3 < found < 15
    assert later


@needs_speed
def test_a_goal_is_flown_round_to_be_caught_as_it_is_turned():
    controller = Stepped(
        replace(WING, discretisation='exact'), capture_radius=RADIUS, approach=Approach(0.4)
    )
    goal, west = np.array([40.0, 5.0]), -np.eye(2)
    position, heading, course, caught = np.zeros(2), 0.0, np.array([12.0, 0.0]), []
    for k in range(80):
        tick = controller.tick(
            measured(position, heading, np.linalg.norm(course), 0.5 * k),
            np.tile(goal, (8, 1)),
            ahead=lambda times: np.tile(goal, (len(times), 1)),
            wanted=west,
        )
        assert tick.plan is not None
        heading += 0.5 * tick.command.body_rate[0]
        turned = 15.0 * tick.command.speed_fraction * np.array([np.cos(heading), np.sin(heading)])
        position, course = position + 0.25 * (course + turned), turned
        if np.linalg.norm(position - goal) <= RADIUS:
            caught.append(np.cos(heading) < -np.cos(0.4))
    assert any(caught)


@needs_speed
@pytest.mark.parametrize('seed', range(30))
def test_a_cone_and_a_limit_of_the_change_of_speed_hold_together(seed):
    """Whoever is brought into the cone at the end still changes speed as slowly as it must."""
    rng = np.random.default_rng(seed)
    limits = {'max_rate': 0.8, 'max_acceleration': 0.2, 'approach': Approach(0.25)}
    problem = Problem(horizon=3, step=0.5, floor=Floor('circle', fraction=0.5), **limits)
    heading, fraction = rng.uniform(-3.0, 3.0), rng.uniform(0.5, 1.0)
    attitude = exp(np.array([heading]))
    start = State.at(
        np.zeros(2),
        fraction * attitude,
        attitude=attitude,
        wanted=exp(np.array([heading + rng.uniform(-1.2, 1.2)])),
        commanded=fraction,
    )
    goals = np.cumsum(0.4 * rng.normal(size=(3, 2)), axis=0)
    plan = Solver(problem).solve(start, goals)  # each can: 1.2 rad in three turns of 0.4, and 0.25
    assert violations(problem, start, goals, plan) == []
