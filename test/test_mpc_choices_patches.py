# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Trees over patches of a sphere: round floors and balls in space, counted again."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from counting import changed, counted, mutants
from problems import rotation

from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.mpc.geometry.cells import cap, icosahedron, round_cells
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Ball, Box, Floor, MovingObstacle, Problem, State, Weights
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.proof.choices import choices_bound
from orbimpc_ros.mpc.proof.grounds import LEAF, ChoiceGrounds
from orbimpc_ros.mpc.proof.kept import kept
from orbimpc_ros.mpc.proof.patches import FINEST, set_corners, set_patch
from orbimpc_ros.mpc.proof.sides import CAPS, PATCHES, Sides
from orbimpc_ros.mpc.proof.slopes import terms_of
from orbimpc_ros.mpc.solve.solver import Solver

pytestmark = pytest.mark.skipif(not COMPILED, reason='the search that leaves trees needs numba')
COARSE, MOST = 0.02, 400  # what counts as proved; of nodes, about
TURNED = Weights(position=0.3, input=0.2, terminal=1.0)
FALL = np.array([0.0, 0.0, -1.62])
KINDS = ('floor, box', 'balls', 'ball that moves', 'turned', 'tilt')


def drawn(kind, rng):
    n, count = 3, 2 if 'tilt' not in kind else 4
    usual = {'dimension': n, 'horizon': count, 'weights': Weights(0.3, 0.0, 0.0, 1.0)}
    if 'ball' not in kind:
        usual['floor'] = Floor('circle', fraction=rng.uniform(0.4, 0.8))
    state, attitude = {}, rotation(rng, n)
    if kind == 'floor, box':
        usual['obstacles'] = (Box((0.7, -0.5, -0.5), (1.2, 0.5, 0.5)),)
    if kind == 'balls':
        usual['obstacles'] = (Ball((1.2, 0.1, 0.0), 0.6), Ball((-1.0, 0.4, 1.0), 0.7))
    if kind == 'ball that moves':
        usual |= {'translation_order': 2, 'discretisation': 'exact'}
        way = rng.uniform(-0.2, 0.2, n)
        state['hazards'] = (MovingObstacle.drifting(Ball((1.2, 0.1, 0.0), 0.5), way),)
    if kind == 'turned':
        usual['weights'] = TURNED
    if kind == 'tilt':
        usual |= {'translation_order': 2, 'tilt': rng.uniform(0.2, 0.9), 'forward': 3.6}
        attitude = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
        state['disturbance'] = FALL
    problem = Problem(**usual)
    if problem.inertial:
        state['velocity'] = rng.uniform(-0.3, 0.3, n)
    start = State.at(np.zeros(n), attitude, attitude=attitude, **state)
    toward = np.array([0.2, 0.1, -1.0]) if kind == 'tilt' else np.array([1.0, 0.1, 0.0])
    away = 0.8 * count * rng.uniform(0.2, 0.7) * toward * problem.length_unit
    return Case(problem, start, np.tile(away, (count, 1)))


def solved(kind, seed):
    """Return the first of a seed's problems whose tree is split, not too large, and a bound."""
    rng = np.random.default_rng([seed, *kind.encode()])
    while True:
        case, polls = drawn(kind, rng), itertools.count()
        solver = Solver(case.problem, gap_tolerance=COARSE)
        try:
            plan = solver.solve(
                case.state, case.goals, None, lambda polls=polls: next(polls) > MOST
            )
        except OrbimpcError:
            continue
        tree = plan.proof.grounds
        if isinstance(tree, ChoiceGrounds) and len(tree.splits) > 1 and plan.lower_bound > 0.0:
            return case, plan
    raise AssertionError('no problem of 40 takes a search')


@pytest.mark.parametrize(('kind', 'seed'), [*itertools.product(KINDS, range(2))])
def test_what_a_search_over_patches_proves_is_proved_by_its_tree(kind, seed):
    case, plan = solved(kind, seed)
    assert plan.proof.checked
    assert plan.lower_bound > 0.0
    again = counted(case, plan)
    assert (1.0 - 1e-9) * plan.lower_bound <= again <= plan.objective * (1.0 + 1e-7)
    assert len(choices_bound.signatures) == 1  # else a tick would wait for it


@pytest.mark.parametrize(('kind', 'seed'), [*itertools.product(KINDS, (4,))])
def test_no_change_of_a_tree_over_patches_proves_more_than_a_plan_costs(kind, seed):
    case, plan = solved(kind, seed)
    for changes in mutants(plan.proof.grounds, np.random.default_rng(seed), 300):
        assert counted(case, plan, **changes) <= plan.objective * (1.0 + 1e-7), list(changes)


@pytest.mark.parametrize('kind', ['floor, box', 'balls', 'tilt'])
def test_a_tree_that_leaves_out_a_patch_proves_nothing(kind):
    """But where nothing reaches it, as far as a plan can tell: so it does not prove too much."""
    case, plan = solved(kind, 1)
    grounds, left = plan.proof.grounds, 0
    for t in np.flatnonzero(grounds.splits != LEAF):
        fewer = changed(grounds.counts, t, grounds.counts[t] - 1)
        again = counted(case, plan, counts=fewer)
        assert again <= plan.objective * (1.0 + 1e-7)
        left += again == -np.inf
    assert left


def test_a_certificate_has_no_words_for_patches():
    for kind in ('balls', 'floor, box'):
        case, plan = solved(kind, 0)
        assert kept(*case, plan.proof) is None


def test_the_kinds_of_sides_are_those_within_the_tilt_unless_it_is_eased():
    case = drawn('tilt', np.random.default_rng(5))
    lying, slow = State.at(np.zeros(3), np.eye(3), disturbance=FALL), {'max_rate': 0.2}
    for state, changes, first in ((case.state, {}, CAPS), (lying, slow, PATCHES)):
        problem = replace(case.problem, **changes)
        sides = Sides(problem, terms_of(problem))
        known = sides.alternatives(state, case.goals, sides.places(state))
        assert known.kinds[0] == first


# --- geometry


def inside(corners, directions):
    """Return which directions are within which triangles, shape (M, K)."""
    return np.array(
        [np.linalg.solve(each.T, directions.T).min(axis=0) >= -1e-12 for each in corners]
    )


def parts(patches, level, side):
    corners = np.empty((4, 3, 3))
    for i in range(4):
        set_corners(patches, level + 1, 4 * side + i, corners[i])
    return corners


def test_patches_and_their_parts_leave_no_direction_out():
    rng = np.random.default_rng(2)
    around = rng.normal(size=(2000, 3))
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    patches = np.concatenate([icosahedron(), cap(0.7)])
    assert inside(icosahedron(), around).any(axis=0).all()
    upright = around[:, 2] >= np.cos(0.7)
    assert inside(cap(0.7), around[upright]).any(axis=0).all()
    for side, level in itertools.product(range(len(patches)), (0, 1, 2)):
        whole, at = np.empty((3, 3)), int(rng.integers(4**level)) + side * 4**level
        set_corners(patches, level, at, whole)
        shares = rng.dirichlet(np.ones(3), 50) @ whole
        assert inside(parts(patches, level, at), shares).any(axis=0).all()


def test_no_direction_of_a_patch_is_farther_from_its_middle_than_it_says():
    rng, normal, corners = np.random.default_rng(3), np.empty(3), np.empty((3, 3))
    patches = np.concatenate([icosahedron(), cap(0.3)])
    for level in (0, 1, 4, FINEST):
        for _ in range(50):
            side = int(rng.integers(len(patches))) * 4**level + int(rng.integers(4**level))
            share = set_patch(patches, level, side, normal)
            set_corners(patches, level, side, corners)
            within = rng.dirichlet(np.ones(3), 40) @ corners
            within /= np.linalg.norm(within, axis=1, keepdims=True)
            assert np.linalg.norm(normal) == pytest.approx(1.0)
            assert (within @ normal >= share - 1e-12).all()
            np.testing.assert_allclose(corners @ normal, share, atol=1e-12)


def test_patches_are_those_that_searches_choose_from():
    """Else what a search found would be counted as something else, and prove little."""
    normal, patches = np.empty(3), icosahedron()
    for i, cell in enumerate(round_cells(3, 0.5)):
        assert 0.5 * set_patch(patches, 0, i, normal) == pytest.approx(cell.offset)
        np.testing.assert_allclose(normal, cell.normal, atol=1e-12)
        for j, part in enumerate(cell.parts()):
            assert 0.5 * set_patch(patches, 1, 4 * i + j, normal) == pytest.approx(part.offset)
            np.testing.assert_allclose(normal, part.normal, atol=1e-12)
