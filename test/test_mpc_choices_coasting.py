# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bounds from a body rate on, where the state decides R_1, counted again with choices."""

import itertools
from dataclasses import replace
from functools import cache

import certified
import numpy as np
import problems
import pytest
from counting import changed, counted

from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Floor, Weights
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.proof.grounds import ChoiceGrounds
from orbimpc_ros.mpc.proof.kept import kept
from orbimpc_ros.mpc.proof.recount import Recount
from orbimpc_ros.mpc.proof.verifier import parsed, verified
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Solver

pytestmark = pytest.mark.skipif(not COMPILED, reason='the search that leaves trees needs numba')
LONG = {'weights': Weights(1.0, 0.05, 0.3, 10.0)}
CUBE, ROUND = {'floor': Floor('polygon', 6, 0.4)}, {'floor': Floor('circle', fraction=0.5)}
SHORT = {'horizon': 3}
KINDS = {
    'hull': ('hull', SHORT),
    'hull, length': ('hull', SHORT | LONG),
    'faces': ('polygon', {}),
    'faces, arrival': ('polygon', {'terminal': 'constraint'}),
    'faces, boxes': ('boxes', {'floor': Floor('polygon', 5, 0.5)}),
    'arcs, length': ('circle, length', {'horizon': 4}),
    'boxes': ('boxes, shared faces', {}),
    'boxes, inertia': ('boxes, inertia', {}),
    'boxes that move': ('boxes that move', {}),
    'discs': ('discs', ROUND),
    'approach': ('approach', {}),
    'space': ('space', SHORT),
    'space, arrival': ('space, arrival', SHORT | LONG),
    'space, soft arrival': ('space', {'arrival_weight': 5.0}),
    'space, faces': ('space', CUBE | LONG),
    'space, boxes': ('space, boxes', {}),
    'space, boxes, faces': ('space, boxes', CUBE | {'horizon': 4}),
    'axes, boxes': ('axes, boxes', {}),
}


@cache
def posed(kind, seed, coasting):
    """Return the first of a seed's problems at rotation order 2 that has a plan, with both."""
    name, changes = KINDS[kind]
    rng = np.random.default_rng([seed, *kind.encode()])
    while True:
        case = certified.case(name, rng, longest=5)
        problem, state = replace(case.problem, rotation_order=2, **changes), case.state
        n = problem.dimension
        if coasting:
            state = replace(state, coasted=state.attitude @ problems.rotation(rng, n, 0.2))
        else:
            state = replace(state, rotation_rate=np.zeros((n, n)))
        case = Case(problem, state, np.tile(case.goals[0], (problem.horizon, 1)))
        solver = Solver(problem, coasting=coasting)
        try:
            return case, solver, solver.solve(case.state, case.goals)
        except Infeasible:  # a body where the state already leads
            continue


def said(case, solver):
    """Return the bound that a solver's method gives of itself."""
    units, method = solver._units, solver._method_for(case.state)
    found = method.solve(Request(units.state(case.state), units.lengths(case.goals)))
    return units.cost * found.lower_bound


@pytest.mark.parametrize(
    ('kind', 'seed', 'coasting'), [*itertools.product(KINDS, range(2), (True, False))]
)
def test_what_a_search_proves_from_a_body_rate_on_is_proved_by_its_tree(kind, seed, coasting):
    case, solver, plan = posed(kind, seed, coasting)
    assert plan.proof.checked
    again = counted(case, plan)
    assert (1.0 - 1e-9) * said(case, solver) <= again <= plan.objective * (1.0 + 1e-7)


@pytest.mark.parametrize('kind', ['arcs, length', 'space', 'space, faces', 'boxes', 'axes, boxes'])
@pytest.mark.parametrize('coasting', [True, False])
def test_no_multipliers_from_a_body_rate_on_prove_more_than_a_trajectory_costs(kind, coasting):
    case, _, plan = posed(kind, 4, coasting)
    grounds, rng = plan.proof.grounds, np.random.default_rng(9)
    assert isinstance(grounds, ChoiceGrounds)
    most = plan.objective * (1.0 + 1e-7)
    for _ in range(100):
        size = rng.choice([0.0, 0.1, 1.0])
        points = grounds.points + size * rng.normal(size=grounds.points.shape)
        presses = grounds.presses * rng.uniform(0.0, 2.0, grounds.presses.shape)
        assert counted(case, plan, points=points, presses=presses) <= most
    leaf = int(np.flatnonzero(~grounds.empty)[0])
    for step in (0, -1):
        points = changed(grounds.points, (leaf, step, 0), np.nan)
        assert counted(case, plan, points=points) == -np.inf


@pytest.mark.parametrize('kind', ['space', 'arcs, length'])
def test_what_the_state_decides_is_all_that_r_1_can_be(kind):
    """A bound for what is decided is none for another body rate, nor for one that is free."""
    case, _, plan = posed(kind, 1, coasting=True)
    grounds, unit, rng = plan.proof.grounds, plan.proof.cost_unit, np.random.default_rng(5)
    recount, n = Recount(case.problem), case.problem.dimension
    before = recount.bound(*case[1:], grounds, unit)
    for _ in range(5):
        turned = case.state.attitude @ problems.rotation(rng, n, 1.5)
        state = replace(case.state, coasted=turned)
        again = Solver(case.problem, coasting=True).solve(state, case.goals)
        most = again.objective * (1.0 + 1e-7)
        assert recount.bound(state, case.goals, grounds, unit) <= most
    given = replace(case.state, coasted=None, rotation_rate=np.zeros((n, n)))
    assert recount.bound(given, case.goals, grounds, unit) != before


def test_a_share_of_what_coasts_is_no_slower_than_the_floor():
    """A length pulls it there."""
    case, solver, plan = posed('arcs, length', 0, coasting=True)
    slow = plan.rotations[1, :, 0]
    assert np.linalg.norm(slow) == pytest.approx(case.problem.floor.fraction, abs=1e-6)
    before = counted(case, plan)
    assert before >= (1.0 - 1e-9) * said(case, solver)
    free = replace(case.problem, floor=Floor('circle', fraction=0.1))
    lower = Recount(free).bound(*case[1:], plan.proof.grounds, plan.proof.cost_unit)
    assert lower < (1.0 - 1e-4) * before


@pytest.mark.parametrize(('kind', 'seed'), [('space, faces', 0), ('faces, arrival', 1)])
def test_what_the_state_decides_against_is_empty_and_nothing_else(kind, seed):
    case, _, plan = posed(kind, seed, coasting=True)
    grounds = plan.proof.grounds
    assert grounds.splits[0] == 0  # by the face of R_1, whose direction is known
    assert grounds.empty.any()
    for leaf in np.flatnonzero(~grounds.empty):
        empty = changed(grounds.empty, leaf, value=True)
        for size in (1.0, 1e3):
            assert counted(case, plan, empty=empty, presses=size * grounds.presses) == -np.inf


@pytest.mark.parametrize('kind', ['hull', 'space', 'space, soft arrival'])
@pytest.mark.parametrize('coasting', [True, False])
def test_hulls_that_the_cone_program_bounds_have_certificates(kind, coasting):
    case, _, plan = posed(kind, 2, coasting)
    assert isinstance(plan.proof.grounds, ChoiceGrounds)
    assert verified(parsed(kept(*case, plan.proof).text().encode())).holds


@pytest.mark.parametrize('kind', ['faces', 'boxes', 'hull, length'])
def test_there_are_no_words_yet_for_trees_from_a_body_rate_on(kind):
    case, _, plan = posed(kind, 2, coasting=True)
    assert isinstance(plan.proof.grounds, ChoiceGrounds)
    assert kept(*case, plan.proof) is None


def test_nothing_is_counted_with_a_turn_limit_from_a_body_rate_on():
    case, _, plan = posed('boxes', 0, coasting=True)
    other = Recount(replace(case.problem, max_rate=1.0))
    assert not other.knows(plan.proof.grounds)
    assert other.bound(*case[1:], plan.proof.grounds, 1.0) == -np.inf
