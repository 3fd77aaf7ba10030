# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""No certificate proves anything false, whatever its multipliers, points and splits."""

import contextlib
import copy
import itertools
import json
import math
from dataclasses import replace
from fractions import Fraction
from functools import cache, reduce

import adversary
import numpy as np
import pytest
from problems import floor, seeds

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import coordinates, exp, lmi
from orbimpc_ros.mpc.model.dynamics import trajectory_of
from orbimpc_ros.mpc.model.translation import DISCRETISATIONS, step_of
from orbimpc_ros.mpc.plan import UNPROVED
from orbimpc_ros.mpc.problem import Ball, Problem, State, Weights
from orbimpc_ros.mpc.proof import document, sets
from orbimpc_ros.mpc.proof.arithmetic import as_fractions
from orbimpc_ros.mpc.proof.document import Refused, certificate_of, text_of, verified
from orbimpc_ros.mpc.proof.stated import ENDS, NO_LIMITS, STEP, Body, Cone, Statement
from orbimpc_ros.mpc.proof.tree import ARCS, CUT, EMPTY, LEAF, ROW, SPEED, one
from orbimpc_ros.mpc.proof.verify import Verifier


@cache
def certificates(seed, count):
    """Return ``count`` random certificates of bounds, each of another flight."""
    found = (adversary.judged(*each) for each in adversary.flights(seed, 10**6))
    bounds = (each for each in found if each and 'tree' in each.document)
    return list(itertools.islice(bounds, count))


@pytest.mark.parametrize('seed', seeds(*range(6)))
def test_no_part_proves_more_than_a_flight_in_it_costs(seed):
    for drawn, rng in adversary.flights(seed, 60):
        for _ in range(4):
            found = adversary.judged(drawn, rng)
            assert found is None or not found.is_false, f'{seed}: {found}'


def test_a_cone_and_a_wide_sector_prove_no_more_than_a_flight_in_both_costs():
    """Beyond a polygonal floor, where every direction in the cone is uphill."""
    rng = np.random.default_rng([752128, 54104])
    assert adversary.judged(adversary.flight(rng), rng).is_false is False


@pytest.mark.parametrize('seed', seeds(20))
def test_fractions_prove_what_floats_do(seed):
    proved = 0
    for each in certificates(seed, 40):
        problem, state, goals, limits, _ = each.posed
        floats = Verifier(problem).bound(state, goals, each.tree)
        exact = Verifier(problem, Fraction).bound(state, goals, each.tree, None, limits)
        assert max(floats, exact) <= each.cost * (1.0 + adversary.ROUNDING)
        proved += exact == floats or abs(exact - floats) < 1e-9 * (abs(exact) + 1.0)
        stated = Statement(problem).of(state, goals, limits)  # compiled code does not check it
        for part in (each for each in stated if isinstance(each, tuple)):
            arrays = [each for each in part if isinstance(each, np.ndarray)]
            assert all(each.flags.c_contiguous and each.dtype.kind in 'if' for each in arrays)
    assert proved > 30  # for the others, floats cannot establish convexity


def test_steps_in_fractions_leave_those_in_floats_alone():
    for model in itertools.chain(*(each.values() for each in DISCRETISATIONS.values())):
        exact, rounded = step_of(model, Fraction(7, 8), Fraction(1)), step_of(model, 0.875, 1.0)
        assert any(each.dtype == object for each in exact)
        assert all(each.dtype == float for each in rounded)


def test_fractions_trust_no_arc_tangent(monkeypatch):
    problem, start = Problem(floor=floor('circle'), max_rate=0.5), State.at(np.zeros(2), np.eye(2))
    of = math.atan2
    monkeypatch.setattr(math, 'atan2', lambda y, x: of(y, x) + 1e-9)
    with pytest.raises(BadInput):
        Statement(problem, Fraction).of(start, np.ones((problem.horizon, 2)), NO_LIMITS)


@pytest.mark.parametrize('seed', seeds(20))
def test_trees_of_wrong_shape_prove_nothing(seed):
    rng = np.random.default_rng(seed)
    for each in certificates(seed, 40):
        problem, *asked = each.posed[:3]
        verifier = Verifier(problem)
        for _ in range(40):
            bound = verifier.bound(*asked, _tampered(each.tree, rng))
            assert bound <= each.cost * (1.0 + adversary.ROUNDING)
        assert verifier.bound(*asked, each.tree) == Verifier(problem).bound(*asked, each.tree)


def _tampered(tree, rng):
    """Return a tree with one changed number, or with one array of another length."""
    name = str(rng.choice(['nodes', *tree._fields[:7]]))  # those in every tree
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


def forged(nodes, at, origin=0.0, late=None):
    """Return the bound that a tree of splits proves for headings above a round floor."""
    weights = Weights(position=0.0, input=0.0, length=1.0)
    problem = Problem(horizon=3, floor=floor('circle', 0.6), weights=weights)
    rng = np.random.default_rng(1)
    state, goals = State.at(np.zeros(2), np.eye(2)), rng.normal(size=(3, 2))
    tree, origins = one(rng.normal(size=(3, 2)), np.zeros(3)), np.full(3 * np.any(origin), origin)
    tree = tree._replace(nodes=np.array(nodes), at=np.array(at), origins=origins)
    return Verifier(problem).bound(state, goals, tree, late)


def test_a_split_covers_what_it_splits_and_each_node_has_one_parent():
    leaf = [LEAF, 0, 0, 0, 0]
    assert forged([[ARCS, 0, 1, 2, -1], leaf, leaf], [-99.0] * 3) > -math.inf
    assert forged([[ARCS, 0, 1, 2, -1], leaf, leaf], [101.0] * 3) == -math.inf  # turns are inexact
    assert forged([leaf], [0.0], origin=99.0) > forged([leaf], [0.0], origin=101.0) == -math.inf
    assert forged([leaf], [0.0], origin=[1.0, 1.0, 2.0]) == -math.inf
    for count in (0, -1, 1):
        assert forged([[ARCS, 0, 1, count, -1], leaf], [0.0] * 2) == -math.inf
    shared = [[ARCS, 0, 1, 2, -1], [CUT, 0, 3, 2, -1], [CUT, 0, 3, 2, -1], leaf, leaf]
    assert forged(shared, [0.0, 1.0, 4.0, 0.0, 0.0]) == -math.inf


def test_a_tree_deeper_than_most_is_verified_in_one_slice():
    nodes, leaf = [[ARCS, 0, 1, 2, -1]], [LEAF, 0, 0, 0, 0]
    for first in range(3, 83, 2):
        nodes += [leaf, [CUT, 0, first, 2, -1]]
    at = [2.0 * np.pi * (1.0 - 0.5 ** (1 + k // 2)) for k in range(len(nodes))]
    tree = [*nodes, leaf, leaf], [0.0, *at[1:], 0.0, 0.0]
    assert forged(*tree, late=lambda: True) == forged(*tree) > -math.inf


# --- documents


EXTREMES = [0, -0.0, 1e-320, 1e-300, 1e300, -1e300, float('inf'), float('nan'), 10**400, 'x', None,
            [], {}, [[[0.0]]], -1, 500]  # fmt: skip


def _places(known, way=()):
    """Yield the paths to all values in a document."""
    if isinstance(known, (dict, list)):
        for key, each in known.items() if isinstance(known, dict) else enumerate(known):
            yield (*way, key)
            yield from _places(each, (*way, key))


def test_whatever_a_document_holds_it_is_judged_or_refused():
    rng = np.random.default_rng(7)
    judged = filter(None, (adversary.judged(*each) for each in adversary.flights(7, 60)))
    for found in itertools.islice(judged, 6):
        ways = list(_places(found.document))
        for _ in range(30):
            made = copy.deepcopy(found.document)
            *way, last = ways[int(rng.integers(len(ways)))]
            inner = made
            for key in way:
                inner = inner[key]
            inner[last] = EXTREMES[int(rng.integers(len(EXTREMES)))]
            with contextlib.suppress(Refused):
                verified(made)


def document_of(horizon, shor=-1.0, leaves=1):
    """Return a certificate with a weak bound and identical leaves."""
    problem = Problem(horizon=horizon)
    leaf = one(np.full((horizon, 2), 0.1), np.full(horizon, shor))
    nodes = [[ARCS, 1, 1, leaves, -1], *[[LEAF, 0, 0, 0, 0]] * leaves][leaves == 1 :]
    tree = leaf._replace(nodes=np.array(nodes), at=np.zeros(len(nodes)))
    case = problem, State.at(np.zeros(2), np.eye(2)), np.ones((horizon, 2))
    return json.loads(text_of(certificate_of(*case, replace(UNPROVED, lower_bound=1.0, tree=tree))))


CONE = {'axis': [1.0, 0.0], 'angle': 1.0, 'least': 0.0, 'steps': []}
SPEEDS = {'entry': 0.1, 'change': 0.1}
BALL = {'centre': [1.0, 0.0], 'radius': 1.0, 'of': 'end'}


@pytest.mark.parametrize(
    ('path', 'value', 'word'),
    [
        (('format',), 'another', 'format'),
        (('format',), 'orbimpc certificate 1', 'allowed: orbimpc certificate 2'),
        (('goals',), ..., 'goals: missing'),
        *((('lower_bound',), each, 'a number') for each in (True, 10**400, '1')),
        (('more',), 1, "unknown certificate field 'more'"),
        (('goals', 0), [1.0], '2x2 finite'),
        (('problem', 'horizon'), 2.5, 'horizon'),
        (('problem', 'step'), 0.0, 'step'),
        (('problem', 'weights', 'position'), -1.0, 'position'),
        (('problem', 'floor', 'shape'), ['circle'], 'floor'),
        (('state', 'attitude'), None, 'attitude'),
        (('state', 'rotation'), [[1.0, 0.0], [0.0, -1.0]], 'allowed'),
        (('state', 'attitude'), [[1.0, 0.5], [0.5, 1.0]], 'allowed'),
        (('limits',), {'cones': [{**CONE, 'least': 2.0}]}, 'cone'),
        (('limits',), {'speeds': [0.1, 0.2]}, 'speeds'),
        (('limits',), {'speeds': {'entry': 0.1}}, 'change'),
        *((('limits',), {'speeds': SPEEDS | {k: -0.1}}, 'speeds') for k in [*SPEEDS, 'most']),
        (('limits',), {'bodies': [{**BALL, 'radius': 0.0}]}, 'radius'),
        (('limits',), {'bodies': [{**BALL, 'of': 'all'}]}, 'of'),
        (('limits',), {'bodies': [{**BALL, 'centre': [0.0] * 3}]}, 'dimension 2'),
        (('tree',), 7, 'tree'),
        (('tree', 'nodes'), [[0, 0, 0, 0]], 'nodes'),
        (('tree', 'point'), [[[0.1], [0.1, 0.2]]], 'lists of the same length'),
        (('tree', 'points'), [], "unknown tree field 'points'"),
        (('goals',), reduce(lambda x, _: [x], range(40), 1.0), '2x2 finite'),
        (('goals',), reduce(lambda x, _: [x], range(5000), 1.0), 'recursion'),
    ],
)
def test_states_and_limits_that_are_none_are_refused(path, value, word):
    known = document_of(2)
    inner = known
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    if value is ...:
        del inner[path[-1]]
    with pytest.raises(Refused, match=word) as caught:
        verified(known)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(
    'text', [b'', b'{', b'{"a":NaN}', b'{"a":-Infinity}', b'{"a":1,"a":1}', b'\xff', b'[' * 10**5]
)
def test_what_is_no_json_is_refused(text):
    with pytest.raises(Refused):
        document.parsed(text)


# --- support functions, by brute force


def held_against(least, points, g):
    """Assert that ``least`` is a lower bound over points; return its slack."""
    found = (points @ g).min()
    assert least <= found + 1e-12
    return found - least


@pytest.mark.parametrize('seed', range(15))
def test_the_least_beyond_a_face_and_within_a_cone(seed):
    rng = np.random.default_rng([10, seed])
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    g, floor = rng.normal(size=3), rng.uniform(0.1, 0.9)
    units = rng.normal(size=(20000, 3))
    units /= np.linalg.norm(units, axis=1, keepdims=True)
    points = np.concatenate([units * rng.uniform(size=(20000, 1)) ** 0.2, units])
    beyond = points[points @ axis >= floor]
    along = sets.in_cone(g, axis, floor, math.sqrt(1.0 - floor * floor), 3)
    least = sets.over_face(g, along, axis, floor, (floor, 1.0), 0.0, 0.0)
    assert 0.0 <= held_against(least, beyond, g) + 1e-12 < 0.2
    angle = rng.uniform(0.1, 3.0)
    within = units[units @ axis >= math.cos(angle)]
    least = sets.in_cone(g, axis, math.cos(angle), math.sin(angle), 3)
    assert held_against(least, within, g) < 0.2


@pytest.mark.parametrize('seed', range(15))
def test_the_least_over_the_orbitope(seed):
    rng = np.random.default_rng([11, seed])
    g = rng.normal(size=(3, 3))
    rotations = [exp(rng.normal(size=3) * 2.0) for _ in range(3000)]
    u, _, v = np.linalg.svd(-g)
    rotations.append(u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v)
    points = coordinates(np.array(rotations))
    least = sets.over_orbitope(g.T.ravel(), np.zeros((4, 4)))
    assert abs(held_against(least, points, g.T.ravel())) < 1e-9


def test_what_is_tiny_is_rounded_in_proportion_to_its_size():
    rng = np.random.default_rng(12)
    for g in rng.normal(size=(20, 9)):
        least = np.linalg.eigvalsh(lmi(g) - np.eye(4))[0]
        for size in (1.0, 1e-30, 1e-80):
            found = sets.over_orbitope(as_fractions(size * g), as_fractions(np.zeros((4, 4))))
            assert found / Fraction(size) == pytest.approx(least, rel=1e-12)
    costly = Problem(horizon=1, weights=Weights(0.0, 0.0, 1e48, 0.0))  # only |R_0 e1| costs
    start = State.at(np.zeros(2), 1e-60 * np.eye(2), attitude=np.eye(2))
    asked = start, np.zeros((1, 2)), one(np.zeros((1, 2)), np.zeros(1))
    assert Verifier(costly, Fraction).bound(*asked) == pytest.approx(1e-12)


def test_the_speed_of_a_given_rotation_is_not_its_factor():
    known = document_of(3)
    known['problem']['rotation_order'] = 2
    known['state']['rotation'] = [[0.3, 0.0], [0.0, 0.3]]
    known['limits'] = {'speeds': {'entry': 0.3, 'change': 0.1}}
    nodes = [[SPEED, 4, 1, 2, -1], *[[EMPTY, 0, 0, 0, -1]] * 2]
    known['tree'] |= {'nodes': nodes, 'at': [0.3, 0.0, 0.0]}
    assert not verified(known).holds


def test_what_takes_more_work_than_its_length_may_is_refused():
    assert verified(document_of(200)).leaves == 1
    with pytest.raises(Refused, match='work'):
        verified(document_of(200, shor=1.0))
    assert verified(document_of(50, leaves=40)).leaves == 40
    with pytest.raises(Refused, match='work'):  # a leaf counts once for every node that shares it
        verified(document_of(50, leaves=4000))
    cones = {'cones': [{**CONE, 'steps': [1] * 1000}]}
    with pytest.raises(Refused, match='work'):  # and a cone for every leaf
        verified({**document_of(50, leaves=40), 'limits': cones})
    with pytest.raises(Refused, match='work'):  # of which every step has places
        verified({**document_of(50), 'limits': {'bodies': [BALL] * 1000}})


def test_a_cost_is_convex_whatever_was_verified_before():
    asked = State.at([0.0, 0.0], np.eye(2)), np.ones((2, 2))
    verifier = Verifier(Problem(horizon=2, weights=Weights(input=0.0)))  # the last heading is free
    trees = (one(np.zeros((2, 2)), np.array(shor)) for shor in ([0.0, 0.0], [1.0, -1.0]) * 2)
    first, _, again, _ = (verifier.bound(*asked, each) for each in trees)
    assert first == again > -np.inf


def test_a_problem_in_the_plane_may_state_the_same_cone_twice():
    cone, verifier = Cone([0.0, 1.0], 0.3, 0.01, [5]), Verifier(Problem())
    asked = State.at([0.0, 0.0], np.eye(2)), np.ones((5, 2)), one(np.zeros((5, 2)), np.zeros(5))
    limits = (NO_LIMITS._replace(cones=times * (cone,)) for times in (1, 2))
    once, twice = (verifier.bound(*asked, limits=each) for each in limits)
    assert once == twice > -np.inf


@pytest.mark.parametrize('least', [0.0, 0.5])
def test_cones_side_by_side_have_no_heading_but_rest(least):
    cones = tuple(Cone(axis, 0.2, least, [1]) for axis in ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    asked = State.at(np.zeros(3), np.eye(3)), np.ones((1, 3)), one(np.zeros((1, 9)), np.zeros(1))
    found = Verifier(Problem(3, horizon=1)).bound(*asked, limits=NO_LIMITS._replace(cones=cones))
    assert (found == np.inf) == (least > 0.0)


@pytest.mark.parametrize('discretisation', ['euler', 'exact'])
def test_the_end_of_a_step_proves_the_same_with_its_start_or_all_of_it(discretisation):
    problem, ball = Problem(horizon=3, discretisation=discretisation), Ball([1.0, 0.2], 0.5)
    nodes, shifts = np.zeros((5, 5), np.int64), np.outer(np.arange(4.0), [-3.0, 0.0])
    nodes[0], nodes[1:, ROW] = (ARCS, 7, 1, 4, -1), np.arange(4)  # the second step's side
    shapes = {'point': np.zeros((4, 3, 2)), 'shor': np.zeros((4, 3)), 'press': np.ones(4)}
    start, goals, bounds = State.at(np.zeros(2), np.eye(2)), np.full((3, 2), [2.0, 0.0]), []
    for of, row in ((ENDS, 1), (STEP, problem.translation.degree)):
        rows = {'press_end': np.arange(1, 5), 'press_row': np.full(4, 4 + row), 'at': np.zeros(5)}
        tree = one(np.zeros((3, 2)), np.zeros(3))._replace(nodes=nodes, **rows, **shapes)
        limits = NO_LIMITS._replace(bodies=(Body(ball, of, shifts, np.zeros(3)),))
        bounds.append(Verifier(problem).bound(start, goals, tree, limits=limits))
    assert bounds[0] == bounds[1] > -np.inf


def test_a_cone_bounds_the_headings_of_its_own_steps_alone():
    weights = Weights(position=0.0, input=1.0, terminal=0.0, attitude=1.0)
    problem = Problem(horizon=2, weights=weights)
    start, goals = State.at(np.zeros(2), np.eye(2), wanted=-np.eye(2)), np.zeros((2, 2))
    turned = np.array([[1.0, 0.0], [-1.0, 0.0]]) / 3.0  # ahead, and then back
    leaf = one(np.array([[0.5, 0.0], [0.0, 0.0]]), np.zeros(2))  # the best that ends ahead
    limits = (NO_LIMITS._replace(cones=(Cone([1.0, 0.0], 0.3, 0.0, [k]),)) for k in (1, 2))
    first, last = (Verifier(problem).bound(start, goals, leaf, limits=each) for each in limits)
    assert first < trajectory_of(problem, start, goals, turned).objective < 2.7 < last < 3.0
