# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Every engine asks for the time after each short slice of work, and ends soon after its deadline.

A slice is a call of machine code with a budget of work. Here budgets are the smallest possible, and
the calls are counted, so that nothing depends on how fast a machine is.
"""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from problems import floor, goals, state

from benchmarks.bench.instances import UP, landings
from benchmarks.bench.problems import lifted
from orbimpc_ros.loop import fallback as clearest_of
from orbimpc_ros.mpc.check import floor_margin, violations
from orbimpc_ros.mpc.errors import Infeasible, SolverFailure
from orbimpc_ros.mpc.kernels import COMPILED, annulus
from orbimpc_ros.mpc.kernels.linear import invert_spd, shift_to_semidefinite
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.problem import (
    Ball,
    Box,
    Floor,
    MovingObstacle,
    Problem,
    State,
    Weights,
    leaving,
    traffic,
)
from orbimpc_ros.mpc.search import engine
from orbimpc_ros.mpc.search.engine import Engine
from orbimpc_ros.mpc.solve import (
    annulus_newton,
    arc_search,
    choice_tree,
    disjunctive_bnb,
    hull_riccati,
    request,
    scouting,
    so3_multipliers,
    solver,
    stand_ins,
)
from orbimpc_ros.mpc.solve.annulus_newton import AnnulusNewton
from orbimpc_ros.mpc.solve.disjunctive_bnb import DisjunctiveSearch
from orbimpc_ros.mpc.solve.hull_riccati import HullRiccati
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Solver

pytestmark = pytest.mark.skipif(
    not COMPILED, reason="numba is not installed: pip install 'orbimpc_ros[fast]' runs these"
)
KERNELS = {
    annulus_newton: ('improve', 'improve_from_hull', 'climb'),
    arc_search: ('climb',),
    engine: ('search',),
    hull_riccati: ('settle',),
    so3_multipliers: ('minimise',),
}
ENGINES = {
    'circle': (AnnulusNewton, Problem(horizon=12, floor=floor('circle', 1.0))),
    'long circle': (AnnulusNewton, Problem(horizon=40, floor=floor('circle', 0.6))),
    'polygon': (Engine, Problem(horizon=12, floor=floor('polygon', 0.6, 6))),
    'hull': (HullRiccati, Problem(horizon=40, floor=Floor('none'))),
    'space': (DisjunctiveSearch, Problem(3, 2, 2, horizon=10, floor=Floor('none'))),
    'faces in space': (DisjunctiveSearch, Problem(3, horizon=6, floor=floor('polygon', 0.5, 6))),
}


class Watch:
    """A clock that slices of work move on, and what happens between two looks at it."""

    def __init__(self):
        self.begin(np.inf)

    def begin(self, limit):
        """Start anew, with a deadline after so many slices."""
        self.limit, self.slices, self.unseen, self.longest, self.looks = limit, 0, 0, 0, 0

    def counted(self, kernel):
        def call(*args):
            self.slices += 1
            self.unseen += 1
            self.longest = max(self.longest, self.unseen)
            return kernel(*args)

        return call

    def out_of_time(self):
        self.unseen = 0
        self.looks += 1
        return self.slices >= self.limit


@pytest.fixture
def watch(monkeypatch):
    found = Watch()
    for module, names in KERNELS.items():
        if hasattr(module, 'SLICE'):
            monkeypatch.setattr(module, 'SLICE', 1)
        for name in names:
            monkeypatch.setattr(module, name, found.counted(getattr(module, name)))
    return found


def asked(problem, seed):
    """Return a state, and a goal that makes work: one to circle, or to fly to at full speed."""
    rng = np.random.default_rng(seed)
    start = state(rng, problem)
    distance = 0.5 * problem.horizon if problem.floor.shape == 'none' else 0.1
    goal = start.position + distance * rng.normal(size=problem.dimension)
    return start, np.tile(goal, (problem.horizon, 1))


@pytest.mark.parametrize('kind', ENGINES)
def test_an_engine_looks_at_the_clock_between_slices_and_ends_after_its_deadline(watch, kind):
    method, problem = ENGINES[kind]
    solver, (start, targets) = method(problem, 1e-6), asked(problem, 3)
    watch.begin(400)
    solver.solve(Request(start, targets, out_of_time=watch.out_of_time))
    whole = watch.slices
    assert whole > 8  # or there would be nothing to look at
    assert watch.looks > 0.3 * whole
    for limit in np.linspace(1, whole - 1, 12).astype(int):
        watch.begin(limit)
        found = solver.solve(Request(start, targets, out_of_time=watch.out_of_time))
        assert watch.longest <= 3
        assert watch.slices <= limit + 3
        assert found.lower_bound <= found.cost * (1 + 1e-8)  # constraints hold to 1e-8


@pytest.mark.parametrize('kind', ['circle', 'long circle', 'polygon'])
def test_what_an_engine_returns_at_its_deadline_is_legal(watch, kind):
    method, problem = ENGINES[kind]
    solver, (start, targets) = method(problem, 1e-6), asked(problem, 4)
    for limit in (1, 2, 5, 20, 80):
        watch.begin(limit)
        x = solver.solve(Request(start, targets, out_of_time=watch.out_of_time)).x
        assert floor_margin(problem, x).min() >= -1e-9
        assert np.linalg.norm(x, axis=1).max() <= 1.0 + 1e-9


@pytest.mark.parametrize('fraction', [0.6, 1.0])
def test_a_newton_step_of_the_circle_is_interrupted_between_its_dampings(fraction):
    problem = Problem(horizon=10, floor=floor('circle', fraction))
    solver, interrupted = AnnulusNewton(problem, 1e-6), 0
    for seed in range(10):
        start, targets = asked(problem, seed)
        q, constant = solver._condensed.affine(start, targets)
        starts = np.zeros((0, *q.shape)), 6, -1.0  # a gap never so small: all six to their ends
        given = solver._annulus, q, np.zeros(0), constant, *starts
        whole, sliced = annulus.begun(*q.shape), annulus.begun(*q.shape)
        assert annulus.improve(*given, whole, np.inf)
        while not annulus.improve(*given, sliced, 1.0):
            # No step yet, and no start without one: its first step is still being damped.
            interrupted += sliced.counts[annulus.PLACED] == 1 and sliced.counts[annulus.STEPS] == 0
        assert (sliced.counts == whole.counts).all()
        cost, bound = whole.numbers[[annulus.COST, annulus.BOUND]]
        assert sliced.numbers[annulus.COST] == pytest.approx(cost, rel=1e-9)
        short = 1e-2 * (cost - bound) + 1e-9  # of what a matrix lacks, bounds know so many digits
        assert bound - short <= sliced.numbers[annulus.BOUND] <= cost + 1e-9
    assert interrupted > 0


@pytest.mark.parametrize('size', [1, 2, 5, 40])
def test_an_inverse_is_that_of_the_library(size):
    rng = np.random.default_rng(size)
    for _ in range(20):
        root = rng.normal(size=(size, size))
        matrix, inverse = root @ root.T + 0.1 * np.eye(size), np.empty((size, size))
        logarithm = invert_spd(matrix.copy(), inverse)
        assert logarithm == pytest.approx(np.linalg.slogdet(matrix)[1], rel=1e-9, abs=1e-9)
        assert inverse == pytest.approx(np.linalg.inv(matrix), rel=1e-7, abs=1e-7)
        assert invert_spd(matrix - 1e3 * np.eye(size), inverse) == -np.inf


@pytest.mark.parametrize('size', [1, 2, 5, 40])
def test_a_shift_is_next_to_the_least_that_makes_a_matrix_semidefinite(size):
    rng = np.random.default_rng(size)
    for power in range(-12, 3):
        values = np.append(rng.uniform(0.0, 1.0, size - 1), -(10.0**power))
        basis = np.linalg.qr(rng.normal(size=(size, size)))[0]
        matrix = (basis * values) @ basis.T
        least = -np.linalg.eigvalsh(matrix)[0]
        shift = shift_to_semidefinite(matrix, 1e-14, 1e4)
        assert least - 1e-14 <= shift <= 1.0011 * least + 1e-13
        assert shift_to_semidefinite(matrix, 1e-14, 0.5 * least) == np.inf
    assert shift_to_semidefinite(np.full((size, size), np.nan), 1e-14, 1e4) == np.inf


def test_the_bound_that_is_no_better_than_one_known_is_the_one_known():
    problem = Problem(horizon=6, floor=floor('circle', 0.6))
    solver, (start, targets) = AnnulusNewton(problem, 1e-6), asked(problem, 1)
    q, _ = Condensed(problem).affine(start, targets)
    rng = np.random.default_rng(2)
    z, theta = rng.normal(size=q.shape), rng.uniform(0.0, 50.0, len(q))
    rest = z, theta, np.ones(len(q)), np.zeros(0)
    bound = annulus.bound_at(solver._annulus, q, np.zeros(0), *rest, -np.inf)
    assert -np.inf < bound < 0.0
    for known in (bound - 1.0, bound + 1e-9, bound + 1.0):
        again = annulus.bound_at(solver._annulus, q, np.zeros(0), *rest, known)
        assert again == pytest.approx(max(bound, known), rel=1e-12)


def test_a_solver_out_of_time_from_the_start_has_a_plan():
    for _, problem in ENGINES.values():
        rng = np.random.default_rng(7)
        start, targets = state(rng, problem), goals(rng, problem)
        plan = Solver(problem).solve(start, targets, out_of_time=lambda: True)
        assert plan.lower_bound <= plan.objective


@pytest.mark.parametrize(
    'problem',
    [
        Problem(horizon=20, floor=floor('polygon', 0.548, 6)),
        Problem(horizon=40, floor=floor('circle', 0.548), max_rate=0.5),
    ],
)
def test_what_would_take_long_to_count_is_not_counted_after_the_deadline(monkeypatch, problem):
    solver, (start, targets), watch = Solver(problem), asked(problem, 5), Watch()
    monkeypatch.setattr(engine, 'search', watch.counted(engine.search))
    for allowed, counted in ((2000, False), (10**9, True)):
        monkeypatch.setattr(request, 'AFTERWARDS', allowed)
        watch.begin(10)
        proof = solver.solve(start, targets, out_of_time=watch.out_of_time).proof
        assert proof.lower_bound > 0.0
        assert proof.checked is (proof.tree is not None) is counted
        if counted:  # or there was nothing to save
            assert proof.tree.shor.size > 2000


def test_a_solver_does_not_count_what_its_method_was_just_in_time_to_tell(monkeypatch):
    problem = Problem(horizon=20, floor=floor('polygon', 0.548, 6))
    solver, (start, targets), calls = Solver(problem), asked(problem, 5), []

    def out_of_time():  # once the method has told
        calls.append(True)
        return told

    proof_of, told = engine.proof_of, False

    def told_of(tree):
        nonlocal told
        told = True
        return proof_of(tree)

    monkeypatch.setattr(engine, 'proof_of', told_of)
    proof = solver.solve(start, targets, out_of_time=out_of_time).proof
    assert (proof.checked, proof.tree) == (False, None)
    assert proof.lower_bound > 0.0


# --- what comes after the deadline, whoever solved

GRAVITY = np.array([0.0, 0.0, -9.81])
DESCENT = Problem(
    3, 1, 2, horizon=8, step=0.9, forward=20.0, weights=Weights(0.0, 0.01, 1.0, 0.0),
    terminal='constraint', floor=Floor('circle', fraction=0.3), discretisation='exact',
    tilt=0.26, glide_slope=0.87,
)  # fmt: skip
KINDS = {
    'bodies': (Problem(horizon=12, obstacles=(Box([2, -1], [4, 1]), Ball([3, 2], 1.5))), 0),
    'hazards': (Problem(horizon=12, max_rate=0.5), 3),
    'hazards and a floor': (Problem(horizon=10, floor=floor('circle'), max_rate=0.5), 3),
    'hazards in space': (Problem(3, 1, 2, horizon=8), 3),
    'hazards of a body that turns': (Problem(2, 2, 1, horizon=8), 2),
    'hazards and an arrival': (Problem(horizon=10, terminal='constraint'), 2),
    'hazards and an acceleration': (
        Problem(horizon=10, floor=floor('circle', 0.3), max_acceleration=0.2), 2
    ),
    'a descent': (DESCENT, 0),
    'faces of a body that turns': (Problem(3, 2, 2, horizon=8, floor=floor('polygon', 0.5, 6)), 0),
}  # fmt: skip


def among(problem, hazards, seed):
    """Return a state, perhaps inside of a body, and a goal beyond them."""
    rng, n = np.random.default_rng([77, seed]), problem.dimension
    if problem.has_cones:
        at = np.array([3.0, -2.0, 50.0]), 0.5 * UP
        start = State.at(*at, velocity=[0.5, 0.0, -5.0], attitude=UP, disturbance=GRAVITY)
        return start, np.zeros((problem.horizon, 3))
    bodies = [Ball(rng.uniform(0.3, 3.0) * rng.normal(size=n), 1.0) for _ in range(hazards)]
    moving = tuple(MovingObstacle.drifting(each, 0.3 * rng.normal(size=n)) for each in bodies)
    rotation = np.eye(n)
    coasted = rotation if problem.rotation_order == 2 else None
    start = State.at(np.zeros(n), rotation, coasted=coasted, hazards=moving)
    return start, np.tile(0.5 * problem.horizon * np.eye(n)[0], (problem.horizon, 1))


@pytest.fixture
def works(monkeypatch):
    """What is done since the clock was first seen to be late, by kind."""
    counts = SimpleNamespace(relaxed=0, checked=0, scouted=0)

    def counting(owner, name, kind):
        known = getattr(owner, name)

        def call(*args, **more):
            setattr(counts, kind, getattr(counts, kind) + 1)
            return known(*args, **more)

        monkeypatch.setattr(owner, name, call)

    counting(disjunctive_bnb.Posed, 'relax', 'relaxed')
    counting(solver, 'violations', 'checked')
    counting(scouting, 'advance', 'scouted')
    return counts


@pytest.mark.parametrize('kind', KINDS)
def test_once_late_little_is_done_and_a_plan_is_checked_or_declared_missing(works, kind):
    problem, hazards = KINDS[kind]
    made = Solver(problem, coasting=problem.rotation_order == 2)
    start, targets = among(problem, hazards, 1)
    if hazards:
        made.expect_hazards()

    def solved(limit):
        """Return how often the clock is looked at that is late from a look on, if it is."""
        looks = 0

        def out_of_time():
            nonlocal looks
            looks += 1
            if looks == limit:
                works.relaxed = works.checked = works.scouted = 0
            return looks >= limit

        try:
            plan = made.solve(start, targets, out_of_time=out_of_time)
        except (Infeasible, SolverFailure):
            plan = None
        if plan is not None:
            assert violations(problem, start, targets, plan) == []
            assert plan.lower_bound <= plan.objective * (1.0 + 1e-9)
        return looks

    whole = solved(np.inf)
    assert whole > 2
    for limit in np.unique(np.geomspace(1, whole, 10).astype(int)):
        solved(limit)
        assert works.relaxed <= 2
        assert works.scouted <= 1
        # A guess there is none: what was found, four ways straight on, up or there, a few turns.
        assert works.checked <= 1 + 5 + stand_ins.LATE


def test_no_more_than_a_few_turns_are_tried_once_time_is_up(monkeypatch):
    monkeypatch.setattr(stand_ins, 'LATE', 3)
    tried, late = [None, 1, None, 2, 3, 4, 5, 6], iter([False, False, False, True, True, True])
    assert list(stand_ins.in_time(tried, lambda: next(late))) == [1, 2, 3, 4]
    assert list(stand_ins.in_time(tried, None)) == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize('hazards', [False, True])
def test_the_ways_out_of_a_body_are_worked_out_once_for_a_state(monkeypatch, hazards):
    """Once in natural units, once as posed, for search, verifier, check and all that stands in."""
    ball, asked, inside = Ball([0.2, 0.1], 1.0), [], traffic.inside
    monkeypatch.setattr(traffic, 'inside', lambda *args: asked.append(args) or inside(*args))
    shut = Ball([0.0, 0.0], 30.0)  # there is no way out, so that everything is tried
    bodies = () if hazards else (ball, shut)
    moving = tuple(MovingObstacle.drifting(each, [0.1, 0.0]) for each in (ball, shut)) * hazards
    problem = Problem(horizon=6, step=0.5, forward=2.0, obstacles=bodies, max_rate=1.0)
    start = State.at([0.0, 0.0], np.eye(2), hazards=moving)
    with pytest.raises((Infeasible, SolverFailure)):
        Solver(problem).solve(start, np.tile([9.0, 0.0], (6, 1)), out_of_time=lambda: False)
    assert len(asked) == 2


def test_a_state_in_other_units_is_met_by_what_there_is_in_those():
    problem, body = Problem(horizon=4, step=0.5, forward=4.0), Ball([3.0, 0.0], 1.0)
    start = State.at([0.5, 0.0], np.eye(2), hazards=(MovingObstacle.drifting(body, [0.0, 0.0]),))
    units, known = solver.Units.of(problem), traffic.traffic_of(problem, start)
    assert traffic.traffic_of(replace(problem), start) is known
    assert traffic.traffic_of(units.problem, units.state(start)).bodies[0].radius == 0.5
    assert traffic.traffic_of(units.problem, start).bodies[0].radius == 1.0


def test_the_clearest_of_few_ways_is_flown_once_time_is_up(monkeypatch):
    made, assembled = [], clearest_of.assemble
    monkeypatch.setattr(
        clearest_of, 'assemble', lambda *args, **more: made.append(1) or assembled(*args, **more)
    )
    problem = Problem(horizon=6, step=0.5, forward=2.0, max_rate=1.0)
    near = MovingObstacle.drifting(Ball([1.2, 0.0], 1.0), [0.0, 0.0])
    start, targets = State.at([0.0, 0.0], np.eye(2), hazards=(near,)), np.tile([9.0, 0.0], (6, 1))
    counts, known = [], (problem, start, targets, None, 'thrust_aligned')
    for out_of_time in (lambda: True, None):
        made.clear()
        plan, _ = clearest_of.clearest(*known, out_of_time)
        assert plan is not None
        counts.append(len(made))
    assert counts[0] <= counts[1] / 2


def test_escapes_turn_as_fast_as_may_be_and_then_go_straight():
    """Stepped by hand: by the widest angle with a floor, and by the longest chord without."""
    rng = np.random.default_rng(8)
    for shape, n in (('none', 2), ('none', 3), ('circle', 2), ('circle', 3)):
        problem = Problem(n, horizon=12, floor=floor(shape, 0.4), max_rate=0.5)
        start, ways = state(rng, problem), leaving.directions(n)
        for way, z in zip(ways, leaving.escapes(problem, start, ways), strict=True):
            at = start.rotation[:, 0] / (np.linalg.norm(start.rotation[:, 0]))
            for k in range(1, 13):
                if shape == 'none':
                    left = way - z[k - 1]
                    share = min(1.0, problem.chord / max(np.linalg.norm(left), 1e-9))
                    np.testing.assert_allclose(z[k], z[k - 1] + share * left, atol=1e-9)
                else:
                    before, after = np.arccos(np.clip([at @ way, z[k] @ way], -1.0, 1.0))
                    assert after == pytest.approx(max(0.0, before - 0.5), abs=1e-6)
                    assert np.linalg.norm(z[k]) == pytest.approx(1.0)
                    at = z[k]


def test_a_landing_is_searched_no_further_than_its_gap_needs(monkeypatch):
    """Many ways to burn cost nearly the same: to the last digit none is proved the best."""
    monkeypatch.setattr(disjunctive_bnb, 'MAX_NODES', 150)
    problem = lifted()[1].problem
    made = Solver(problem, gap_tolerance=1e-3)
    for each in landings(problem, 3):
        plan = made.solve(each.state, each.goals)
        assert plan.status.name == 'OPTIMAL'
        assert plan.nodes < 150


@pytest.mark.skipif(not COMPILED, reason='the search that leaves trees needs numba')
def test_of_a_search_among_bodies_too_large_to_count_the_first_nodes_are_counted(monkeypatch):
    problem = Problem(horizon=6, obstacles=(Ball([2.0, 0.1], 0.6), Box([3.4, -1.0], [3.9, 0.4])))
    start, targets = State.at([0.0, 0.0], np.eye(2)), np.tile([5.0, 0.0], (6, 1))
    solver, polls = Solver(problem), itertools.count()
    best = solver.solve(start, targets)
    monkeypatch.setattr(choice_tree, 'LATE_NODES', 8)
    plan = solver.solve(start, targets, out_of_time=lambda: next(polls) > 60)
    assert plan.nodes > 8
    assert len(plan.proof.tree.nodes) <= 8
    assert plan.proof.checked
    assert 0.0 < plan.lower_bound <= best.objective * (1.0 + 1e-9)
