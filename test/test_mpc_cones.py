# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The cones of a descent: tilt and glide slope, kept by plans, priced, eased where they must be."""

import math
from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from plans import assembled, only_complaint, only_complaint_but_the_cost
from problems import goals, rotation
from stepping import Stepped

from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import BadInput, Infeasible
from orbimpc_ros.mpc.geometry.cells import cap_cells
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import carried, exp, turned_onto
from orbimpc_ros.mpc.plan import UNPROVED, assemble, shifted
from orbimpc_ros.mpc.problem import Box, Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.case import case_of
from orbimpc_ros.mpc.problem.cones import climb, relief, told
from orbimpc_ros.mpc.problem.feasibility import constraints_in_force
from orbimpc_ros.mpc.sensitivity.constraints import explained
from orbimpc_ros.mpc.solve.disjunction import shortfall
from orbimpc_ros.mpc.solve.solver import Solver

UP = np.array([0.0, 0.0, 1.0])
UPRIGHT = turned_onto(np.eye(3), UP)
WEIGHTS = Weights(position=0.3, input=0.05, length=0.3, terminal=1.0)
FLOOR = Floor('circle', 4, 0.3)


def lander(**changes):
    """A lander that falls with 1.62 m/s^2: eight steps of a second."""
    usual = {
        'dimension': 3,
        'translation_order': 2,
        'horizon': 8,
        'forward': 3.6,
        'weights': WEIGHTS,
        'discretisation': 'exact',
        'tilt': 0.2,
        'glide_slope': 0.6,
    }
    return Problem(**(usual | changes))


def falling(position, velocity=(0.0, 0.0, 0.0), attitude=UPRIGHT, fraction=0.45, **more):
    fallen = np.array([0.0, 0.0, -1.62])
    return State.at(
        position,
        fraction * attitude,
        velocity=velocity,
        attitude=attitude,
        disturbance=fallen,
        **more,
    )


def on(place, horizon=8):
    return np.tile(np.asarray(place, dtype=float), (horizon, 1))


PAD = on([0.0, 0.0, 0.0])


def tilts(plan):
    """Angles of the thrust axes from the vertical, of R_1..R_N [rad]."""
    axes = plan.rotations[1:, :, 0]
    return np.arctan2(np.hypot(axes[:, 0], axes[:, 1]), axes[:, 2])


def slopes(plan, places=PAD):
    """Angles at which s_1..s_N are seen from the goal, from the horizontal [rad]."""
    away = plan.positions[1:] - places
    return np.arctan2(away[:, 2], np.hypot(away[:, 0], away[:, 1]))


# --- what is refused, and what is not


@pytest.mark.parametrize(
    ('changes', 'line'),
    [
        ({'dimension': 2, 'translation_order': 1, 'tilt': 0.0}, 'glide_slope is 0.6'),
        ({'dimension': 2, 'glide_slope': 0.0}, 'tilt is 0.2'),
        ({'translation_order': 1}, 'tilt is 0.2; allowed: 0 at translation_order 1'),
        ({'tilt': 1.6}, 'tilt is 1.6'),
        ({'tilt': -0.1}, 'tilt is -0.1'),
        ({'glide_slope': 1.6}, 'glide_slope is 1.6'),
    ],
)
def test_cones_that_a_vehicle_cannot_have_are_refused_in_a_line(changes, line):
    with pytest.raises(BadInput) as caught:
        lander(**changes)
    assert line in str(caught.value)
    assert '\n' not in str(caught.value)


def test_files_and_reasons_know_the_cones():
    document = {
        'dimension': 3,
        'rotation_order': 1,
        'translation_order': 2,
        'horizon': 4,
        'step': 1.0,
        'forward': 3.6,
        'weights': {'terminal': 1.0},
        'tilt': 0.2,
        'glide_slope': 0.6,
        'state': {'position': [0, 0, 9], 'rotation': UPRIGHT.tolist()},
        'goal': [0, 0, 0],
    }
    problem = case_of(document).problem
    assert (problem.tilt, problem.glide_slope) == (0.2, 0.6)
    assert constraints_in_force(problem, State.at(np.zeros(3), np.eye(3))) == [
        'tilt 0.2',
        'glide_slope 0.6',
    ]


# --- plans


@pytest.mark.parametrize('floor', [Floor(), FLOOR])
@pytest.mark.parametrize('weight', [0.0, 0.05])
@pytest.mark.parametrize('max_rate', [0.0, 0.3])
def test_plans_keep_both_cones_at_every_step(floor, weight, max_rate):
    problem = lander(floor=floor, weights=replace(WEIGHTS, input=weight), max_rate=max_rate)
    start = falling([9.0, -7.0, 15.0], [1.0, 1.0, -2.0])
    free = Solver(replace(problem, tilt=0.0, glide_slope=0.0), gap_tolerance=1e-3)
    without = free.solve(start, PAD)
    assert tilts(without).max() > 0.25
    assert slopes(without).min() < 0.55
    plan = Solver(problem, gap_tolerance=1e-3).solve(start, PAD)
    assert plan.is_closed
    assert plan.proof.checked
    assert tilts(plan).max() <= 0.2 + 1e-5
    assert slopes(plan).min() >= 0.6 - 1e-5
    assert without.lower_bound <= plan.objective
    assert told(problem, PAD, plan) == ''


def test_plans_keep_the_tilt_beside_a_box():
    """The search for vehicles among boxes knows no cones: it leaves them to the general one."""
    box = Box(np.array([1.0, -1.0, -5.0]), np.array([2.0, 1.0, 5.0]))
    weights = Weights(position=1.0, input=0.05, terminal=10.0)
    problem = lander(glide_slope=0.0, weights=weights, obstacles=(box,))
    plan = Solver(problem).solve(falling(np.zeros(3)), on([4.0, 0.2, 0.0]))
    assert plan.gap <= 1e-4
    assert tilts(plan).max() <= 0.2 + 1e-6
    assert (box.clearances(plan.positions[1:]).max(axis=1) > -1e-5).all()


def test_a_vehicle_with_body_rates_keeps_them_from_the_first_step_that_it_can():
    """At rotation order 2 the state decides where R_1 points."""
    problem = lander(rotation_order=2)
    leaning = UPRIGHT @ exp(np.array([0.0, 0.5, 0.0]))
    sinking = [0.0, 0.0, -2.0]  # from rest, steps without thrust come, which has no direction
    start = falling([9.0, -7.0, 15.0], sinking, attitude=leaning, coasted=leaning)
    plan = Solver(problem, coasting=True).solve(start, PAD)
    assert tilts(plan)[1:].max() <= 0.2 + 1e-5
    assert relief(problem, start, PAD).tilt[0] > 0.1


def test_a_speed_has_a_glide_slope_too():
    smooth = Weights(position=0.0, input=3.0, terminal=1.0)
    problem = Problem(dimension=3, horizon=8, glide_slope=0.66, weights=smooth)
    start = State.at([9.0, 0.0, 8.3], turned_onto(np.eye(3), -UP))
    plan = Solver(problem).solve(start, PAD)
    assert plan.status == 'optimal'
    assert slopes(plan).min() >= 0.66 - 1e-5
    assert slopes(Solver(replace(problem, glide_slope=0.0)).solve(start, PAD)).min() < 0.65


@pytest.mark.parametrize('seed', range(3))
def test_the_optimum_is_that_of_a_program_written_down_by_itself(seed):
    """The oracle: the paper's steps one by one, norms as norms."""
    rng = np.random.default_rng(seed)
    problem = lander(discretisation='euler')
    start = falling(rng.uniform([-9, -9, 14], [9, 9, 20]), rng.uniform(-1.5, 1.5, 3))
    r = [cp.Variable((3, 3)) for _ in range(9)]
    s, p = [start.position], [start.velocity]
    for k in range(8):
        s.append(s[k] + p[k])
        p.append(p[k] + 3.6 * r[k][:, 0] + start.disturbance)
    cost = sum(0.3 * cp.sum_squares(place) for place in s[1:]) + cp.sum_squares(s[-1])
    cost += 0.05 * sum(cp.sum_squares(r[k + 1] - r[k]) for k in range(8))
    cost += 0.3 * 3.6 * sum(cp.norm(r[k][:, 0]) for k in range(8))
    rows = [r[0] == start.rotation]
    for k in range(1, 9):
        rows += [cp.norm(r[k][:, 0]) * math.cos(0.2) <= r[k][2, 0]]
        rows += [cp.norm(s[k][:2]) * math.tan(0.6) <= s[k][2]]
        x = r[k]
        m = [
            [
                1 + x[0, 0] + x[1, 1] + x[2, 2],
                x[2, 1] - x[1, 2],
                x[0, 2] - x[2, 0],
                x[1, 0] - x[0, 1],
            ],
            [
                x[2, 1] - x[1, 2],
                1 + x[0, 0] - x[1, 1] - x[2, 2],
                x[1, 0] + x[0, 1],
                x[0, 2] + x[2, 0],
            ],
            [
                x[0, 2] - x[2, 0],
                x[1, 0] + x[0, 1],
                1 - x[0, 0] + x[1, 1] - x[2, 2],
                x[2, 1] + x[1, 2],
            ],
            [
                x[1, 0] - x[0, 1],
                x[0, 2] + x[2, 0],
                x[2, 1] + x[1, 2],
                1 - x[0, 0] - x[1, 1] + x[2, 2],
            ],
        ]
        rows.append(cp.bmat(m) >> 0)
    assert not relief(problem, start, PAD).slope.any()
    expected = cp.Problem(cp.Minimize(cost), rows).solve(solver=cp.CLARABEL)
    plan = Solver(problem).solve(start, PAD)
    assert plan.status == 'optimal'
    assert plan.objective == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize('weight', [0.0, 0.05])
def test_no_trajectory_above_the_least_thrust_costs_less_than_the_bound(weight):
    """Of legal trajectories, the plan's neighbours too: drawn, and kept if they pass the check."""
    problem = lander(floor=FLOOR, weights=replace(WEIGHTS, input=weight))
    start, rng = falling([2.0, 1.0, 20.0], [0.0, 0.5, -1.0]), np.random.default_rng(3)
    plan = Solver(problem, gap_tolerance=1e-3).solve(start, PAD)
    assert plan.status == 'optimal'
    legal = 0
    for _ in range(100):
        share, weight = rng.uniform(0.4, 0.9, (8, 1, 1)), rng.uniform(0.5, 1.0)
        hovering = share * UPRIGHT @ exp(0.1 * rng.normal(size=3))
        moved = weight * plan.rotations[1:] + (1.0 - weight) * hovering
        other = assembled(problem, start, PAD, coordinates(moved))
        if not violations(problem, start, PAD, other):
            legal += 1
            assert other.objective >= plan.lower_bound
    assert legal > 10


# --- from a state that is outside


@pytest.mark.parametrize('rotation_order', [1, 2])
@pytest.mark.parametrize('max_rate', [0.0, 0.4])
@pytest.mark.parametrize('floor', [Floor(), FLOOR, Floor('polygon', 12, 0.5)])
@pytest.mark.parametrize('translation_order', [1, 2])
def test_a_climb_is_legal_from_anywhere(rotation_order, max_rate, floor, translation_order):
    """Which is why there is a plan from anywhere: below the goal, upside down, on the way out."""
    rng = np.random.default_rng(5)
    problem = lander(
        rotation_order=rotation_order,
        translation_order=translation_order,
        max_rate=max_rate,
        floor=floor,
        tilt=0.2 if translation_order == 2 else 0.0,
    )
    for _ in range(10):
        start = anywhere(rng, problem)
        targets = goals(rng, problem)
        x = coordinates(climbing(problem, start, targets))
        plan = assemble(problem, start, targets, x, projection='thrust_aligned', proof=UNPROVED)
        assert violations(problem, start, targets, plan) == []


def anywhere(rng, problem):
    attitude = rotation(rng, 3, 2.5)
    turned = attitude @ exp(rng.uniform(-0.2, 0.2, size=3))
    second = problem.translation_order == 2
    return State.at(
        rng.normal(scale=8.0, size=3),
        rng.uniform(0.3, 1.0) * attitude,
        velocity=rng.normal(scale=3.0, size=3) if second else None,
        attitude=attitude,
        coasted=turned if problem.rotation_order == 2 else None,
        disturbance=np.array([0.1, 0.0, -1.0]),
    )


def climbing(problem, start, targets):
    """R_1..R_N of a climb; at order 2 the coasted rotation first."""
    headings = climb(problem, start, targets)[1:]
    begin = start.attitude if problem.rotation_order == 1 else start.coasted
    return carried(begin, headings)


@pytest.mark.parametrize('seed', range(8))
def test_no_state_is_infeasible_for_it(seed):
    rng = np.random.default_rng(seed)
    problem = lander(floor=FLOOR)
    start = anywhere(rng, problem)
    plan = Solver(problem, gap_tolerance=1e-3).solve(start, PAD)
    assert plan.status == 'optimal'
    assert violations(problem, start, PAD, plan) == []


@pytest.mark.parametrize('tilt', [0.1, 0.2618, 0.5])
def test_a_climb_that_leans_as_far_as_it_may_eases_nothing(tilt):
    """Whichever way it leans: on the cone's side, rounding leads in or out."""
    problem, rng = lander(tilt=tilt), np.random.default_rng(1)
    for _ in range(30):
        start = falling([9.0, -7.0, 60.0], rng.uniform([4.0, -9.0, 0.0], [9.0, -4.0, 1.0]))
        leaning = climb(problem, start, PAD)[1]
        assert math.acos(leaning[2]) == pytest.approx(tilt)
        assert not relief(problem, start, PAD).tilt.any()


def test_what_is_outside_comes_back_in_and_it_is_said():
    """Beside the pad and below the slope, descending; tilted by 60 degrees."""
    problem = lander(floor=FLOOR, max_rate=0.3)
    leaning = UPRIGHT @ exp(np.array([0.0, math.pi / 3.0, 0.0]))
    start = falling([6.0, 0.0, 2.0], [0.0, 0.0, -1.0], attitude=leaning)
    plan = Solver(problem, gap_tolerance=1e-3).solve(start, PAD)
    turning = np.maximum(math.pi / 3.0 - 0.3 * np.arange(1, 9), 0.2)
    assert (tilts(plan) <= turning + 1e-5).all()
    words = told(problem, PAD, plan)
    assert 'tilted too far until step 2' in words
    assert 'm outside the glide slope until step' in words
    inside = np.flatnonzero(relief(problem, start, PAD).slope == 0.0)
    assert inside.size
    assert slopes(plan)[inside].min() >= 0.6 - 1e-5


def test_a_tick_says_that_its_plan_has_to_be_outside():
    problem = lander(floor=FLOOR)
    controller = Stepped(problem, gap_tolerance=1e-3, disturbance=np.array([0.0, 0.0, -1.62]))
    below = Odometry(0.0, np.array([6.0, 0.0, 2.0]), UPRIGHT, np.zeros(3), np.zeros(3))
    tick = controller.tick(below, PAD)
    assert (tick.status, tick.fallback) == ('optimal', '')
    assert 'outside the glide slope until step' in tick.reason


def test_an_arrival_that_became_impossible_as_time_ran_out_goes_on_as_planned():
    """Rather than by a climb, which passes the check as well and leads away."""
    problem = lander(floor=FLOOR, terminal='constraint', horizon=12)
    pushed = np.array([0.0, 0.0, -1.62])
    controller = Stepped(problem, shrinking=True, gap_tolerance=1e-3, disturbance=pushed)
    places = on([0.0, 0.0, 0.0], 12)
    at = Odometry(0.0, np.array([3.0, 0.0, 30.0]), UPRIGHT, np.array([-3.0, 0.0, 0.0]), np.zeros(3))
    tick = controller.tick(at, places)
    for k in range(1, 6):  # and then 25 m too high to arrive
        place = tick.plan.positions[1] + (k == 5) * np.array([0.0, 0.0, 25.0])
        attitude = tick.plan.projected[1]
        velocity = attitude.T @ tick.plan.velocities[1]
        at = Odometry(float(k), place, attitude, velocity, np.zeros(3))
        tick = controller.tick(at, places[k:], (lambda: True) if k == 5 else None)
    assert tick.fallback == 'soft arrival'
    assert np.linalg.norm(tick.plan.positions[-1]) == pytest.approx(25.0, abs=1e-3)


def test_a_descent_begins_with_the_nearest_arrival_where_there_is_none():
    """To wait for one is to fall."""
    problem = lander(floor=FLOOR, terminal='constraint')
    pushed = np.array([0.0, 0.0, -1.62])
    controller = Stepped(problem, shrinking=True, gap_tolerance=1e-3, disturbance=pushed)
    high = Odometry(0.0, np.array([3.0, 0.0, 90.0]), UPRIGHT, np.zeros(3), np.zeros(3))
    tick = controller.tick(high, PAD)
    assert (tick.status, tick.fallback) == ('infeasible', 'soft arrival')
    assert tick.plan.gap < 1e-3


def test_the_rest_of_a_plan_keeps_the_least_thrust_where_a_share_of_a_step_has_passed():
    """Between two directions of the least thrust a chord leads below it."""
    problem = lander(floor=FLOOR, tilt=0.0, glide_slope=0.0)
    start = falling([0.0, 0.0, 30.0], fraction=0.3)
    turns = np.array([UPRIGHT @ exp(np.array([0.0, 0.1 * k, 0.0])) for k in range(1, 9)])
    plan = assembled(problem, start, PAD, coordinates(0.3 * turns))
    rest = shifted(problem, start, PAD, plan, 0.5 + np.arange(1, 9), projection='thrust_aligned')
    assert violations(problem, start, PAD, rest) == []
    assert rest.speed_fraction[1:] == pytest.approx(0.3)


# --- the check


def test_the_check_sees_a_plan_that_leans_too_far():
    start = falling([9.0, -7.0, 15.0], [1.0, 1.0, -2.0])
    plan = Solver(lander(tilt=0.0)).solve(start, PAD)
    assert 'tilt violated by' in only_complaint(lander(), plan, start, PAD)


def test_the_check_sees_a_plan_below_the_glide_slope():
    start = falling([9.0, -7.0, 15.0], [1.0, 1.0, -2.0])
    plan = Solver(lander(glide_slope=0.0)).solve(start, PAD)
    assert 'glide_slope violated by' in only_complaint(lander(), plan, start, PAD)


def test_the_check_allows_rounding_in_proportion_to_a_step():
    """Of a glide slope: lengths to 1e-6 of what a step moves the vehicle."""
    problem = lander(tilt=0.0)
    start = falling([9.0, -7.0, 15.0], [1.0, 1.0, -2.0])
    plan = Solver(problem).solve(start, PAD)
    lowered = PAD + np.array([0.0, 0.0, 1.0]) * (1e-5 / math.cos(0.6))
    assert 'glide_slope' in only_complaint_but_the_cost(problem, plan, start, lowered)


# --- prices


@pytest.mark.parametrize('name', ['tilt', 'glide_slope'])
@pytest.mark.parametrize('weight', [0.0, 0.05])
def test_a_price_is_what_easing_a_cone_saves(name, weight):
    problem = lander(weights=replace(WEIGHTS, input=weight))
    start, eps = falling([9.0, -7.0, 15.0], [1.0, 1.0, -2.0]), 1e-4
    best = Solver(problem, gap_tolerance=1e-7).solve(start, PAD)
    found = explained(problem, start, PAD, best)
    assert found.unexplained < 1e-3
    price = sum(each.price for each in found.binding if each.name == name)
    sign = 1.0 if name == 'tilt' else -1.0
    eased = replace(problem, **{name: getattr(problem, name) + sign * eps})
    saved = best.objective - Solver(eased, gap_tolerance=1e-7).solve(start, PAD).objective
    assert price > 0.1
    assert saved / eps == pytest.approx(price, rel=0.02)


def test_an_arrival_that_no_descent_makes_is_still_proved_infeasible():
    problem = lander(terminal='constraint', floor=FLOOR)
    with pytest.raises(Infeasible, match='beyond what 8 steps can reach'):
        Solver(problem).solve(falling([0.0, 0.0, 500.0]), PAD)


# --- the search


def test_the_patches_of_a_cap_cover_it_at_every_level():
    rng = np.random.default_rng(2)
    for tilt in (0.05, 0.2618, 1.0):
        angles, around = tilt * np.sqrt(rng.uniform(0, 1, 500)), rng.uniform(0, 2 * np.pi, 500)
        angles[:50] = tilt
        across = np.column_stack([np.cos(around), np.sin(around)]) * np.sin(angles)[:, None]
        axes = 0.3 * np.column_stack([across, np.cos(angles)])
        cells = cap_cells(tilt, 0.3)
        for _ in range(3):
            assert (shortfall(cells, axes).min(axis=0) <= 1e-12).all()
            cells = tuple(part for cell in cells for part in cell.parts())


def test_a_descent_that_leans_at_the_least_thrust_is_searched_to_its_optimum():
    """Where the relaxation is below the floor: too much thrust to come down in time, and aside."""
    problem = lander(
        floor=FLOOR,
        horizon=6,
        weights=Weights(position=1.0, input=0.05, length=0.0, terminal=1.0),
        glide_slope=0.0,
        tilt=0.6,
    )
    start, places = falling([6.0, 2.0, 40.0], fraction=0.3), on([0.0, 0.0, 0.0], 6)
    found = Solver(problem, gap_tolerance=1e-4).solve(start, places)
    assert found.status == 'optimal'
    assert found.nodes > 1
    wide = Solver(replace(problem, tilt=1.5), gap_tolerance=1e-3).solve(start, places)
    assert wide.lower_bound <= found.objective
