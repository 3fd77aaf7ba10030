# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Limits of turns, speeds, approaches and descents, in plans and in commands."""

import math
from dataclasses import replace

import numpy as np
import pytest
from oracles import convex
from plans import assembled
from problems import (
    FALLING,
    UPRIGHT,
    falling,
    floor,
    goals,
    lander,
    needs_machine_code,
    rotation,
    state,
)
from stepping import Stepped, odometry

from orbimpc_ros.loop.planner import Snapshot
from orbimpc_ros.mpc.check import approach_margin, command_violations, flaw, violations
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.rotations import carried, coordinates, exp, turned_onto
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.mpc.plan import UNPROVED, Command, assemble, command_of
from orbimpc_ros.mpc.problem import Approach, Ball, Floor, MovingObstacle, Problem, State, Weights
from orbimpc_ros.mpc.problem.cones import climb, cone_violations, relief
from orbimpc_ros.mpc.problem.problem import SLOWEST
from orbimpc_ros.mpc.problem.reach import clear_of_hazards, entry_speed
from orbimpc_ros.mpc.solve.request import Enough
from orbimpc_ros.mpc.solve.solver import Solver

# --- turns


@needs_machine_code
def test_a_search_ends_with_what_is_enough_and_its_bound_holds():
    rng, sooner = np.random.default_rng(23), {'cost': 0, 'bound': 0}
    for _ in range(20):
        problem = Problem(horizon=12, floor=floor('circle', 0.6), max_rate=0.3)
        start = state(rng, problem, full_speed=False)
        targets = goals(rng, problem, 6.0)
        whole = Solver(problem).solve(start, targets)
        for name in sooner:
            settled = 1.5 * whole.objective if name == 'cost' else 0.5 * whole.objective
            plan = Solver(problem, enough=Enough(**{name: settled})).solve(start, targets)
            assert plan.lower_bound <= whole.objective * (1.0 + 1e-9)
            assert plan.objective >= whole.lower_bound * (1.0 - 1e-9)
            if plan.gap > 1e-4:  # the search has ended early
                sooner[name] += plan.proof.nodes < whole.proof.nodes
                assert plan.objective <= settled if name == 'cost' else plan.lower_bound > settled
    assert min(sooner.values()) > 1


# --- the approach


def test_a_heading_that_vanishes_has_no_direction():
    problem = Problem(approach=Approach(0.3, (0.0, 1.0)))
    start = State.at(np.zeros(2), np.eye(2))
    found = approach_margin(problem, start, np.outer([0.0, SLOWEST, 1.0, -1.0], [0.0, 1.0]))
    least, cosine = np.array([SLOWEST, SLOWEST, 1.0, 1.0]), math.cos(0.3)
    assert found.min(axis=1) == pytest.approx([0.0, SLOWEST, 1.0, -1.0] - cosine * least)


def test_a_floor_that_leaves_headings_without_direction_leaves_none_at_an_approach():
    limits = {'max_rate': 0.5, 'approach': Approach(0.1, (-1.0, 0.0))}
    problem = Problem(horizon=3, floor=Floor('circle', fraction=0.5 * SLOWEST), **limits)
    start = State.at(np.zeros(2), -0.5 * SLOWEST * np.eye(2), attitude=-np.eye(2))
    plan = Solver(problem).propose(start, np.zeros((3, 2)))  # the solver's own plan, not a fallback
    assert violations(problem, start, np.zeros((3, 2)), plan) == []


@pytest.mark.parametrize('n', [2, 3])
def test_a_plan_that_ends_out_of_the_cone_fails_the_check(n):
    rng = np.random.default_rng(n)
    problem = Problem(n, horizon=4)
    start, targets = state(rng, problem), goals(rng, problem)
    plan = Solver(problem).solve(start, targets)
    heading = plan.rotations[-1, :, 0]
    across = rotation(rng, n) @ heading
    across -= heading * (across @ heading) / (heading @ heading)
    for angle, allowed in ((0.29, True), (0.31, False), (2.5, False)):
        along = np.cos(angle) * heading / np.linalg.norm(heading)
        axis = along + np.sin(angle) * across / np.linalg.norm(across)
        coned = replace(problem, approach=Approach(0.3, tuple(axis.tolist())))
        flaws = violations(coned, start, targets, plan)
        assert any('approach' in flaw for flaw in flaws) != allowed


# --- changes of speed


def test_what_is_surely_out_of_reach_is_left_out_of_the_search():
    problem, wanted = Problem(horizon=5), State.at([0.0, 0.0], np.eye(2))
    moving = [MovingObstacle.drifting(Ball([7.0, 0.0], 1.0), [v, 0.0]) for v in (0.0, -0.15, -0.25)]
    found = [clear_of_hazards(problem, replace(wanted, hazards=(each,))) for each in moving]
    assert [len(each.hazards) for each in found] == [0, 0, 1]  # reach 5 m, against 6 m less its way
    near, far = moving[2], moving[0]
    assert len(clear_of_hazards(problem, replace(wanted, hazards=(far, near))).hazards) == 2
    grown = replace(far, reserve=1.1)
    assert len(clear_of_hazards(problem, replace(wanted, hazards=(grown,))).hazards) == 1


def test_changes_count_from_what_was_commanded_and_from_the_floor_up():
    problem = Problem(max_acceleration=0.1, floor=floor('circle', 0.5))
    assert entry_speed(problem, State.at([0.0, 0.0], 0.8 * np.eye(2))) == pytest.approx(0.8)
    commanded = State.at([0.0, 0.0], 0.8 * np.eye(2), commanded=0.6)
    assert entry_speed(problem, commanded) == 0.6
    assert entry_speed(problem, State.at([0.0, 0.0], 0.1 * np.eye(2))) == 0.5
    plan = Solver(problem).solve(State.at([0.0, 0.0], 0.1 * np.eye(2)), np.ones((5, 2)))
    assert 0.5 - 1e-6 <= plan.speed_fraction[1] <= 0.6 + 1e-6


@pytest.mark.parametrize('n', [2, 3])
def test_an_arrival_at_speeds_that_change_little_is_along_other_directions(n):
    problem = Problem(n, horizon=3, terminal='constraint', max_acceleration=0.2)
    start, targets = State.at(np.zeros(n), 1e-3 * np.eye(n)), np.zeros((3, n))
    targets[:2, 1], targets[2, 0] = 2.0, 0.4  # the earlier goals are far to the side
    assert not violations(problem, start, targets, Solver(problem).solve(start, targets))


def test_the_last_look_refuses_a_jump_of_speed():
    problem = Problem(max_acceleration=0.1)
    for fraction, entry, fine in ((0.6, 0.5, True), (0.61, 0.5, False), (0.39, 0.5, False)):
        command = Command(fraction, np.zeros(1), np.eye(2))
        assert (flaw(problem, command, entry=entry) == '') is fine
        assert flaw(problem, command, entry=entry, stopping=True) == ''
        assert flaw(replace(problem, max_acceleration=0.0), command, entry=entry) == ''


def test_a_speed_that_a_cut_turn_reduces_is_not_reduced_faster_than_allowed():
    problem = Problem(max_rate=0.5, max_acceleration=0.05)
    start = State.at([0.0, 0.0], 0.3 * np.eye(2))
    plan = assembled(problem, start, np.ones((5, 2)), np.tile([0.02, 0.3], (5, 1)))
    command = command_of(problem, start, plan)
    assert command.speed_fraction == pytest.approx(0.25)
    assert command_violations(problem, plan, command, 0.3) == []
    assert command_violations(problem, plan, replace(command, speed_fraction=0.15), 0.3) != []


@pytest.mark.parametrize('period', [1.0, 0.25])
@pytest.mark.parametrize('kind', ['loiter', 'hold_rate_zero', 'stop'])
def test_safe_commands_change_speed_as_plans_do_but_for_a_stop(kind, period):
    problem = Problem(max_acceleration=0.1, floor=floor('circle', 0.5))
    controller = Stepped(problem, safe=kind)
    ahead = np.tile([9.0, 0.0], (5, 1))
    first = controller.tick(odometry([0.0, 0.0], 0.0, 1.0), ahead).command.speed_fraction
    lost, found = Reason(Cause.ODOMETRY, 'lost'), []
    for time in np.arange(0.0, 8.0, period):
        command = controller.step(Snapshot(stop=lost), time).command
        controller.sent(command, time)
        found.append(command.speed_fraction)
    if kind == 'stop':
        assert found == [0.0] * len(found)
    else:
        assert abs(found[0] - first) <= 0.1 + 1e-9
        assert np.abs(np.diff(found)).max() <= 0.1 * period + 1e-9
        assert found[-1] == pytest.approx(0.5 if kind == 'loiter' else first)
        fresh = Stepped(problem, safe=kind)  # at once up to the floor
        assert fresh.safe(np.eye(2), lost).command.speed_fraction == pytest.approx(0.5)


def test_the_plan_after_a_stop_goes_on_from_the_speed_that_is_left():
    controller = Stepped(Problem(step=0.1, forward=15.0, max_rate=0.3, max_acceleration=3.0))
    ahead = np.tile([20.0, 0.0], (5, 1))
    controller.tick(odometry(speed=15.0), ahead)
    controller.safe(np.eye(2), Reason(Cause.DISABLED, 'a stop'))
    assert controller.tick(odometry(speed=14.7, time=0.2), ahead).plan is not None


# --- descents

UP = np.array([0.0, 0.0, 1.0])
THRUST = Floor('circle', 4, 0.3)
PAD = np.zeros((8, 3))


def tilts(plan):
    """Return the angles of the thrust axes of R_1..R_N from the vertical [rad]."""
    axes = plan.rotations[1:, :, 0]
    return np.arctan2(np.hypot(axes[:, 0], axes[:, 1]), axes[:, 2])


def slopes(plan):
    """Return the elevation angles of s_1..s_N as seen from the goal [rad]."""
    away = plan.positions[1:]
    return np.arctan2(away[:, 2], np.hypot(away[:, 0], away[:, 1]))


@pytest.mark.parametrize('floor', [Floor(), THRUST])
@pytest.mark.parametrize('weight', [0.0, 0.05])
def test_plans_keep_both_cones_at_every_step_and_the_check_sees_those_that_do_not(floor, weight):
    problem = lander(floor=floor)
    problem = replace(problem, weights=replace(problem.weights, input=weight))
    start = falling([9.0, -7.0, 15.0], [1.0, 1.0, -2.0])
    free = replace(problem, tilt=0.0, glide_slope=0.0)
    without = Solver(free, gap_tolerance=1e-3).solve(start, PAD)
    found = ' '.join(violations(problem, start, PAD, without))
    assert 'tilt violated by' in found
    assert 'glide_slope violated by' in found
    plan = Solver(problem, gap_tolerance=1e-3 if floor.exists else 1e-6).solve(start, PAD)
    assert plan.status == 'optimal'
    assert floor.exists or plan.objective == pytest.approx(convex(problem, start, PAD), rel=1e-5)
    assert tilts(plan).max() <= 0.2 + 1e-5
    assert slopes(plan).min() >= 0.6 - 1e-5
    assert without.lower_bound <= plan.objective
    assert cone_violations(problem, PAD, plan) == ''
    raised = PAD + UP * (1e-4 / math.cos(0.6))  # tolerance: 1e-6 of the length of a step
    assert 'glide_slope violated by' in ' '.join(violations(problem, start, raised, plan))


def test_a_vehicle_with_body_rates_keeps_them_from_the_first_step_that_it_can():
    """At rotation order 2 the state decides the direction of R_1, so that R_2 is the first one."""
    problem, leaning = lander(rotation_order=2), UPRIGHT @ exp(np.array([0.0, 0.5, 0.0]))
    sinking = [0.0, 0.0, -2.0]  # from rest, some steps would have neither thrust nor direction
    start = falling([9.0, -7.0, 15.0], sinking, attitude=leaning, coasted=leaning)
    plan = Solver(problem, coasting=True).solve(start, PAD)
    assert tilts(plan)[1:].max() <= 0.2 + 1e-5
    assert relief(problem, start, PAD).tilt[0] > 0.1


def test_a_speed_has_a_glide_slope_too():
    smooth = Weights(position=0.0, input=3.0, terminal=1.0)
    problem = Problem(dimension=3, horizon=8, glide_slope=0.66, weights=smooth)
    start = State.at([9.0, 0.0, 8.3], turned_onto(np.eye(3), -UP))
    assert slopes(Solver(problem).solve(start, PAD)).min() >= 0.66 - 1e-5
    assert slopes(Solver(replace(problem, glide_slope=0.0)).solve(start, PAD)).min() < 0.65


def anywhere(rng, problem):
    attitude = rotation(rng, 3, 2.5)
    return State.at(
        rng.normal(scale=8.0, size=3),
        rng.uniform(0.3, 1.0) * attitude,
        velocity=rng.normal(scale=3.0, size=3) if problem.inertial else None,
        attitude=attitude,
        coasted=attitude @ exp(rng.uniform(-0.2, 0.2, size=3)),
        disturbance=np.array([0.1, 0.0, -1.0]),
    )


@pytest.mark.parametrize('rotation_order', [1, 2])
@pytest.mark.parametrize('max_rate', [0.0, 0.4])
@pytest.mark.parametrize('floor', [Floor(), THRUST, Floor('polygon', 12, 0.5)])
@pytest.mark.parametrize('translation_order', [1, 2])
def test_a_climb_is_legal_from_anywhere(rotation_order, max_rate, floor, translation_order):
    """Hence a plan exists from every state: below the goal, upside down, or flying away."""
    rng, orders = np.random.default_rng(5), {'rotation_order': rotation_order}
    orders |= {'translation_order': translation_order, 'tilt': 0.2 * (translation_order == 2)}
    problem = lander(max_rate=max_rate, floor=floor, **orders)
    for _ in range(10):
        start, targets = anywhere(rng, problem), goals(rng, problem)
        begin = start.attitude if rotation_order == 1 else start.coasted
        x = coordinates(carried(begin, climb(problem, start, targets)[1:]))
        plan = assemble(problem, start, targets, x, projection='thrust_aligned', proof=UNPROVED)
        assert violations(problem, start, targets, plan) == []


@pytest.mark.parametrize('tilt', [0.1, 0.2618, 0.5])
def test_a_climb_that_leans_as_far_as_it_may_eases_nothing(tilt):
    """In every direction: on the cone's boundary, rounding may lead outside."""
    problem, rng = lander(tilt=tilt), np.random.default_rng(1)
    for _ in range(30):
        start = falling([9.0, -7.0, 60.0], rng.uniform([4.0, -9.0, 0.0], [9.0, -4.0, 1.0]))
        assert math.acos(climb(problem, start, PAD)[1, 2]) == pytest.approx(tilt)
        assert not relief(problem, start, PAD).tilt.any()


def test_what_is_outside_comes_back_in_and_it_is_said():
    """From beside the pad, below the slope and descending, with a tilt of 60 degrees."""
    problem = lander(floor=THRUST, max_rate=0.3)
    leaning = UPRIGHT @ exp(np.array([0.0, math.pi / 3.0, 0.0]))
    start = falling([6.0, 0.0, 2.0], [0.0, 0.0, -1.0], attitude=leaning)
    plan = Solver(problem, gap_tolerance=1e-3).solve(start, PAD)
    turning = np.maximum(math.pi / 3.0 - 0.3 * np.arange(1, 9), 0.2)
    assert (tilts(plan) <= turning + 1e-5).all()
    words = cone_violations(problem, PAD, plan)
    assert 'tilted too far until step 2' in words
    assert 'm outside the glide slope until step' in words
    inside = np.flatnonzero(relief(problem, start, PAD).slope == 0.0)
    assert inside.size
    assert slopes(plan)[inside].min() >= 0.6 - 1e-5
    controller = Stepped(lander(floor=THRUST), gap_tolerance=1e-3, disturbance=FALLING)
    tick = controller.tick(odometry((6.0, 0.0, 2.0), UPRIGHT, 0.0), PAD)
    assert tick.fallback == ''
    assert tick.status == 'optimal'
    assert 'outside the glide slope until step' in tick.reason


def test_a_descent_begins_with_the_nearest_arrival_where_there_is_none():
    """Waiting until an arrival is feasible would mean falling."""
    problem = lander(floor=THRUST, terminal='constraint')
    with pytest.raises(Infeasible, match='beyond what 8 steps can reach'):
        Solver(problem).solve(falling([0.0, 0.0, 500.0]), PAD)
    controller = Stepped(problem, shrinking=True, gap_tolerance=1e-3, disturbance=FALLING)
    tick = controller.tick(odometry((3.0, 0.0, 90.0), UPRIGHT, 0.0), PAD)
    assert (tick.status, tick.fallback) == ('infeasible', 'soft arrival')
    assert tick.plan.gap < 1e-3
