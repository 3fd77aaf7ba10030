# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Laws of proofs: whatever a tree's numbers are, it proves no more than a trajectory costs."""

import math

import numpy as np
import pytest
from trees import KINDS, Growing, flown

from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.geometry.cells import icosahedron
from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.plan import UNPROVED, assemble
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.mpc.proof import sets
from orbimpc_ros.mpc.proof.limits import limits_of
from orbimpc_ros.mpc.proof.stated import Sets
from orbimpc_ros.mpc.proof.tree import ARCS, CUT, LEAF, one
from orbimpc_ros.mpc.proof.verify import Verifier, exact_bound

OF_A_COST = 1e-9
STRAYS = 'projec', 'R_1 strays'  # of what is no part of a trajectory


def drawn(kind, rng, count):
    """Yield trajectories that their problems allow."""
    for _ in range(count):
        case = flown(KINDS[kind], rng)
        known = case.problem, case.state, case.goals
        plan = assemble(*known, case.x, projection='thrust_aligned', proof=UNPROVED)
        flaws = [each for each in violations(*known, plan) if not any(s in each for s in STRAYS)]
        assert not flaws
        yield case


def seeded(kind):
    return np.random.default_rng([ord(each) for each in kind])


@pytest.mark.parametrize('kind', KINDS)
def test_no_tree_proves_more_than_a_trajectory_costs(kind):
    rng, proved = seeded(kind), 0
    for case in drawn(kind, rng, 12):
        verifier = Verifier(case.problem)
        for _ in range(6):
            tree = Growing(case, rng).tree(int(rng.integers(0, 8)))
            bound = verifier.bound(case.state, case.goals, tree)
            assert bound <= case.cost * (1.0 + OF_A_COST)
            proved += bound > -math.inf
    assert proved > 2


@pytest.mark.parametrize('kind', KINDS)
def test_fractions_prove_what_floats_do(kind):
    rng = seeded(kind)
    for case in drawn(kind, rng, 4):
        tree = Growing(case, rng).tree(int(rng.integers(0, 4)))
        known = case.problem, case.state, case.goals
        floats = Verifier(case.problem).bound(case.state, case.goals, tree)
        exact = exact_bound(*known, tree, limits_of(*known))
        assert floats <= exact
        assert exact == floats or exact - floats < 1e-9 * (abs(exact) + 1.0)


@pytest.mark.parametrize('kind', KINDS)
def test_trees_of_wrong_shape_prove_nothing(kind):
    rng = seeded(kind)
    for case in drawn(kind, rng, 6):
        tree = Growing(case, rng).tree(5)
        verifier = Verifier(case.problem)
        for _ in range(40):
            bound = verifier.bound(case.state, case.goals, _tampered(tree, rng))
            assert bound <= case.cost * (1.0 + OF_A_COST)


def _tampered(tree, rng):
    """Return a tree with a number that is another, an array that is shorter, or both."""
    name = str(
        rng.choice(['nodes', 'nodes', 'at', 'point', 'shor', 'press_end', 'press_row', 'press'])
    )
    value = getattr(tree, name).copy()
    if value.size and rng.integers(4):
        at = tuple(rng.integers(size) for size in value.shape)
        if value.dtype == float:
            value[at] = rng.choice([np.nan, np.inf, -np.inf, 1e300, -1e-300, rng.normal()])
        else:
            value[at] = rng.choice([value[at] + rng.integers(-3, 4), -1, 2**62, -(2**62)])
    else:
        value = value[:-1].copy() if rng.integers(2) else np.concatenate([value, value])
    return tree._replace(**{name: value})


def test_a_split_into_no_parts_proves_nothing():
    problem, rng = Problem(horizon=3, floor=Floor('circle', fraction=0.6)), np.random.default_rng(1)
    state, goals = State.at(np.zeros(2), np.eye(2)), rng.normal(size=(3, 2))
    tree = one(rng.normal(size=(3, 2)), np.zeros(3))
    for count in (0, -1, 1):
        nodes = np.array([[ARCS, 0, 1, count, -1], [LEAF, 0, 0, 0, 0]])
        forged = tree._replace(nodes=nodes, at=np.zeros(2))
        assert Verifier(problem).bound(state, goals, forged) == -math.inf


def test_two_parents_of_one_child_prove_nothing():
    problem, rng = Problem(horizon=3, floor=Floor('circle', fraction=0.6)), np.random.default_rng(1)
    state, goals = State.at(np.zeros(2), np.eye(2)), rng.normal(size=(3, 2))
    tree = one(rng.normal(size=(3, 2)), np.zeros(3))
    nodes = [[ARCS, 0, 1, 2, -1], [CUT, 0, 3, 2, -1], [CUT, 0, 3, 2, -1]] + [[LEAF, 0, 0, 0, 0]] * 2
    forged = tree._replace(nodes=np.array(nodes), at=np.array([0.0, 1.0, 4.0, 0.0, 0.0]))
    assert Verifier(problem).bound(state, goals, forged) == -math.inf


# --- support functions, by brute force


def stated_sets(**changes):
    known = {'least': 0.5, 'polygon': 0, 'faces': np.zeros((0, 2)), 'full': 2.0 * math.pi}
    nothing = {'cone_step': np.zeros(0, np.int64), 'cones': np.zeros((0, 6)), 'narrow': 1e-9}
    return Sets(**{**known, **nothing, **changes})


def held_against(least, points, g, length, curve):
    """Assert that a least value is one, and that it is next to what points come to."""
    sizes = np.linalg.norm(points, axis=1)
    found = (points @ g + length * sizes + 0.5 * curve * sizes**2).min()
    assert least <= found + 1e-12
    return found - least


@pytest.mark.parametrize('seed', range(60))
def test_the_least_over_a_sector(seed):
    rng = np.random.default_rng([7, seed])
    low = rng.uniform(-7.0, 7.0)
    high, slow = low + rng.choice([rng.uniform(0.0, 6.5), 0.01, math.pi]), rng.uniform(0.0, 1.0)
    fast = rng.uniform(slow, 1.0)
    span = np.array([[low, high], [slow, fast]])
    known = np.array([0, -1]), span, 1
    angles, speeds = np.meshgrid(np.linspace(low, high, 801), np.linspace(slow, fast, 101))
    points = (speeds * [np.cos(angles), np.sin(angles)]).reshape(2, -1).T
    g, length, curve = rng.normal(size=2), rng.choice([0.0, rng.uniform()]), rng.normal()
    least = sets.over_stage(stated_sets(least=slow), known, None, 0, g, length, curve, 2)
    assert held_against(least, points, g, length, curve) < 1e-3


@pytest.mark.parametrize('seed', range(60))
def test_the_least_beyond_a_polygon(seed):
    rng = np.random.default_rng([8, seed])
    faces = int(rng.integers(3, 9))
    floor = rng.uniform(0.1, 1.0) * math.cos(math.pi / faces)
    low = rng.uniform(-7.0, 7.0)
    high = low + rng.uniform(0.0, 3.0)
    known = np.array([0, -1]), np.array([[low, high], [floor, 1.0]]), 1
    angles = np.linspace(low, high, 2001)
    units = np.array([np.cos(angles), np.sin(angles)]).T
    reach = floor / (units @ normals(2, faces).T).max(axis=1)
    shares = np.linspace(0.0, 1.0, 21)[:, None]
    speeds = (1.0 - shares) * reach + shares
    points = (speeds[..., None] * units).reshape(-1, 2)
    for length, tight in ((0.0, True), (0.4, False)):
        g = rng.normal(size=2)
        made = stated_sets(least=floor, polygon=faces)
        least = sets.over_stage(made, known, None, 0, g, length, 0.0, 2)
        assert held_against(least, points, g, length, 0.0) < (1e-3 if tight else 10.0)


@pytest.mark.parametrize('seed', range(60))
def test_the_least_over_a_patch_of_a_shell(seed):
    rng = np.random.default_rng([9, seed])
    corners = icosahedron()[rng.integers(20)] * rng.uniform(0.5, 2.0, size=(3, 1))
    for _ in range(rng.integers(4)):
        a, b, c = corners
        corners = np.array([[a, a + b, c + a], [a + b, b + c, c + a]][rng.integers(2)])
    shares = rng.dirichlet(np.full(3, 0.5), size=4000)
    units = shares @ corners
    units /= np.linalg.norm(units, axis=1, keepdims=True)
    slow, g, curve = rng.uniform(), rng.normal(size=3), rng.normal()
    points = np.concatenate([speed * units for speed in np.linspace(slow, 1.0, 21)])
    known = np.array([0, -1]), np.array([[0.0, 0.0], [slow, 1.0]]), 1
    made = stated_sets(faces=np.zeros((0, 3)), cones=np.zeros((0, 7)), least=slow)
    least = sets.over_stage(made, known, corners, 0, g, 0.2, curve, 3)
    assert held_against(least, points, g, 0.2, curve) < 0.05


@pytest.mark.parametrize('seed', range(40))
def test_the_least_beyond_a_face_and_within_a_cone(seed):
    rng = np.random.default_rng([10, seed])
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    g, floor = rng.normal(size=3), rng.uniform(0.1, 0.9)
    units = rng.normal(size=(20000, 3))
    units /= np.linalg.norm(units, axis=1, keepdims=True)
    points = units * rng.uniform(size=(20000, 1)) ** 0.2
    beyond = np.concatenate([points, units])
    beyond = beyond[beyond @ axis >= floor]
    least = sets.beyond_face(g, axis, floor, 1.0)
    assert 0.0 <= held_against(least, beyond, g, 0.0, 0.0) + 1e-12 < 0.2
    angle = rng.uniform(0.1, 3.0)
    within = units[units @ axis >= math.cos(angle)]
    least = sets.in_cone(g, np.array([*axis, math.cos(angle), math.sin(angle)]), 3)
    assert held_against(least, within, g, 0.0, 0.0) < 0.2


@pytest.mark.parametrize('seed', range(40))
def test_the_least_over_the_orbitope(seed):
    rng = np.random.default_rng([11, seed])
    g = rng.normal(size=(3, 3))
    rotations = [exp(rng.normal(size=3) * 2.0) for _ in range(3000)]
    u, _, v = np.linalg.svd(-g)
    rotations.append(u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v)
    points = coordinates(np.array(rotations))
    least = sets.over_orbitope(g.T.ravel(), np.zeros((4, 4)))
    assert abs(held_against(least, points, g.T.ravel(), 0.0, 0.0)) < 1e-9
