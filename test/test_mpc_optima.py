# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Optima agree with those of independent solvers, and fallback plans are labelled as such."""

from dataclasses import replace

import numpy as np
import pytest
from oracles import convex, enumerated
from problems import (
    ANSWERS,
    CASES,
    FAMILIES,
    OPEN,
    box,
    case,
    disturbed,
    floor,
    goals,
    needs_machine_code,
    polled,
    reference,
    state,
    weights,
)

from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Approach, Box, Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.problem.problem import weighed
from orbimpc_ros.mpc.solve.regions import Regions
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Solver

BEST_KNOWN = ('uav_circle', 'uav_unit', 'dubins_circle')  # feasible values, not proved optimal


@pytest.mark.parametrize('name', CASES)
def test_the_papers_problems_have_their_known_optima(name):
    problem, start, targets = reference(name).parts
    plan = Solver(problem).solve(start, targets)
    answer = ANSWERS[name]['objective']
    assert plan.is_closed
    # With a weight on fuel, a cone program's plans are too inaccurate for a certificate.
    assert plan.proof.checked or (name == 'spacecraft_fuel0.1' and not COMPILED)
    assert plan.gap <= 1e-4 or not plan.proof.checked
    assert violations(problem, start, targets, plan) == []
    if name.startswith('uav_unit'):
        assert np.allclose(plan.speed_fraction[1:], 1.0, atol=1e-9)
    if name.startswith(BEST_KNOWN):
        assert plan.objective <= answer * (1 + 1e-6)
        assert plan.lower_bound <= answer * (1 + 1e-4)
    else:
        assert plan.objective == pytest.approx(answer, rel=1e-5)


def test_the_papers_minute_long_problem_is_proved():
    """Dubins, N = 20, det R >= 1/2 as a square, path length only: no input weight."""
    problem, start, targets = reference('dubins_square').parts
    pure = replace(problem, weights=replace(problem.weights, input=0.0))
    plan = Solver(pure).solve(start, targets)
    assert plan.status == 'optimal'
    assert plan.objective < 14.46


# --- convex problems

CHOICES = ('polygon', 'circle', 'shell', 'solid', 'boxes', 'discs', 'cones', 'acceleration')
CONVEX = [each for each in FAMILIES if not any(word in each for word in CHOICES)]


@pytest.mark.parametrize('seed', range(2))
@pytest.mark.parametrize('family', CONVEX)
def test_convex_optima_are_those_of_another_formulation(family, seed):
    problem, start, targets = case(family, seed, longest=6).parts
    start = replace(start, rotation=(1.0 - 0.4 * seed) * start.rotation)
    solver = Solver(problem, gap_tolerance=1e-6, coasting=start.coasted is not None, patient=True)
    try:
        plan = solver.solve(start, targets)
    except Infeasible:  # possible for arrivals from a lower speed
        assert seed
        return
    assert plan.is_closed, plan.proof.reason
    assert plan.objective == pytest.approx(convex(problem, start, targets), rel=1e-5)


@pytest.mark.parametrize(('horizon', 'order'), [(1, 1), (2, 1), (45, 1), (55, 2), (59, 2)])
def test_long_and_short_horizons_are_solved_as_well(horizon, order):
    rng, step = np.random.default_rng(4), 0.2 if order == 1 else 1.0
    known = {'horizon': horizon, 'step': step, 'translation_order': order}
    problem = Problem(**known, weights=Weights(attitude=2.0))
    start, targets = disturbed(rng, problem), goals(rng, problem, distance=3.0 * horizon)
    plan = Solver(problem, gap_tolerance=1e-7).solve(start, targets)
    assert plan.objective == pytest.approx(convex(problem, start, targets), rel=2e-6)


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('distance', [0.0, 1e3, 1e6, 1e8])
def test_goals_out_of_all_proportion_are_no_trouble(n, distance):
    problem = Problem(n, horizon=5, forward=20.0)
    start = state(np.random.default_rng(3), problem)
    way = np.full(n, 1.0 / np.sqrt(n))
    plan = Solver(problem).solve(start, np.tile(start.position + distance * way, (5, 1)))
    assert plan.status == 'optimal'
    if distance:
        assert np.allclose(plan.rotations[1, :, 0], way, atol=0.03)


# --- choices


def of_choices(seed, n, shape, boxes, sharing, horizon):
    """Return a case with boxes ahead, a goal near them, and random weights."""
    rng = np.random.default_rng(seed)
    problem = Problem(n, horizon=horizon, floor=shape, weights=weights(rng))
    start = state(rng, problem)
    middle = start.position + start.rotation[:, 0] * 1.9
    obstacles = tuple(box(rng, n, middle) for _ in range(boxes))
    problem = replace(problem, obstacles=obstacles, no_corner_cutting=sharing)
    return Case(problem, start, np.tile(middle + 0.3 * rng.normal(size=n), (horizon, 1)))


def exchangeable(seed):
    """Return an arrival that costs only length: the order of its steps does not matter."""
    rng = np.random.default_rng(seed)
    alone = Weights(position=0.0, input=0.0, length=1.0, terminal=0.0)
    shape = floor('polygon', 0.6, int(rng.integers(4, 6)))
    problem = Problem(horizon=3, terminal='constraint', floor=shape, weights=alone)
    start = state(rng, problem)
    beyond = start.position + start.rotation[:, 0] + rng.uniform(-1.3, 1.3, size=2)
    return Case(problem, start, np.tile(beyond, (3, 1)))


def weighed_apart(seed):
    """Return a case with weights over twelve orders of magnitude, half without an input weight."""
    rng = np.random.default_rng(seed)
    chosen = Weights(*10.0 ** rng.uniform(-6, 6, 2), 0.0, 10.0 ** rng.uniform(-6, 6))
    chosen = replace(chosen, input=[chosen.input, 0.0][seed % 2])
    problem = Problem(horizon=2, floor=floor('polygon', 0.6, 4), weights=chosen)
    return Case(problem, state(rng, problem), goals(rng, problem, distance=1.0))


BRANCHING = [
    *(of_choices(seed, 2, floor('polygon', 0.5, 4), 0, False, 3) for seed in range(3)),
    *(of_choices(seed, 2, floor('polygon', 0.4, 3), 0, False, 3) for seed in range(3)),
    *(of_choices(seed, 2, floor('none'), 1, False, 3) for seed in range(3)),
    *(of_choices(seed, 2, floor('none'), 1, True, 3) for seed in range(3)),
    of_choices(0, 2, floor('polygon', 0.6, 4), 1, False, 2),
    of_choices(0, 3, floor('polygon', 0.5, 6), 0, False, 2),
    of_choices(0, 3, floor('none'), 1, True, 3),
    *map(exchangeable, range(2)),
]


@pytest.mark.parametrize(
    ('posed', 'near'),
    [
        *((each, {'rel': 1e-5, 'abs': 1e-6}) for each in BRANCHING),
        *((weighed_apart(seed), {'rel': 1e-3}) for seed in range(6)),
    ],
)
def test_searches_find_what_enumeration_finds(posed, near):
    expected, solver = enumerated(*posed.parts), Solver(posed.problem, gap_tolerance=1e-6)
    if expected == np.inf:
        with pytest.raises(Infeasible):
            solver.solve(posed.state, posed.goals)
        return
    plan = solver.solve(posed.state, posed.goals)
    assert plan.status == 'optimal'
    assert plan.objective == pytest.approx(expected, **near)
    assert plan.lower_bound <= expected + 1e-6 * max(1.0, expected)


# --- floors

FLOORED = [
    name
    for name, given in (FAMILIES | OPEN).items()
    if 'floor' in given and name != 'long' and not {'terminal', 'hazards'} & given.keys()
    if name in FAMILIES or 'dimension' not in given
]


@needs_machine_code
@pytest.mark.parametrize('seed', range(2))
@pytest.mark.parametrize('family', FLOORED)
def test_floors_are_closed_in_wind(family, seed):
    """No plan is better by more than the gap, which the verifier proves."""
    problem, start, targets = case(family, seed, longest=5).parts
    wanting = 4.0 * seed * (not problem.max_acceleration)
    problem = replace(problem, weights=replace(problem.weights, attitude=wanting))
    wind = disturbed(np.random.default_rng([seed, *family.encode()]), problem).disturbance
    solver = Solver(problem, gap_tolerance=1e-5, coasting=start.coasted is not None)
    plan = solver.solve(replace(start, disturbance=wind), targets)
    assert plan.status == 'optimal', plan.proof.reason


@needs_machine_code
@pytest.mark.parametrize('side', [1.0, -1.0])
def test_a_search_winds_round_to_the_cone_of_an_approach(side):
    """A turn to the opposite heading, with a goal to the left or to the right."""
    problem = Problem(
        horizon=16, step=0.5, forward=15.0, floor=floor('circle', 1.0), max_rate=np.radians(30.0),
        approach=Approach(0.2, (-1.0, 0.0)),
    )  # fmt: skip
    start, targets = State.at(np.zeros(2), np.eye(2)), np.tile([-20.0, 57.0 * side], (16, 1))
    plan = Solver(problem).solve(start, targets)
    assert plan.gap < 1e-2
    turned = np.unwrap(np.arctan2(plan.rotations[:, 1, 0], plan.rotations[:, 0, 0]))[-1]
    assert side * turned == pytest.approx(np.pi, abs=0.2 + 1e-6)


@needs_machine_code
@pytest.mark.parametrize('horizon', [20, 31, 45])
def test_wings_are_proved_over_long_horizons(horizon):
    problem = Problem(
        step=6.0 / horizon, horizon=horizon, forward=15.0, floor=floor('circle', 2.0 / 3.0, 4),
        max_rate=0.4363, discretisation='exact',
    )  # fmt: skip
    solver = Solver(weighed(problem, 'time'), gap_tolerance=1e-3)
    for goal in ([60.0, 20.0], [-40.0, 30.0]):
        targets = np.tile(goal, (horizon, 1))
        assert solver.solve(State.at(np.zeros(2), np.eye(2)), targets).status == 'optimal'


# --- weights


def test_a_cost_far_below_the_usual_is_proved_in_proportion_to_itself():
    """Turning costs 1e13 times as much as path length; the shorter flight must still be found."""
    weight = Weights(0.0, 0.125, 2.8e-14, 0.0)
    problem = Problem(horizon=2, weights=weight, floor=floor('polygon', 0.728, 5), max_rate=0.42)
    start = State.at([0.0, 0.0], np.eye(2))
    plan = Solver(problem).solve(start, np.tile([3.0, 1.0], (2, 1)))
    assert plan.objective <= 2.0 * 2.8e-14 * (1.0 + 1e-6)


@pytest.mark.parametrize(('shape', 'held'), [('polygon', 5), ('circle', 0)])
def test_a_path_at_rest_is_kept_beyond_faces_but_touches_no_circle(shape, held):
    regions, still = Regions(Problem(floor=Floor(shape))), np.zeros((6, 2))
    regions.bind(Request(State.at(still[0], np.eye(2)), still[1:]))
    assert len(regions.tangents(still, range(5), {})) == held


@pytest.mark.parametrize('fraction', [0.5, 1.0])
@pytest.mark.parametrize('dimension', [2, 3])
def test_a_heading_that_nothing_weighs_is_no_trouble(dimension, fraction):
    rng = np.random.default_rng(7)
    for chosen in (Weights(1.0, 0.0, 0.0, 1.0), Weights(0.0, 0.0, 0.0, 0.0)):
        problem = Problem(dimension=dimension, weights=chosen, floor=floor('circle', fraction))
        start, targets = state(rng, problem), goals(rng, problem)
        assert Solver(problem).solve(start, targets).status == 'optimal'


# --- arrivals


@needs_machine_code
@pytest.mark.parametrize('goal', [(30.0, 20.0), (-15.0, 30.0), (5.0, -40.0)])
def test_a_long_arrival_is_nearly_as_good_where_its_descent_is_interrupted(goal):
    problem = Problem(horizon=60, terminal='constraint', floor=floor('circle', 0.5))
    asked = State.at(np.zeros(2), np.eye(2)), np.tile(goal, (60, 1)), None
    late, patient = (Solver(problem).solve(*asked, polled(looks)) for looks in (40, 400))
    assert late.objective <= 1.01 * patient.objective


@pytest.mark.parametrize('n', [2, 3])
def test_the_last_step_to_an_arrival_is_the_states_and_with_exact_steps_not(n):
    """With the explicit Euler model R_1 does not move s_1: only one goal can be reached."""
    w = Weights(0.0, 0.0, 0.0, 0.0, 0.5) if n == 3 else Weights()  # of R_N alone
    problem = Problem(n, horizon=1, terminal='constraint', floor=floor('circle', 0.5), weights=w)
    start = State.at(np.zeros(n), np.eye(n), disturbance=0.2 * np.eye(n)[1], wanted=np.eye(n))
    there = np.eye(n)[:1] + 0.2 * np.eye(n)[1]
    assert Solver(problem).solve(start, there).status == 'optimal'
    with pytest.raises(Infeasible):
        Solver(problem).solve(start, 0.99 * there)
    exact = replace(problem, discretisation='exact')
    assert Solver(exact).solve(start, 0.9 * there).status == 'optimal'
    assert Solver(replace(problem, horizon=n)).solve(start, np.tile(n * there, (n, 1))).is_closed


# --- fallbacks for a plan


@pytest.mark.parametrize('rate', [0.0, 0.5])
@pytest.mark.parametrize('n', [2, 3])
def test_a_box_ahead_is_passed_without_a_search(n, rate):
    low, high = np.full(n, -6.0), np.full(n, 6.0)
    low[0], high[0] = 10.0, 14.0
    fast, box = floor('circle', 0.9), Box(low, high)
    problem = Problem(n, horizon=30, floor=fast, max_rate=rate, obstacles=(box,))
    start, targets = State.at(np.zeros(n), np.eye(n)), np.zeros((30, n))
    targets[:, 0] = 25.0
    plan = Solver(problem).solve(start, targets, out_of_time=lambda: True)
    assert violations(problem, start, targets, plan) == []
    assert plan.positions[:, 0].max() > 0.0


@pytest.mark.parametrize('shape', ['circle', 'polygon'])
def test_a_vehicle_that_can_hardly_turn_slows_down_at_once(shape):
    problem = Problem(rotation_order=2, floor=floor(shape, 0.1), max_rate=0.02)
    start, targets = State.at(np.zeros(2), np.eye(2)), np.tile([-1.0, -1.0], (5, 1))
    plan = Solver(problem).solve(start, targets)
    assert plan.speed_fraction[2:-1].max() < 0.11


def test_what_did_not_come_of_the_search_says_so():
    box = Box([4.4, 0.5, -0.5], [5.6, 1.7, 0.5])
    problem = Problem(3, horizon=8, floor=floor('circle', 0.9), obstacles=(box,))
    start, targets = State.at(np.zeros(3), np.eye(3)), np.tile([9.0, 2.0, 0.0], (8, 1))
    solver = Solver(problem)
    instead = solver.solve(start, targets, out_of_time=lambda: True)
    assert instead.proof.reason.endswith('a plan found without search is used')
    again = solver.solve(start, targets, instead, out_of_time=lambda: True)
    assert again.objective == instead.objective
    assert again.proof.reason == 'the previous plan continues: no better one was found in time'


def test_holding_the_rotation_stands_in_for_a_method_that_fails(monkeypatch):
    """After any failure of the method, the plan reports it and claims no proof."""
    problem = Problem(floor=floor('circle', 0.5))
    solver = Solver(problem)
    start = State.at([0.0, 0.0], 0.2 * np.eye(2), attitude=np.eye(2))
    targets = np.tile([4.0, 1.0], (5, 1))
    truly = solver.solve(start, targets)

    def beaten(found, share):
        much = share * found.cost
        return replace(found, lower_bound=much, cost=much, proofs=())

    solve = solver._method.solve
    broken = {
        'fails its check': lambda *a: replace(solve(*a), x=1.1 * solve(*a).x),
        'the trajectory found is not finite': lambda *a: replace(solve(*a), x=np.nan * solve(*a).x),
        'no trajectory': lambda *a: replace(solve(*a), x=None, cost=np.inf, lower_bound=np.inf),
    }
    for said, method in broken.items():
        monkeypatch.setattr(solver._method, 'solve', method)
        plan = solver.solve(start, targets)
        assert plan.status == 'feasible'
        assert said in plan.proof.reason
        assert plan.lower_bound <= truly.objective <= plan.objective
    for share in (10.0, 0.16):  # a false cost, with a bound to match
        monkeypatch.setattr(solver._method, 'solve', lambda *a, s=share: beaten(solve(*a), s))
        plan = solver.solve(start, targets)
        assert plan.status == 'feasible'
        assert plan.lower_bound <= truly.objective <= plan.objective * (1.0 + 1e-9)
