# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A floor with a turn rate: plans turn by legal angles, are flown as planned, and are optimal."""

from dataclasses import replace

import numpy as np
import pytest
from problems import floor, goals, state
from scipy.optimize import minimize
from stepping import Stepped

from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.command import command_of
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import carried, exp
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.plan import UNPROVED, assemble
from orbimpc_ros.mpc.problem import Box, Problem, State, Weights
from orbimpc_ros.mpc.problem.scaling import weighed
from orbimpc_ros.mpc.search.engine import Engine
from orbimpc_ros.mpc.sensitivity.constraints import explained
from orbimpc_ros.mpc.solve.disjunctive_bnb import DisjunctiveSearch
from orbimpc_ros.mpc.solve.planar_way import PlanarWay
from orbimpc_ros.mpc.solve.request import Enough, Request
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.mpc.solve.stand_ins import straight

needs_machine_code = pytest.mark.skipif(
    not COMPILED, reason='sectors are searched in machine code: install numba'
)
SHAPES = [('circle', 4), ('polygon', 4), ('polygon', 8), ('polygon', 5)]


def random_problem(rng, shape, faces, *, dimension=2, horizon=5):
    faces = faces if dimension == 2 else 12
    largest = 1.0 if shape == 'circle' else (np.cos(np.pi / faces) if dimension == 2 else 0.79)
    return Problem(
        dimension=dimension,
        horizon=horizon,
        step=rng.uniform(0.3, 1.0),
        forward=rng.uniform(0.5, 15.0),
        weights=Weights(rng.uniform(0.1, 2.0), 10.0 ** rng.uniform(-2, 0), 0.0, rng.uniform(0, 10)),
        floor=floor(shape, rng.uniform(0.2, 0.95) * largest, faces),
        max_rate=rng.choice([rng.uniform(0.1, 0.8), rng.uniform(0.8, 3.0)]),
    )


def random_start(rng, problem):
    reach = problem.horizon * problem.step * problem.forward
    return state(rng, problem, full_speed=False), goals(rng, problem, 0.5 * reach)


def angles(start, plan):
    """The angles of all turns, the first one from the measured heading."""
    axes = np.vstack([start.attitude[:, 0], plan.rotations[1:, :, 0]])
    units = axes / np.linalg.norm(axes, axis=1)[:, None]
    return np.arccos(np.clip(np.sum(units[1:] * units[:-1], axis=1), -1.0, 1.0))


def wandering(rng, problem, start):
    """Headings of a random legal trajectory, shape (N, n), now and then at the limits."""
    heading, z = start.attitude[:, 0], []
    for _ in range(problem.horizon):
        aside = rng.normal(size=problem.dimension)
        aside -= (aside @ heading) * heading
        aside /= np.linalg.norm(aside)
        widest = min(np.pi, problem.step * problem.max_rate)
        angle = widest * rng.choice([rng.uniform(), 1.0])
        heading = np.cos(angle) * heading + np.sin(angle) * aside
        least = problem.floor.least(heading)
        z.append(rng.choice([least, rng.uniform(least, 1.0), 1.0]) * heading)
    return np.array(z)


def cost(problem, start, targets, z):
    rotations = carried(start.attitude, z)
    return trajectory_of(problem, start, targets, coordinates(rotations)).cost


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize(('shape', 'faces'), SHAPES[:3])
def test_every_turn_of_a_plan_is_legal_and_flown_as_planned(shape, faces, dimension):
    rng = np.random.default_rng(17)
    for _ in range(12 if dimension == 2 else 3):
        problem = random_problem(rng, shape, faces, dimension=dimension, horizon=4)
        start, targets = random_start(rng, problem)
        polls = iter(range(40))
        plan = Solver(problem).solve(
            start, targets, out_of_time=lambda polls=polls: next(polls, None) is None
        )
        assert violations(problem, start, targets, plan) == []
        assert angles(start, plan).max() <= problem.step * problem.max_rate + 1e-6
        if dimension == 3:
            continue  # a roll may take longer than the turn
        for k in range(problem.horizon):
            command = command_of(problem, start, plan, k)
            np.testing.assert_allclose(command.rotation, plan.projected[k + 1], atol=1e-6)
            assert command.speed_fraction == pytest.approx(plan.speed_fraction[k + 1], abs=1e-6)


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize('boxed', [False, True])
@pytest.mark.parametrize(('shape', 'faces'), SHAPES[:2])
def test_no_legal_trajectory_costs_less_than_the_bound(shape, faces, boxed, dimension):
    rng = np.random.default_rng(23)
    for _ in range(4):
        problem = random_problem(rng, shape, faces, dimension=dimension, horizon=4)
        start, targets = random_start(rng, problem)
        if boxed:
            far = start.position + 2.0 * problem.step * problem.forward * start.attitude[:, 1]
            size = 0.4 * problem.step * problem.forward
            problem = replace(problem, obstacles=(Box(far - size, far + size),))
        polls = iter(range(60))
        found = DisjunctiveSearch(problem, 1e-4).solve(
            Request(start, targets, out_of_time=lambda polls=polls: next(polls, None) is None)
        )
        for _ in range(100):
            z = wandering(rng, problem, start)
            flown = trajectory_of(
                problem, start, targets, coordinates(carried(start.attitude, z))
            ).positions
            if all(box.clearances(flown)[1:].max(axis=1).min() >= 0.0 for box in problem.obstacles):
                assert found.lower_bound <= cost(problem, start, targets, z) * (1.0 + 1e-9)


def descended(problem, start, targets, rng):
    """The least cost of descents in speeds and turns from several starts, by another solver."""
    count, widest = problem.horizon, min(np.pi, problem.step * problem.max_rate)
    first = np.arctan2(start.attitude[1, 0], start.attitude[0, 0])

    def headings(y):
        around = first + np.cumsum(y[count:])
        units = np.column_stack([np.cos(around), np.sin(around)])
        least = np.array([problem.floor.least(unit) for unit in units])
        return (least + y[:count] * (1.0 - least))[:, None] * units

    def value(y):
        return cost(problem, start, targets, headings(y))

    box = [(0.0, 1.0)] * count + [(-widest, widest)] * count
    found = []
    for turn in (-1.0, -0.3, 0.3, 1.0):
        y = np.concatenate([rng.uniform(size=count), np.full(count, turn * widest)])
        found.append(minimize(value, y, method='SLSQP', bounds=box, options={'maxiter': 60}).fun)
    return min(found)


@needs_machine_code
@pytest.mark.parametrize(('shape', 'faces'), SHAPES)
def test_another_solver_never_beats_what_is_called_optimal(shape, faces):
    rng, optimal = np.random.default_rng(31), 0
    for _ in range(6):
        problem = random_problem(rng, shape, faces)
        start, targets = random_start(rng, problem)
        plan = Solver(problem).solve(start, targets)
        optimal += plan.status == 'optimal'
        other = descended(problem, start, targets, rng)
        assert plan.lower_bound <= other * (1.0 + 1e-9)
        if plan.status == 'optimal':
            assert plan.objective <= other * (1.0 + 1e-4)
    assert optimal == 6


@needs_machine_code
@pytest.mark.parametrize(('shape', 'faces'), SHAPES[:3])
def test_two_steps_against_a_grid(shape, faces):
    rng = np.random.default_rng(37)
    for _ in range(3):
        problem = random_problem(rng, shape, faces, horizon=2)
        start, targets = random_start(rng, problem)
        plan = Solver(problem).solve(start, targets)
        assert plan.status == 'optimal'
        widest = min(np.pi, problem.step * problem.max_rate)
        first = np.arctan2(start.attitude[1, 0], start.attitude[0, 0])
        shares, turns = np.linspace(0.0, 1.0, 7), np.linspace(-widest, widest, 15)
        least = np.inf
        for a in turns:
            for b in turns:
                units = [np.array([np.cos(t), np.sin(t)]) for t in (first + a, first + a + b)]
                lows = [problem.floor.least(unit) for unit in units]
                for s in shares:
                    for t in shares:
                        sizes = [low + x * (1.0 - low) for low, x in zip(lows, (s, t), strict=True)]
                        z = np.array([m * unit for m, unit in zip(sizes, units, strict=True)])
                        least = min(least, cost(problem, start, targets, z))
        assert plan.lower_bound <= least
        assert plan.objective <= least * (1.0 + 1e-4)


@needs_machine_code
@pytest.mark.parametrize('polls', [0, 1, 3])
def test_a_search_cut_short_has_a_legal_plan_and_a_sound_bound(polls):
    rng = np.random.default_rng(41)
    problem = replace(random_problem(rng, 'circle', 4, horizon=12), max_rate=0.7)
    method = Engine(problem, 1e-6)
    for _ in range(5):
        start, targets = random_start(rng, problem)
        asked = iter(range(polls))
        cut = method.solve(
            Request(start, targets, out_of_time=lambda asked=asked: next(asked, None) is None)
        )
        best = method.solve(Request(start, targets))
        assert cut.x is not None
        assert cut.lower_bound <= best.cost * (1.0 + 1e-9)
        assert best.lower_bound * (1.0 - 1e-9) <= cut.cost


@needs_machine_code
@pytest.mark.parametrize(('shape', 'faces'), [('circle', 4), ('polygon', 8)])
def test_a_fixed_wing_flies_its_plans(shape, faces):
    """A wing that turns evenly through each step is, at its end, where the plan has it head."""
    rng = np.random.default_rng(43)
    problem = Problem(
        step=0.5, horizon=8, forward=15.0, floor=floor(shape, 2.0 / 3.0, faces), max_rate=0.4363
    )
    controller = Stepped(problem, gap_tolerance=1e-2)
    place, heading, speed = np.zeros(2), rng.uniform(-np.pi, np.pi), 12.0
    goal, drift = np.array([60.0, -50.0]), np.array([2.0, 1.5])
    for k in range(30):
        ahead = goal + drift * 0.5 * (k + np.arange(1.0, 9.0))[:, None]
        measured = Odometry(
            0.5 * k, place.copy(), exp(np.array([heading])), np.array([speed, 0.0]), np.zeros(1)
        )
        tick = controller.tick(measured, ahead)
        assert tick.fallback == '', tick.reason
        rate = float(tick.command.body_rate[0])
        assert abs(rate) <= problem.max_rate * (1.0 + 1e-9)
        np.testing.assert_allclose(tick.command.rotation, tick.plan.projected[1], atol=1e-6)
        for _ in range(25):  # 20 ms
            heading += 0.02 * rate
            place = place + 0.02 * speed * np.array([np.cos(heading), np.sin(heading)])
        speed = problem.forward * tick.command.speed_fraction
        assert speed >= 10.0 - 1e-6


@needs_machine_code
@pytest.mark.parametrize(('shape', 'faces'), [('circle', 4), ('polygon', 8)])
def test_the_prices_of_turns_are_what_a_faster_turn_saves(shape, faces):
    problem = Problem(horizon=4, floor=floor(shape, 0.6, faces), max_rate=0.4)
    start, targets = State.at([0.0, 0.0], 0.8 * np.eye(2)), np.tile([0.5, 2.5], (4, 1))

    def best(rate):
        solver = Solver(replace(problem, max_rate=rate), gap_tolerance=1e-7)
        return solver.solve(start, targets)

    told = explained(problem, start, targets, best(0.4))
    saved = (best(0.4 - 1e-4).objective - best(0.4 + 1e-4).objective) / 2e-4
    prices = [each.price for each in told.binding if each.name == 'max_rate']
    assert len(prices) == 3
    assert sum(prices) == pytest.approx(saved, rel=1e-4)
    assert told.unexplained < 1e-6


@needs_machine_code
def test_a_search_ends_with_what_is_enough_and_its_bound_holds():
    rng, sooner = np.random.default_rng(23), {'cost': 0, 'bound': 0}
    for _ in range(40):
        problem = replace(random_problem(rng, 'circle', 4, horizon=12), max_rate=0.3)
        start, targets = random_start(rng, problem)
        whole = Solver(problem, gap_tolerance=1e-4).solve(start, targets)
        for name in sooner:
            settled = 1.5 * whole.objective if name == 'cost' else 0.5 * whole.objective
            solver = Solver(problem, gap_tolerance=1e-4, enough=Enough(**{name: settled}))
            plan = solver.solve(start, targets)
            assert plan.lower_bound <= whole.objective * (1.0 + 1e-9)
            assert plan.objective >= whole.lower_bound * (1.0 - 1e-9)
            if plan.gap > 1e-4:  # not just as good as without
                sooner[name] += plan.nodes < whole.nodes
                assert plan.status == Status.FEASIBLE
                assert plan.objective <= settled if name == 'cost' else plan.lower_bound > settled
    assert min(sooner.values()) > 3


@needs_machine_code
def test_a_goal_that_flies_off_is_proved_in_hundreds_of_nodes():
    """Late turns are settled first; without regard to their order it takes four times as many."""
    problem = Problem(
        step=0.5, horizon=20, forward=15.0, floor=floor('circle', 2.0 / 3.0, 4), max_rate=0.4363
    )
    rng = np.random.default_rng(35)
    place, velocity = rng.uniform(-20.0, 20.0, 2), rng.uniform(-8.0, 8.0, 2)
    start = State.at(np.zeros(2), rng.uniform(0.7, 1.0) * np.eye(2))
    targets = place + 0.5 * velocity * np.arange(1.0, 21.0)[:, None]
    problem = weighed(replace(problem, weights=Weights(1.0, 0.05, 0.0, 10.0)), 'time')
    plan = Solver(problem, gap_tolerance=1e-3).solve(start, targets)
    assert plan.status == 'optimal'
    assert plan.proof.nodes < 1100


@needs_machine_code
@pytest.mark.parametrize('horizon', [31, 45])
def test_horizons_of_many_short_steps_are_proved_as_well(horizon):
    problem = Problem(
        step=6.0 / horizon, horizon=horizon, forward=15.0, floor=floor('circle', 2.0 / 3.0, 4),
        max_rate=0.4363, discretisation='exact',
    )  # fmt: skip
    solver = Solver(problem)
    for goal in ([60.0, 20.0], [-40.0, 30.0]):
        goals = np.tile(goal, (horizon, 1))
        assert solver.solve(State.at(np.zeros(2), np.eye(2)), goals).status == 'optimal'


@needs_machine_code
@pytest.mark.parametrize(('shape', 'faces'), [('circle', 4), ('polygon', 12)])
def test_ways_in_a_plane_hold_every_limit_of_space(shape, faces):
    rng = np.random.default_rng(57)
    for order in (1, 1, 2, 2):
        how = ['euler', 'exact', 'held'][int(rng.integers(order + 1))]
        made = random_problem(rng, shape, faces, dimension=3, horizon=10)
        problem = replace(made, translation_order=order, discretisation=how)
        found = PlanarWay(problem, 1e-5)
        for away in (None, np.zeros(3), -1.0, 1.0):  # anywhere, here, right behind, right ahead
            start, targets = random_start(rng, problem)
            start = replace(start, disturbance=0.2 * problem.forward * rng.normal(size=3) / 1.8)
            if away is not None:
                start = replace(start, disturbance=np.zeros(3), velocity=np.zeros(3))
                targets = start.position + away * 9.0 * start.attitude[:, [0]].T * np.ones((10, 1))
            way = found.way(Request(start, targets, out_of_time=lambda: True))
            known = problem, start, targets
            plan = assemble(*known, way, projection='thrust_aligned', proof=UNPROVED)
            assert violations(*known, plan) == []


@needs_machine_code
def test_who_turns_in_a_plane_of_space_costs_no_more_than_in_the_plane():
    rng = np.random.default_rng(58)
    for _ in range(6):
        flat = replace(random_problem(rng, 'circle', 4, horizon=10), weights=Weights(1.0, 0.0))
        start, targets = random_start(rng, flat)
        best = Solver(flat, gap_tolerance=1e-5).solve(start, targets)
        tilted = exp(rng.normal(size=3))
        plane, q = tilted[:, :2], np.eye(3)
        q[:2, :2] = start.attitude
        here = State.at(
            plane @ start.position,
            np.linalg.norm(start.rotation[:, 0]) * tilted @ q,
            attitude=tilted @ q,
        )
        problem, goals = replace(flat, dimension=3), targets @ plane.T
        way = PlanarWay(problem, 1e-7).way(Request(here, goals))
        assert trajectory_of(problem, here, goals, way).cost <= best.objective * (1.0 + 1e-5)


@pytest.mark.parametrize('n', [2, 3])
def test_what_stands_in_turns_round_as_fast_as_it_may(n):
    problem = Problem(n, horizon=12, step=0.5, floor=floor('circle', 0.9), max_rate=0.4)
    behind = np.tile(-9.0 * np.eye(n)[0], (12, 1))
    start = State.at(np.zeros(n), np.eye(n))
    *_, there = straight(problem, start, behind)
    known = problem, start, behind
    plan = assemble(*known, coordinates(there), projection='thrust_aligned', proof=UNPROVED)
    assert violations(*known, plan) == []
    assert angles(start, plan)[:11] == pytest.approx(0.2, rel=1e-6)
