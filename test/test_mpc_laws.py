# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Laws of plans, bounds and certificates that hold for every family of problems.

``ORBIMPC_SEEDS=1000:1020 pytest test/test_mpc_laws.py`` draws other problems (``make proofs``).
"""

import copy
import itertools
import json
import weakref
from dataclasses import replace
from typing import NamedTuple

import adversary
import numpy as np
import pytest
from plans import assembled, judged
from problems import FAMILIES, HELD_OUT, OPEN, case, needs_machine_code, polled, rotation, seeds

from orbimpc_ros.mpc.check import holds, margins, violations
from orbimpc_ros.mpc.errors import SolverFailure
from orbimpc_ros.mpc.geometry.rotations import coordinates
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.model.dynamics import trajectory_of
from orbimpc_ros.mpc.plan import Plan, shifted
from orbimpc_ros.mpc.problem import Ball, Box, Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.problem.reach import reach
from orbimpc_ros.mpc.proof.document import certificate_of, parsed, text_of, verified
from orbimpc_ros.mpc.solve.branch_and_bound import Search
from orbimpc_ros.mpc.solve.solver import Solver, Units

ROUNDING = 1e-7  # relative: the saving from constraint violations within tolerance
LOOSE = {*OPEN, 'acceleration', 'space, acceleration'}  # families whose gaps may stay open
POLLS = 400  # of the clock, until a search of an open family is out of time
# Families for which the fallbacks without a search may find no plan.
ARRIVING = {'turn rate, arrival', 'polygon, arrival', 'circle, turn rate, arrival'}
SOUGHT = {'approach', 'space, approach', 'axes, boxes', *ARRIVING}


class Solved(NamedTuple):
    family: str
    case: Case
    solver: Solver
    plan: Plan


def drawn():
    """Yield all families with all seeds; without machine code every fourth family only."""
    families = list(FAMILIES | OPEN)[:: 1 if COMPILED else 4]
    for family, seed in itertools.product(families, seeds(1)):
        marks = [needs_machine_code] if family in OPEN else []
        yield pytest.param((family, seed), id=f'{family}-{seed}', marks=marks)


@pytest.fixture(scope='module', params=drawn())
def solved(request):
    """A problem with its plan; module-wide, so that all laws are tested on one solution."""
    family, seed = request.param
    posed = case(family, seed)
    solver = Solver(posed.problem, coasting=posed.state.coasted is not None, patient=True)
    late = None if family in FAMILIES else polled(POLLS)
    return Solved(family, posed, solver, solver.solve(posed.state, posed.goals, None, late))


def test_a_plan_passes_the_check_and_is_proved(solved):
    family, posed, _, plan = solved
    assert violations(*posed.parts, plan) == []
    assert plan.proof.checked
    assert plan.lower_bound <= plan.objective * (1.0 + ROUNDING)
    assert plan.gap < 0.1 or family != 'shell, attitude'  # the axes alone bound it well
    assert plan.status == 'optimal' or HELD_OUT or family in LOOSE, plan.proof.reason
    for name, least in margins(*posed.parts, plan).items():
        assert least > -1e-5 * max(1.0, posed.problem.maps.unit), name
    away = np.linalg.norm(plan.positions - posed.state.position, axis=1)
    assert away.max() <= reach(posed.problem, posed.state) + 1e-9


def beside(problem, state, plan):
    """Return the least margin by which each step is on one side of each moving box."""
    ends, least = problem.step * np.arange(problem.horizon + 1), np.inf
    for each in state.hazards:
        if isinstance(each.body, Box):
            out = each.body.clearances(plan.positions - each.moved(ends))
            least = min(least, np.minimum(out[:-1], out[1:]).max(axis=1).min())
    return least


def test_no_legal_trajectory_costs_less_than_the_bound(solved):
    """Tested on perturbations of the plan, small and large, that satisfy all limits."""
    (problem, state, goals), plan = solved.case.parts, solved.plan
    rng, n = np.random.default_rng(7), problem.dimension
    first = problem.rotation_order  # at order 2 the state decides R_1, except its magnitude
    for _ in range(60):
        moved, size = plan.rotations[1:].copy(), 10.0 ** rng.uniform(-4, 0)
        for k in range(first - 1, len(moved)):
            moved[k] = moved[k] @ rotation(rng, n, size)
            moved[k] *= 1.0 - size * rng.uniform(-1.0, 1.0) * bool(rng.integers(2))
        other = assembled(problem, state, goals, coordinates(moved))
        kept = min(margins(problem, state, goals, other).values())
        kept = min(kept, beside(problem, state, other))
        if kept >= 0.0 and holds(problem, state, goals, other):
            assert other.objective >= plan.lower_bound * (1.0 - 1e-9)


def test_a_search_that_is_cut_short_has_a_legal_plan_and_a_sound_bound(solved):
    """Even without a single node: a fallback, such as holding the rotation, is the plan."""
    family, posed, solver, best = solved
    looks = itertools.count()
    solver.solve(posed.state, posed.goals, None, lambda: next(looks) >= POLLS)
    for limit in (0, 1, 3, 10, 50, next(looks) - 1):
        try:
            plan = solver.solve(posed.state, posed.goals, None, polled(limit))
        except SolverFailure:
            assert family in SOUGHT
            continue
        assert violations(*posed.parts, plan) == []
        assert plan.lower_bound <= best.objective * (1.0 + ROUNDING)
        assert plan.lower_bound >= 0.1 * best.lower_bound or limit < 50
        assert best.lower_bound <= plan.objective * (1.0 + ROUNDING)


def test_a_guess_leads_to_no_other_optimum(solved):
    """Guesses are the plan itself, another state's plan, and a plan with a false cost."""
    family, posed, solver, best = solved
    elsewhere = shifted(posed.problem, posed.state, best)
    for guess in (best, elsewhere, replace(best, objective=0.1 * best.objective)):
        plan = solver.solve(posed.state, posed.goals, guess, polled(POLLS))
        assert violations(*posed.parts, plan) == []
        assert plan.lower_bound <= best.objective * (1.0 + ROUNDING)
        if family in FAMILIES and guess is best:
            assert plan.objective <= best.objective * (1.0 + 1e-4)


def test_other_units_are_another_way_to_state_the_same(solved):
    (problem, state, goals), plan = solved.case.parts, solved.plan
    units, x = Units.of(problem), coordinates(plan.rotations[1:])
    known = units.problem, units.state(state), goals / units.length
    plain, scaled = trajectory_of(problem, state, goals, x), trajectory_of(*known, x)
    assert units.cost * scaled.objective == pytest.approx(plain.objective, rel=1e-9)
    np.testing.assert_allclose(
        units.length * scaled.positions, plain.positions, atol=1e-9 * problem.maps.unit
    )
    lengths = ('obstacle', 'hazard', 'glide_slope')
    kept = margins(*known, assembled(*known, x))
    for name, least in margins(problem, state, goals, plan).items():
        unit = units.length if name.startswith(lengths) else 1.0
        assert unit * kept[name] == pytest.approx(least, abs=1e-9 * problem.maps.unit)


@pytest.mark.parametrize('seed', seeds(40))
def test_no_flight_costs_less_than_the_bound_of_a_search(seed):
    """Random flights at the edge of their limits, in problems with limits of every kind."""
    flown = [*adversary.plans(seed, 60)]
    assert len(flown) > 20
    for index, drawn in enumerate(flown):
        (problem, state, goals), cost = drawn.case.parts, drawn.plan.objective
        solver = Solver(problem, coasting=state.coasted is not None)
        try:
            plan = solver.solve(state, goals, None, polled(100))
        except SolverFailure:
            continue
        assert violations(problem, state, goals, plan) == [], index
        assert plan.lower_bound <= cost * (1.0 + ROUNDING), index


@pytest.mark.parametrize('index', [10637, 27479, 36727])
def test_bounds_leave_what_rounding_takes(index):
    """An arrival exact up to rounding, a plan at its goal, and a cost far below its unit."""
    posed = adversary.flight(np.random.default_rng([817735, index])).case.parts
    plan = Solver(posed[0], coasting=posed[1].coasted is not None).solve(*posed[1:])
    assert plan.lower_bound <= plan.objective
    assert verified(parsed(text_of(certificate_of(*posed, plan.proof)).encode())).holds


@pytest.mark.parametrize(
    ('family', 'seed'),
    [('hull, arrival', 7101), ('hull, inertia, arrival', 7100), ('acceleration, discs', 7100)],
)
def test_a_plan_that_arrives_or_evades_needs_no_search(family, seed):
    posed = case(family, seed)
    plan = Solver(posed.problem).solve(posed.state, posed.goals, None, polled(0))
    assert violations(*posed.parts, plan) == []


@pytest.mark.parametrize('index', [615, 5965, 21072, 41971])
def test_a_search_that_finds_nothing_leaves_a_plan_all_the_same(index):
    """Arrivals in a cone of approach, and among bodies, from a search that is stopped early."""
    posed = adversary.flight(np.random.default_rng([411128, index])).case.parts
    found = Solver(posed[0]).solve(*posed[1:], out_of_time=polled(400))
    assert violations(*posed, found) == []


SHELL = {'dimension': 3, 'horizon': 4, 'weights': Weights(0.0, 0.0, 1.0, 1.0)}
BESIDE = {'horizon': 20, 'max_rate': 0.5, 'obstacles': (Ball([-4.0, 2.0], 1.0),)}


@needs_machine_code
@pytest.mark.parametrize(
    ('given', 'goal', 'polls'), [(SHELL, 3 * [0.0], (20, 2000)), (BESIDE, [-6.0, 2.0], (15, 100))]
)
def test_the_first_of_two_searches_leaves_time_to_the_general_one(given, goal, polls):
    problem, n = Problem(**given, floor=Floor('circle')), len(goal)
    posed = State.at(np.zeros(n), np.eye(n)), np.tile(goal, (problem.horizon, 1)), None
    solved = [Solver(problem, patient=True).solve(*posed, polled(most)).proof for most in polls]
    assert solved[0].nodes < 10 < solved[1].nodes


def test_a_tree_is_freed_in_the_time_of_the_next_search(monkeypatch):
    """A large one takes tens of milliseconds, which are not left after a deadline."""
    posed, alive, run = case('boxes'), weakref.WeakSet(), Search.run
    monkeypatch.setattr(Search, 'run', lambda self, *a, **k: alive.add(self) or run(self, *a, **k))
    solver = Solver(posed.problem)
    for _ in range(2):
        solver.solve(posed.state, posed.goals)
        assert len(alive) == 1


@pytest.fixture(scope='module')
def certificate(solved):
    """The plan's certificate; None for an open family, if its search leaves a tree."""
    tree = solved.plan.proof.tree
    if solved.family in OPEN and (tree is None or len(tree.nodes) > 1):
        return None
    return certificate_of(*solved.case.parts, solved.plan.proof)


def test_a_bound_is_verified_in_fractions(solved, certificate):
    if certificate is not None:
        verdict = verified(parsed(text_of(certificate).encode()))
        assert verdict.holds
        assert verdict.claimed == max(0.0, solved.plan.lower_bound)
        assert verdict.proved <= solved.plan.objective * (1.0 + ROUNDING)


def raised(known):
    known['lower_bound'] *= 1.01


def near(known):
    """Move the goals to the vehicle, which removes most of the cost."""
    known['goals'] = [known['state']['position']] * len(known['goals'])
    for name in ('disturbance', 'velocity'):
        known['state'][name] = [0.0] * len(known['state'][name])
    known['problem']['terminal'] = 'penalty'
    known['tree'].pop('pull', None)


def with_another_horizon(known):
    known['problem']['horizon'] += 1


def test_a_changed_certificate_proves_nothing(solved, certificate):
    if certificate is None:
        return
    given = (FAMILIES | OPEN)[solved.family]
    bound_to_leave = {'floor', 'rotation_order', 'approach'}.intersection(given)
    for change in (raised, near, with_another_horizon):
        if change is near and bound_to_leave:
            continue  # these vehicles cannot stay in place
        known = copy.deepcopy(certificate)
        change(known)
        assert judged(json.dumps(known)) != 'holds', change.__name__


BOX, DISC = Box(np.array([1.2, -0.3]), np.array([2.4, 0.4])), Ball(np.array([1.6, 0.1]), 0.5)


@pytest.mark.parametrize('body', [BOX, DISC])
def test_a_proof_beside_a_body_depends_on_it(body):
    problem = Problem(horizon=4, obstacles=(body,))
    state, goals = State.at(np.zeros(2), np.eye(2)), np.tile([3.5, 0.0], (4, 1))
    plan = Solver(problem).solve(state, goals)
    free = Solver(replace(problem, obstacles=())).solve(state, goals)
    assert plan.lower_bound > 1.001 * free.objective
    known = certificate_of(problem, state, goals, plan.proof)
    for each in known['limits']['bodies']:
        each.update({'radius': 0.1} if 'radius' in each else {'max': [1.3, -0.2]})
    assert judged(json.dumps(known)) == 'does not hold'
    known['limits']['bodies'] = []
    assert judged(json.dumps(known)) != 'holds'
