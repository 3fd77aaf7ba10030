# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bounds of problems with cones of tilt, glide slope and approach, counted again."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from counting import changed, counted, said, solved

from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Approach, Floor, Weights
from orbimpc_ros.mpc.problem.cones import relief
from orbimpc_ros.mpc.proof.choices import choices_bound
from orbimpc_ros.mpc.proof.grounds import LEAF, ChoiceGrounds
from orbimpc_ros.mpc.proof.recount import Recount
from orbimpc_ros.mpc.proof.sides import Sides
from orbimpc_ros.mpc.proof.slopes import terms_of
from orbimpc_ros.mpc.solve.solver import Solver

pytestmark = pytest.mark.skipif(not COMPILED, reason='the search that leaves trees needs numba')
ARRIVES = {'terminal': 'constraint'}
LONG, FUEL = {'weights': Weights(1.0, 0.05, 0.3, 10.0)}, {'weights': Weights(1.0, 0.0, 0.3, 10.0)}
AHEAD = {'approach': Approach(0.3, (1.0, 0.5))}
DESCENT = {'translation_order': 2, 'tilt': 0.3, 'glide_slope': 0.4}
IDLING = {'floor': Floor('circle', fraction=0.3)}
KINDS = {
    'approach': ('approach', {}),
    'approach, arrival': ('approach', ARRIVES | LONG),
    'approach, boxes': ('boxes, inertia', AHEAD),
    'approach, faces': ('polygon', AHEAD),
    'approach, space': ('space, approach', {}),
    'approach, axes': ('axes, boxes', FUEL | {'approach': Approach(0.2, (1.0, 0.5, 0.1))}),
    'cones': ('cones', FUEL),
    'cones, boxes': ('axes, boxes', FUEL | DESCENT),
    'cones, rotations': ('space, boxes', DESCENT),
    'cones, rotations, lengths': ('cones', LONG | IDLING),
    'cones, faces, lengths': ('cones', LONG | {'floor': Floor('polygon', 6, 0.4)}),
    'slope, rotations, lengths': ('cones', LONG | IDLING | {'tilt': 0.0}),
    'cones, boxes, lengths': ('space, boxes', LONG | DESCENT),
    'boxes, lengths': ('space, boxes', LONG),
    'approach, space, lengths': ('space, approach', LONG),
}


def posed(kind, seed):
    base, changes = KINDS[kind]
    return solved(base, seed, **changes)


@pytest.mark.parametrize(('kind', 'seed'), [*itertools.product(KINDS, range(2))])
def test_what_a_search_proves_within_cones_is_proved_by_its_tree(kind, seed):
    case, plan = posed(kind, seed)
    assert isinstance(plan.proof.grounds, ChoiceGrounds)
    assert plan.proof.checked
    again = counted(case, plan)
    assert (1.0 - 1e-9) * said(case) <= again <= plan.objective * (1.0 + 1e-7)


def test_trees_within_cones_are_counted_by_the_same_machine_code():
    for kind in ('approach, faces', 'cones', 'cones, rotations, lengths'):
        counted(*posed(kind, 0))
    assert len(choices_bound.signatures) == 1  # else a tick would wait for it


@pytest.mark.parametrize('kind', ['approach', 'approach, axes', 'cones', 'cones, rotations'])
def test_no_multipliers_of_cones_prove_more_than_a_trajectory_costs(kind):
    case, plan = posed(kind, 4)
    grounds, rng = plan.proof.grounds, np.random.default_rng(9)
    most = plan.objective * (1.0 + 1e-7)
    assert grounds.leans.shape[1] > 0
    for _ in range(150):
        leans = grounds.leans * rng.uniform(0.0, 3.0, grounds.leans.shape)
        leans += rng.choice([0.0, 0.1, 1.0]) * rng.normal(size=leans.shape)
        assert counted(case, plan, leans=leans) <= most
        presses = grounds.presses * rng.uniform(0.0, 2.0, grounds.presses.shape)
        assert counted(case, plan, leans=leans, presses=presses) <= most
    assert counted(case, plan, leans=changed(grounds.leans, (0, -1, 0), np.nan)) == -np.inf
    for twice in range(3):
        leans = np.concatenate([grounds.leans] * 2, axis=twice)
        assert counted(case, plan, leans=leans) == -np.inf
    before = counted(case, plan)
    assert counted(case, plan, leans=grounds.leans[:0]) <= before * (1.0 + 1e-9)


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('kind', ['cones, rotations, lengths', 'approach, space, lengths'])
def test_no_ways_of_lengths_prove_more_than_a_trajectory_costs(kind, seed):
    case, plan = posed(kind, seed)
    grounds, rng = plan.proof.grounds, np.random.default_rng(seed)
    most = plan.objective * (1.0 + 1e-7)
    for _ in range(150):
        ways = grounds.ways * rng.uniform(0.0, 3.0, (*grounds.ways.shape[:2], 1))
        ways += rng.choice([0.0, 0.1, 1.0]) * rng.normal(size=ways.shape)
        assert counted(case, plan, ways=ways) <= most
    assert counted(case, plan, ways=3.0 * grounds.ways) > 0.0  # as if they were no longer than 1
    for wrong in (np.nan, np.inf):
        assert counted(case, plan, ways=changed(grounds.ways, (0, 0, 0), wrong)) == -np.inf
    for twice in range(3):
        ways = np.concatenate([grounds.ways] * 2, axis=twice)
        assert counted(case, plan, ways=ways) == -np.inf


def test_lengths_count_for_what_a_floor_leaves_of_them():
    """Where headings of the relaxation are slower than the floor."""
    case, plan = solved('cones', 0, **IDLING, weights=Weights(1.0, 0.05, 3.0, 10.0))
    grounds = plan.proof.grounds
    sizes = np.linalg.norm(grounds.ways, axis=2)
    assert ((sizes > 0.01) & (sizes < 0.99)).any()
    before, full = counted(case, plan), grounds.ways / sizes[:, :, None]
    assert (1.0 - 1e-9) * said(case) <= before <= plan.objective * (1.0 + 1e-7)
    assert counted(case, plan, ways=full) < (1.0 - 1e-4) * before
    assert counted(case, plan, ways=0.0 * full) < (1.0 - 1e-4) * before


def test_multipliers_of_cones_hold_what_they_do():
    case, plan = posed('approach', 1)
    grounds, before = plan.proof.grounds, counted(*posed('approach', 1))
    assert counted(case, plan, leans=0.0 * grounds.leans) < (1.0 - 1e-6) * before
    wider = replace(case.problem, approach=replace(case.problem.approach, cone=0.4))
    again = Recount(wider).bound(*case[1:], grounds, plan.proof.cost_unit)
    assert again < (1.0 - 1e-6) * before


@pytest.mark.parametrize(('kind', 'seed'), [*itertools.product(KINDS, range(2))])
def test_plans_lie_in_the_cones_as_they_are_stated_here(kind, seed):
    case, plan = posed(kind, seed)
    sides = Sides(case.problem, terms_of(case.problem))
    places, always = sides.places(case.state), sides.always(case.state, case.goals)
    led = places.free + places.maps @ plan.rotations[1:, :, 0]
    past = np.einsum('ij,ij->i', led[always.places], always.normals) - always.offsets
    assert (past > -2e-6).all()
    away = led[always.cones.places] - always.cones.tips
    along = np.einsum('ij,ij->i', away, always.cones.axes)
    cosines = np.sqrt(1.0 - always.cones.sines**2)
    assert (cosines * np.linalg.norm(away, axis=1) - along <= always.cones.eased + 2e-6).all()


@pytest.mark.parametrize('seed', range(3))
def test_what_is_eased_counts_for_as_much_as_it_is(seed):
    """A state outside of its cones: the first steps are eased, the bound is the method's."""
    rng = np.random.default_rng(seed)
    case, _ = posed('cones, boxes', seed)
    problem = replace(case.problem, obstacles=())
    unit = problem.length_unit
    goals = np.tile(case.state.position + unit * np.array([2.0, 0.3, 0.2]), (problem.horizon, 1))
    blown = 0.4 * unit / problem.step**2 * rng.normal(size=3)
    state = replace(case.state, velocity=np.zeros(3), disturbance=blown)
    eased = relief(problem, state, goals)
    assert eased.slope.max() > 0.0
    case = case._replace(problem=problem, state=state, goals=goals)
    plan = Solver(problem).solve(*case[1:])
    assert plan.proof.checked
    again = counted(case, plan)
    assert (1.0 - 1e-9) * said(case) <= again <= plan.objective * (1.0 + 1e-7)


def test_a_tree_in_space_is_not_split_by_arcs_of_the_plane():
    """They do not cover a sphere."""
    case, plan = posed('cones', 1)
    grounds = plan.proof.grounds
    assert case.problem.floor == Floor('circle', fraction=0.1)
    parts = [np.array([1, *[0] * 4]), np.array([4, *[0] * 4]), np.zeros(5, int)]
    tree = ChoiceGrounds(
        np.array([0, *[LEAF] * 4]),
        *parts,
        np.array([0, 0, 1, 2, 3]),
        np.repeat(grounds.points[:1], 4, axis=0),
        np.zeros(4, bool),
        np.zeros(4, np.int64),
        *np.zeros((2, 0), np.int64),
        np.zeros(0),
        np.repeat(grounds.tethers[:1], 4, axis=0),
    )
    assert counted(case, plan, **tree._asdict()) == -np.inf
