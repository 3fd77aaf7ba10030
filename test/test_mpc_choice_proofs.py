# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Searches over choices prove their bounds: faces, patches, sides of bodies, and what couples."""

from dataclasses import replace

import numpy as np
import pytest
from problems import goals, state, weights

from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.cells import cap
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Ball, Box, Floor, Problem, Weights
from orbimpc_ros.mpc.problem.approach import Approach
from orbimpc_ros.mpc.proof.sets import in_both
from orbimpc_ros.mpc.proof.tree import EMPTY, LEAF
from orbimpc_ros.mpc.proof.verify import Verifier
from orbimpc_ros.mpc.solve import choice_tree
from orbimpc_ros.mpc.solve.disjunctive_bnb import DisjunctiveSearch
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.spatial_bnb import SpatialSearch

HORIZON = 4
ROUND = Floor('circle', fraction=0.4)


def box(n):
    return (Box(np.full(n, 0.6), np.full(n, 1.2)),)


def ball(n):
    return (Ball(np.full(n, 0.9), 0.5),)


PLANE = {
    'hull': {},
    'polygon': {'floor': Floor('polygon', 4, 0.4)},
    'arcs': {'floor': ROUND},
    'box': {'obstacles': box(2)},
    'disc': {'obstacles': ball(2)},
    'turns, disc': {'obstacles': ball(2), 'floor': ROUND, 'max_rate': 0.9},
    'turns, polygon, disc': {
        'obstacles': ball(2), 'floor': Floor('polygon', 5, 0.4), 'max_rate': 0.9
    },
    'turns, box': {'obstacles': box(2), 'floor': ROUND, 'max_rate': 0.9},
    'turns, approach': {'floor': ROUND, 'max_rate': 0.9, 'approach': Approach(0.6, (1.0, 0.0))},
    'chords, disc': {'obstacles': ball(2), 'max_rate': 0.9},
    'coasting, polygon': {'rotation_order': 2, 'floor': Floor('polygon', 4, 0.4)},
    'coasting, disc': {'rotation_order': 2, 'obstacles': ball(2)},
    'arrival, box': {'terminal': 'constraint', 'obstacles': box(2)},
}  # fmt: skip
SPACE = {
    'hull': {},
    'arrival': {'terminal': 'constraint'},
    'faces': {'floor': Floor('polygon', 6, 0.4)},
    'patches': {'floor': ROUND},
    'box': {'obstacles': box(3), 'floor': ROUND},
    'ball': {'obstacles': (Ball([0.9, 0.9, 0.9], 0.3),)},
    'turns': {'floor': ROUND, 'max_rate': 0.9},
    'approach': {'floor': ROUND, 'approach': Approach(0.6, (1.0, 0.0, 0.0))},
    'cones': {'translation_order': 2, 'glide_slope': 0.3, 'tilt': 0.8},
    'coasting': {'rotation_order': 2},
    'coasting, faces': {'rotation_order': 2, 'floor': Floor('polygon', 6, 0.4)},
}
KINDS = [(2, key, False) for key in PLANE] + [(3, key, axes) for key in SPACE for axes in (0, 1)]


@pytest.fixture(autouse=True)
def whole(monkeypatch):
    """Proofs are written to their end, though searches here run out of time."""
    monkeypatch.setattr(choice_tree, 'LATE_NODES', 10**6)


def posed(n, key, axes, seed):
    """A problem of a kind, whose cost sees thrust axes alone or all of a rotation."""
    rng = np.random.default_rng(seed)
    changes = {'translation_order': int(rng.integers(1, 3)), **(PLANE if n == 2 else SPACE)[key]}
    drawn = weights(rng) if n == 3 else replace(weights(rng), length=0.0)
    if axes:
        drawn = replace(drawn, input=0.0, terminal=1.0)
    problem = Problem(dimension=n, horizon=HORIZON, weights=drawn, **changes)
    start = replace(
        state(rng, problem, full_speed=False), disturbance=0.03 * np.arange(n, dtype=float)
    )
    wanted = goals(rng, problem, distance=1.0)
    if problem.obstacles:
        start = replace(start, position=np.zeros(n), velocity=np.zeros(n))
        wanted = np.tile(np.full(n, 1.8), (HORIZON, 1))
    return problem, start, wanted


def searched(problem, start, wanted, most=400):
    """What the general search finds in so many polls of the time."""
    polls = iter(range(most))
    request = Request(start, wanted, None, lambda: next(polls, None) is None, True)
    coasting = problem.rotation_order == 2
    try:
        return DisjunctiveSearch(problem, 1e-5, coasting=coasting).solve(request)
    except Infeasible:
        return None


@pytest.mark.skipif(not COMPILED, reason='multipliers of cone programs are not as good')
@pytest.mark.parametrize('seed', [1, 2])
@pytest.mark.parametrize(('n', 'key', 'axes'), KINDS)
def test_a_search_proves_its_bound(n, key, axes, seed):
    problem, start, wanted = posed(n, key, axes, seed)
    found = searched(problem, start, wanted)
    if found is None:
        return
    proved = Verifier(problem).bound(start, wanted, found.proof)
    assert proved >= found.lower_bound - 1e-4 * abs(found.lower_bound)
    assert proved <= found.cost + 1e-6 * (1.0 + abs(found.cost))


@pytest.mark.parametrize(('n', 'key', 'axes'), KINDS)
def test_no_multipliers_of_a_search_prove_more_than_a_trajectory_costs(n, key, axes):
    problem, start, wanted = posed(n, key, axes, 1)
    found = searched(problem, start, wanted)
    if found is None or found.x is None:
        return
    rng, verifier, tree = np.random.default_rng(3), Verifier(problem), found.proof
    for size in (1e-3, 0.1, 3.0):
        changed = tree._replace(
            point=tree.point + size * rng.normal(size=tree.point.shape),
            press=tree.press * rng.uniform(0.0, 1.0 + size, tree.press.shape),
            pull=tree.pull + size * rng.normal(size=tree.pull.shape),
            tether=tree.tether + size * rng.normal(size=tree.tether.shape),
            share=tree.share + size * rng.normal(size=tree.share.shape),
        )
        assert verifier.bound(start, wanted, changed) <= found.cost + 1e-6 * (1.0 + found.cost)


@pytest.mark.skipif(not COMPILED, reason='is about machine code: pip install numba')
@pytest.mark.parametrize('floor', [Floor(), Floor('polygon', 6, 0.4)])
@pytest.mark.parametrize('together', [False, True])
@pytest.mark.parametrize('seed', range(2))
def test_a_search_among_boxes_in_space_proves_its_bound(floor, together, seed):
    rng = np.random.default_rng(seed)
    problem = Problem(
        dimension=3,
        translation_order=1 + seed,
        horizon=6,
        weights=Weights(1.0, 0.05, 0.0, 3.0),
        floor=floor,
        obstacles=(*box(3), Box([-0.3, 1.0, 0.2], [0.4, 2.0, 2.0])),
        no_corner_cutting=together,
    )
    start = state(rng, problem, full_speed=False)
    start = replace(start, position=np.zeros(3), velocity=np.zeros(3))
    wanted = np.tile(np.full(3, 1.8), (6, 1))
    found = SpatialSearch(problem, 1e-6).solve(Request(start, wanted))
    assert found.cost - found.lower_bound <= 1e-5 * found.cost
    proved = Verifier(problem).bound(start, wanted, found.proof)
    assert proved >= found.lower_bound - 1e-5 * found.cost
    assert proved <= found.cost * (1.0 + 1e-6)


def test_a_proof_has_a_part_for_every_side():
    """Sides that nothing reaches are refuted, and not left out."""
    problem, start, wanted = posed(3, 'box', True, 1)
    kinds, _, _, counts, rows = searched(problem, start, wanted).proof.nodes.T
    inner = ~np.isin(kinds, (LEAF, EMPTY))
    assert (rows[~inner] >= 0).all()
    assert 1 + counts[inner].sum() == len(kinds)


@pytest.mark.parametrize('seed', range(20))
def test_the_least_over_a_patch_within_a_cone(seed):
    rng = np.random.default_rng(seed)
    angle, corners = rng.uniform(0.2, 1.0), rng.normal(size=(3, 3))
    if seed % 2:
        corners = cap(angle)[rng.integers(4)]
    cone, g = np.array([0.0, 0.0, 1.0, np.cos(angle), np.sin(angle)]), rng.normal(size=3)
    units = rng.dirichlet([0.5] * 3, size=100_000) @ corners
    units /= np.linalg.norm(units, axis=1, keepdims=True)
    inside = units[units[:, 2] >= np.cos(angle)]
    least = in_both(g, cone, corners)
    assert not len(inside) or least <= (inside @ g).min() + 1e-12
    assert len(inside) < 5000 or least >= (inside @ g).min() - 0.02
