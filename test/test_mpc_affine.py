# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Laws of steady disturbances and of exact integration, against oracles that share no code."""

import itertools
from dataclasses import replace

import cvxpy as cp
import numpy as np
import problems
import pytest
from scipy.optimize import minimize

from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import BadInput, Infeasible
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.model.translation import TRANSLATIONS, FirstOrder
from orbimpc_ros.mpc.problem import Box, Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.feasibility import reason
from orbimpc_ros.mpc.sensitivity.constraints import explained
from orbimpc_ros.mpc.solve.program import Program
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.mpc.solve.statement import Statement

KINDS = [
    {'dimension': n, 'translation_order': t, 'discretisation': d}
    for n, t, d in itertools.product((2, 3), (1, 2), ('euler', 'exact'))
]
ALL_KINDS = [{**kind, 'rotation_order': r} for kind in KINDS for r in (1, 2)]
PLANE = KINDS[: len(KINDS) // 2]


def seeded(kind, seed=0):
    return np.random.default_rng([seed, *map(ord, str(sorted(kind.items())))])


def blown(rng, problem, *, full_speed=False):
    """A random state in a random disturbance of up to 0.6 of full speed or thrust."""
    start = problems.state(rng, problem, full_speed=full_speed)
    w = rng.normal(size=problem.dimension)
    w *= 0.6 * problem.forward * rng.random() / np.linalg.norm(w)
    return replace(start, disturbance=w)


def moved(problem, start, headings):
    """Positions and velocities, step by step, as docs/mathematics.md 1.1 has them."""
    h, z, w = problem.step, problem.forward, start.disturbance
    s, p = [start.position], [start.velocity]
    for old, new in itertools.pairwise(headings):
        mean = 0.5 * (old + new) if problem.discretisation == 'exact' else old
        way = h * (z * mean + w)
        if problem.translation_order == 2:
            way = h * p[-1]
            if problem.discretisation == 'exact':
                way = way + h**2 * (z * (old / 3.0 + new / 6.0) + 0.5 * w)
        s.append(s[-1] + way)
        p.append(p[-1] + h * (z * mean + w))
    if problem.translation_order == 1:
        return np.array(s), z * np.array(headings) + w
    return np.array(s), np.array(p)


@pytest.mark.parametrize('kind', ALL_KINDS)
def test_rollouts_and_maps_are_the_steps_of_the_model(kind):
    rng = seeded(kind)
    problem = Problem(**kind, horizon=6, step=0.4, forward=1.7, weights=problems.weights(rng))
    start, goals = blown(rng, problem), problems.goals(rng, problem)
    x = rng.normal(size=(6, 2 if problem.dimension == 2 else 9))
    flown = trajectory_of(problem, start, goals, x)
    positions, velocities = moved(problem, start, flown.headings)
    np.testing.assert_allclose(flown.positions, positions, atol=1e-12)
    np.testing.assert_allclose(flown.velocities, velocities, atol=1e-12)
    mapped = dynamics.drift(problem, start) + problem.maps.reach @ flown.headings
    np.testing.assert_allclose(mapped, positions[1:], atol=1e-12)


@pytest.mark.parametrize('kind', PLANE)
def test_the_condensed_quadratic_knows_the_disturbance(kind):
    rng = seeded(kind)
    smooth = replace(problems.weights(rng), length=0.0)
    problem = Problem(**kind, horizon=5, step=0.4, forward=1.7, weights=smooth)
    start, goals = blown(rng, problem), problems.goals(rng, problem)
    z, condensed = rng.normal(size=(5, 2)), Condensed(problem)
    q, c = condensed.affine(start, goals)
    cost = 0.5 * np.sum(z * (condensed.hessian @ z)) + np.sum(q * z) + c
    assert cost == pytest.approx(trajectory_of(problem, start, goals, z).cost)


@pytest.mark.parametrize('order', [1, 2])
def test_exact_steps_follow_a_vehicle_that_turns_evenly(order):
    """A fine integration of constant thrust on an axis that turns evenly, 0.3 rad in each step."""
    exact = Problem(2, 1, order, horizon=5, discretisation='exact')
    fine = Problem(2, 1, order, horizon=500, step=0.01, discretisation='exact')
    apart = {}
    for turn in (0.3, 0.15):
        start = State.at([0.0, 0.0], np.eye(2), velocity=[0.0, 0.0], disturbance=[0.1, -0.2])

        def flown(problem, turn=turn, start=start):
            angles = turn * problem.step * np.arange(problem.horizon + 1)
            axes = np.column_stack([np.cos(angles), np.sin(angles)])
            return dynamics.translation_rollout(problem, start, axes)[0][-1]

        truth = flown(fine)
        apart[turn] = [
            np.linalg.norm(flown(each) - truth)
            for each in (exact, replace(exact, discretisation='euler'))
        ]
    (error, paper), (half_error, _) = apart[0.3], apart[0.15]
    assert error < 0.1 * paper
    assert error / half_error == pytest.approx(4.0, abs=0.3)  # of second order in the turn


# --- optima


def convex(problem, start, goals):
    """The optimal value of the hull, stated anew in CVXPY: inputs and states step by step."""
    n, steps, h, z = problem.dimension, problem.horizon, problem.step, problem.forward
    w = problem.weights
    r = [start.rotation, *(cp.Variable((n, n)) for _ in range(steps))]
    s, p, rows, cost = [start.position], [start.velocity], [], 0.0
    for k in range(steps):
        old, new = r[k][:, 0], r[k + 1][:, 0]
        late = 0.5 if problem.discretisation == 'exact' else 0.0
        gained = h * (z * ((1.0 - late) * old + late * new) + start.disturbance)
        way = gained
        if problem.translation_order == 2:
            way = h * p[-1]
            if late:
                way = way + h * h * (z * (old / 3.0 + new / 6.0) + start.disturbance / 2.0)
        s.append(s[-1] + way)
        p.append(p[-1] + gained)
        rows += hull(r[k + 1])
        cost += w.position * cp.sum_squares(s[-1] - goals[k])
        cost += w.input * cp.sum_squares((r[k + 1] - r[k]) / h)
        speed = (1.0 - late) * cp.norm(old) + late * cp.norm(new)
        cost += w.length * h * z * speed
    cost += w.terminal * cp.sum_squares(s[-1] - goals[-1])
    if problem.terminal == 'constraint':
        rows.append(s[-1] == goals[-1])
        rows += [p[-1] == 0.0] if problem.translation_order == 2 else []
    program = cp.Problem(cp.Minimize(cost), rows)
    return program.solve(solver=cp.CLARABEL)


def hull(r):
    """conv SO(n): a disk, or Schur's and Sanyal's linear matrix inequality."""
    if r.shape == (2, 2):
        return [r[0, 0] == r[1, 1], r[0, 1] == -r[1, 0], cp.norm(r[:, 0]) <= 1.0]
    a, b, c = (r[i, i] for i in range(3))
    s = cp.bmat(
        [
            [1 + a + b + c, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], 1 + a - b - c, r[1, 0] + r[0, 1], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], 1 - a + b - c, r[2, 1] + r[1, 2]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[2, 1] + r[1, 2], 1 - a - b + c],
        ]
    )
    return [s >> 0]


@pytest.mark.parametrize('arrives', [False, True])
@pytest.mark.parametrize('length', [0.0, 0.7])
@pytest.mark.parametrize('kind', KINDS)
def test_hull_optima_are_those_of_another_formulation(kind, length, arrives):
    rng = seeded(kind)
    weights = Weights(1.0, 0.1, length, 3.0)
    problem = Problem(**kind, horizon=6, step=0.6, forward=1.4, weights=weights)
    start = blown(rng, problem)
    goals = problems.goals(rng, problem, distance=1.0)
    if arrives:  # where some trajectory ends
        z = 0.5 * np.tile(start.attitude[:, 0], (7, 1))
        if problem.inertial:
            gained = moved(problem, start, z)[1][-1] - start.velocity
            start = replace(start, velocity=-gained)
        goals = np.tile(
            moved(problem, start, np.array([start.rotation[:, 0], *z[1:]]))[0][-1], (6, 1)
        )
        if problem.inertial:
            end = moved(problem, start, np.array([start.rotation[:, 0], *z[1:]]))[1][-1]
            start = replace(start, velocity=start.velocity - end)
            again = moved(problem, start, np.array([start.rotation[:, 0], *z[1:]]))
            goals = np.tile(again[0][-1], (6, 1))
        problem = replace(problem, terminal='constraint')
    plan = Solver(problem, gap_tolerance=1e-7).solve(start, goals)
    assert plan.status == 'optimal', plan.proof.reason
    assert plan.objective == pytest.approx(convex(problem, start, goals), rel=2e-6)


def cheapest(problem, start, goals, *, boxes=()):
    """The least cost that SLSQP finds over planar headings, from starts all around."""
    first, w = start.rotation[:, 0], problem.weights

    def positions(x):
        return moved(problem, start, np.array([first, *x.reshape(-1, 2)]))[0][1:]

    def cost(x):
        missed = ((positions(x) - goals) ** 2).sum(axis=1)
        turned = 2.0 * (np.diff([first, *x.reshape(-1, 2)], axis=0) ** 2).sum() / problem.step**2
        return w.position * missed.sum() + w.terminal * missed[-1] + w.input * turned

    def sizes(x):
        return (x.reshape(-1, 2) ** 2).sum(axis=1)

    least = problem.floor.clearance(2)
    limits = [lambda x: 1.0 - sizes(x), lambda x: sizes(x) - least**2]
    costs = []
    for sides in itertools.product(range(4), repeat=len(boxes)):
        beyond = [
            lambda x, box=box, side=side: box.clearances(positions(x))[:, side]
            for box, side in zip(boxes, sides, strict=True)
        ]
        for angle in np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False):
            begin = np.tile(0.7 * np.array([np.cos(angle), np.sin(angle)]), problem.horizon)
            rows = [{'type': 'ineq', 'fun': each} for each in (*limits, *beyond)]
            end = minimize(cost, begin, constraints=rows, method='SLSQP', tol=1e-12)
            if min(each['fun'](end.x).min() for each in rows) > -1e-8:
                costs.append(end.fun)
    return min(costs)


@pytest.mark.parametrize('seed', range(2))
@pytest.mark.parametrize('kind', PLANE)
def test_no_local_search_beats_a_floor_in_wind(kind, seed):
    rng = seeded(kind, seed)
    problem = Problem(**kind, horizon=4, floor=Floor('circle', fraction=0.5))
    start, goals = blown(rng, problem), problems.goals(rng, problem, distance=1.5)
    plan = Solver(problem, gap_tolerance=1e-6).solve(start, goals)
    assert plan.status == 'optimal'
    assert plan.objective == pytest.approx(cheapest(problem, start, goals), rel=1e-5)


@pytest.mark.parametrize('kind', PLANE)
def test_boxes_stay_where_they_are_in_wind(kind):
    """Each step of a plan may be beyond another side: no side for all of them is cheaper."""
    rng = seeded(kind)
    start = State.at([0.0, 0.0], 0.8 * np.eye(2), velocity=[0.0, 0.0], disturbance=[0.2, 0.3])
    box = Box([1.2, -0.6], [2.0, 0.9])
    problem = Problem(**kind, horizon=4, step=0.6, forward=1.5, obstacles=(box,))
    goals = np.tile([2.6, 0.4 + 0.1 * rng.random()], (4, 1))
    plan = Solver(problem, gap_tolerance=1e-6).solve(start, goals)
    assert plan.status == 'optimal'
    assert box.depth(plan.positions[1:]).max() <= 1e-6
    assert plan.objective <= cheapest(problem, start, goals, boxes=(box,)) * (1.0 + 1e-6)
    assert box.depth(Solver(replace(problem, obstacles=())).solve(start, goals).positions).max() > 0


# --- laws


@pytest.mark.parametrize('discretisation', ['euler', 'exact'])
@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('shape', ['none', 'polygon', 'circle'])
def test_wind_is_as_good_as_goals_that_drift_against_it(n, shape, discretisation):
    """Galilei: seen from the air, the goals move by -w, and the rotations are the same."""
    rng = np.random.default_rng(n)
    floor = Floor(shape, 4 if n == 2 else 6, 0.5)
    problem = Problem(n, horizon=4, step=0.7, floor=floor, discretisation=discretisation)
    start = blown(rng, problem)
    goals = problems.goals(rng, problem, distance=2.0)
    ahead = problem.step * np.arange(1.0, 5.0)
    still = replace(start, disturbance=np.zeros(n))
    solver = Solver(problem, gap_tolerance=1e-3 if (n, shape) == (3, 'circle') else 1e-7)
    plan = solver.solve(start, goals)
    other = solver.solve(still, goals - np.outer(ahead, start.disturbance))
    assert plan.objective == pytest.approx(other.objective, rel=1e-6)
    flat = 1e-4 if n == 2 else 3e-3  # in space a cost hardly tells rolls apart
    np.testing.assert_allclose(plan.rotations, other.rotations, atol=flat)


@pytest.mark.parametrize('kind', ALL_KINDS)
def test_a_plan_for_still_air_does_not_pass_the_check_in_wind(kind):
    rng = seeded(kind)
    problem = Problem(**kind)
    windy, goals = blown(rng, problem), problems.goals(rng, problem)
    still = replace(windy, disturbance=np.zeros(problem.dimension))
    solver = Solver(problem, coasting=True)
    for one, other in ((windy, still), (still, windy)):
        plan = solver.solve(one, goals)
        assert violations(problem, one, goals, plan) == []
        assert any('positions differ' in flaw for flaw in violations(problem, other, goals, plan))


@pytest.mark.parametrize('kind', ALL_KINDS)
def test_a_plan_of_one_discretisation_does_not_pass_the_check_of_the_other(kind):
    rng = seeded(kind)
    problem = Problem(**kind)
    start, goals = blown(rng, problem), problems.goals(rng, problem)
    plan = Solver(problem, coasting=True).solve(start, goals)
    kinds = {'euler', 'exact'} - {problem.discretisation}
    found = violations(replace(problem, discretisation=kinds.pop()), start, goals, plan)
    assert any('positions differ' in flaw for flaw in found)


def test_hovering_under_gravity_costs_nothing_but_turns():
    """With the weight carried at every step, the vehicle stays where it is: at its goal."""
    problem = Problem(3, 1, 2, horizon=8, step=0.2, forward=20.0)
    up = exp(np.array([0.0, -0.5 * np.pi, 0.0]))
    down = [0.0, 0.0, -9.81]
    start = State.at(np.ones(3), 9.81 / 20.0 * up, attitude=up, disturbance=down)
    for each in ('euler', 'exact'):
        solver = Solver(replace(problem, discretisation=each))
        plan = solver.solve(start, np.ones((8, 3)))
        assert plan.status == 'optimal'
        assert plan.objective < 1e-9
        np.testing.assert_allclose(plan.positions, 1.0, atol=1e-5)
        np.testing.assert_allclose(plan.speed_fraction, 9.81 / 20.0, atol=1e-4)


def test_steps_of_an_arrival_at_order_2_end_at_rest_under_gravity():
    problem = Problem(3, 2, 2, horizon=10, step=0.5, forward=20.0, terminal='constraint')
    up = exp(np.array([0.0, -0.5 * np.pi, 0.0]))
    known = {'attitude': up, 'coasted': up, 'disturbance': [0.3, 0.0, -9.81]}
    start = State.at(np.zeros(3), 0.5 * up, velocity=[0.0, 1.0, 0.0], **known)
    for each in ('euler', 'exact'):
        solver = Solver(replace(problem, discretisation=each), coasting=True)
        plan = solver.solve(start, np.tile([3.0, 1.0, 2.0], (10, 1)))
        assert plan.status == 'optimal'
        np.testing.assert_allclose(plan.positions[-1], [3.0, 1.0, 2.0], atol=1e-6)
        np.testing.assert_allclose(plan.velocities[-1], 0.0, atol=1e-6)


@pytest.mark.parametrize('order', [1, 2])
def test_wind_decides_what_is_out_of_reach(order):
    problem = Problem(2, 1, order, horizon=4, terminal='constraint')
    goals = np.tile([0.0, 9.0], (4, 1))
    start = State.at([0.0, 0.0], np.eye(2), velocity=[0.0, 0.0], disturbance=[0.0, -0.5])
    with pytest.raises(Infeasible, match='beyond what 4 steps can reach'):
        Solver(problem).solve(start, goals)
    assert 'beyond what 4 steps' in reason(problem, start, goals)


def test_a_box_that_the_wind_drives_into_is_blamed():
    start = State.at([0.0, 0.0], np.eye(2), disturbance=[0.0, 1.0])
    problem = Problem(obstacles=(Box([0.5, 0.5], [1.5, 1.5]),))
    with pytest.raises(Infeasible, match='obstacle 0 holds s_1'):
        Solver(problem).solve(start, np.zeros((5, 2)))
    still = replace(start, disturbance=np.zeros(2))
    assert Solver(problem).solve(still, np.zeros((5, 2))).status == 'optimal'


@pytest.mark.parametrize('kind', KINDS)
def test_the_price_of_a_disturbed_arrival_is_what_another_goal_costs(kind):
    problem = Problem(**kind, horizon=6, step=0.7, terminal='constraint')
    n = problem.dimension
    w, axis = 0.2 * np.arange(1.0, n + 1.0) / n, np.eye(n)[0]
    start = State.at(np.zeros(n), 0.6 * np.eye(n), velocity=np.zeros(n), disturbance=w)
    reached = 0.3 * axis + (problem.maps.blown[-1] * w if not problem.inertial else 0.0)
    goals, solver = np.tile(reached, (6, 1)), Solver(problem, gap_tolerance=1e-9)
    plan = solver.solve(start, goals)
    prices = {str(b): b.price for b in explained(problem, start, goals, plan).binding}
    ends = []
    for by in (1e-4, -1e-4):
        there = goals.copy()
        there[-1] += by * axis
        ends.append(solver.solve(start, there).objective)
    assert prices['terminal x@6'] == pytest.approx(abs(ends[0] - ends[1]) / 2e-4, rel=2e-2)


@pytest.mark.parametrize('kind', ALL_KINDS)
def test_an_arrival_that_is_only_weighed_is_weighed_in_wind_too(kind):
    """The relaxation's bound, where the disturbance adds to the last velocity, meets its cost."""
    rng = seeded(kind)
    problem = Problem(**kind, horizon=6, arrival_weight=20.0, step=0.5)
    start, goals = blown(rng, problem), problems.goals(rng, problem)
    plan = Solver(problem, coasting=True).solve(start, goals)
    assert plan.status == 'optimal', plan.proof.reason


@pytest.mark.parametrize('kind', ALL_KINDS)
def test_no_variable_of_the_program_exceeds_what_proofs_take_for_its_most(kind):
    rng = seeded(kind)
    problem = Problem(**kind, horizon=5, weights=Weights(1.0, 0.1, 0.5, 2.0))
    program = Program(problem)
    for _ in range(5):
        start = replace(blown(rng, problem), coasted=None)
        goals = problems.goals(rng, problem, distance=20.0)
        program.relax(Request(start, goals))
        found = np.abs(program._solver.solve().x)
        speed, spin = np.linalg.norm(start.velocity), np.abs(start.rotation_rate).max()
        assert (found <= Statement(problem).largest(speed, spin) * (1.0 + 1e-4)).all()


@pytest.mark.parametrize('kind', ALL_KINDS)
def test_other_units_are_another_way_to_say_the_same(kind):
    """The same problem in feet and tens of seconds, disturbance included."""
    rng = seeded(kind)
    problem = Problem(
        **kind, horizon=5, floor=Floor('polygon', 4 if kind['dimension'] == 2 else 6, 0.4)
    )
    start, goals = blown(rng, problem), problems.goals(rng, problem)
    foot, minute = 0.3048, 10.0
    order = problem.translation_order
    rate = minute ** (2 * problem.rotation_order)
    weights = replace(problem.weights, position=foot**2, terminal=10.0 * foot**2, input=0.05 / rate)
    other = replace(problem, step=1.0 / minute, forward=minute**order / foot, weights=weights)
    known = replace(
        start,
        position=start.position / foot,
        velocity=start.velocity * minute / foot,
        disturbance=start.disturbance * minute**order / foot,
    )
    plan = Solver(problem, coasting=True).solve(start, goals)
    again = Solver(other, coasting=True).solve(known, goals / foot)
    assert again.objective == pytest.approx(plan.objective, rel=1e-4)


def test_models_without_an_exact_form_are_refused_in_one_line(monkeypatch):
    monkeypatch.setitem(TRANSLATIONS, 3, FirstOrder())
    with pytest.raises(
        BadInput, match='discretisation is exact; allowed: euler at translation_order 3'
    ):
        Problem(translation_order=3, discretisation='exact')
    with pytest.raises(BadInput, match=r'discretisation is eular.*did you mean'):
        Problem(discretisation='eular')
    with pytest.raises(BadInput, match=r'state\.disturbance'):
        State.at([0.0, 0.0], np.eye(2), disturbance=[1.0])


@pytest.mark.skipif(not COMPILED, reason='is about machine code: pip install numba')
@pytest.mark.parametrize('floor', [Floor(), Floor('polygon'), Floor('circle')])
def test_common_problems_stay_in_machine_code_with_exact_steps(floor):
    from orbimpc_ros.mpc.solve.hull_riccati import HullRiccati
    from orbimpc_ros.mpc.solve.registry import method_for

    exact = Problem(floor=floor, discretisation='exact')
    method = method_for(exact, 1e-6)
    assert not HullRiccati.solves(exact)
    assert type(method).__name__ != 'DisjunctiveSearch'


@pytest.mark.parametrize('n', [2, 3])
def test_the_last_step_to_an_arrival_above_a_floor_is_the_states_or_with_exact_steps_not(n):
    """With old values on the right, R_1 moves nothing: only one goal can be arrived at."""
    weights = Weights(input=0.0) if n == 3 else Weights()
    floor = Floor('circle', fraction=0.5)
    problem = Problem(n, horizon=1, terminal='constraint', floor=floor, weights=weights)
    start = State.at(np.zeros(n), np.eye(n), disturbance=0.2 * np.eye(n)[1])
    there = np.eye(n)[:1] + 0.2 * np.eye(n)[1]
    assert Solver(problem).solve(start, there).status == 'optimal'
    with pytest.raises(Infeasible):
        Solver(problem).solve(start, 0.99 * there)
    exact = replace(problem, discretisation='exact')
    assert Solver(exact).solve(start, 0.9 * there).status == 'optimal'
