# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Certificates of searches over choices: what is published of them holds in exact arithmetic."""

import itertools
import json

import certified
import numpy as np
import pytest
from counting import between_walls, solved

from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.plan import Proof
from orbimpc_ros.mpc.problem import Approach, Ball, Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.proof.grounds import LEAF, ChoiceGrounds
from orbimpc_ros.mpc.proof.kept import kept
from orbimpc_ros.mpc.proof.recount import Recount
from orbimpc_ros.mpc.proof.verifier import Refused, parsed, verified

pytestmark = pytest.mark.skipif(not COMPILED, reason='the search that leaves trees needs numba')
KINDS = (
    *('boxes', 'boxes, shared faces', 'boxes, inertia', 'boxes that move', 'discs'),
    *('turn rate', 'turn rate, exact', 'turn rate, inertia', 'turn rate, boxes'),
    *('axes, boxes', 'space, boxes'),
)
CURVED = (
    {'discretisation': 'exact'},
    {'discretisation': 'exact', 'translation_order': 2},
    {'discretisation': 'held', 'translation_order': 2},
)
SQUARE, ROUND = Floor('polygon', faces=5, fraction=0.6), Floor('circle', fraction=0.6)


def judged(document):
    try:
        return verified(parsed(json.dumps(document).encode()))
    except Refused as error:
        return str(error)


def held(case, plan):
    """Return the certificate of a plan's bound, once it holds."""
    assert plan.proof.checked
    made = kept(*case, plan.proof)
    verdict = verified(parsed(made.text().encode()))
    assert verdict.holds
    assert verdict.claimed == plan.lower_bound
    # It knows what headings hold more closely than what is counted at a tick.
    counted = Recount(case.problem).bound(*case[1:], plan.proof.grounds, plan.proof.cost_unit)
    assert counted * (1.0 - 1e-9) <= verdict.proved <= plan.objective * (1.0 + 1e-7)
    return made.document()


@pytest.mark.parametrize(('kind', 'seed'), [*itertools.product(KINDS, (0, 3))])
def test_what_a_search_over_choices_publishes_holds(kind, seed):
    held(*solved(kind, seed))


@pytest.mark.parametrize(
    ('kind', 'changes'), [*itertools.product(('boxes that move', 'discs'), CURVED)]
)
def test_what_moves_within_steps_is_held_by_their_control_points(kind, changes):
    known = held(*solved(kind, 1, **changes))
    assert {'step'} <= {wall['of'] for wall in known['limits']['walls']}


@pytest.mark.parametrize(
    'kind', ['boxes', 'boxes, inertia', 'discs', 'boxes that move', 'space, boxes', 'polygon']
)
def test_arrivals_have_words(kind):
    known = held(*solved(kind, 2, terminal='constraint'))
    assert '"pull"' in json.dumps(known['tree'])


def test_of_cones_nothing_is_published_beside_boxes():
    case, plan = solved('boxes, shared faces', 2, approach=Approach(0.3, (1.0, 0.5)))
    assert isinstance(plan.proof.grounds, ChoiceGrounds)
    assert plan.proof.checked
    assert kept(*case, plan.proof) is None


LONG = {'weights': Weights(1.0, 0.05, 0.3, 10.0)}


@pytest.mark.parametrize(
    ('kind', 'seed', 'changes'),
    [
        ('boxes', 2, {}),
        ('boxes, shared faces', 3, {'floor': SQUARE}),
        ('boxes', 3, {'floor': ROUND}),
        ('discs', 1, {'floor': SQUARE}),
        ('polygon', 3, {}),
        ('polygon', 3, {'terminal': 'constraint'}),
    ],
)
def test_lengths_have_words_in_the_plane(kind, seed, changes):
    case, plan = solved(kind, seed, **LONG, **changes)
    assert isinstance(plan.proof.grounds, ChoiceGrounds)
    known = held(case, plan)
    told = [any(map(any, leaf.get('shares', ()))) for leaf in certified.leaves(known['tree'])]
    assert any(told) == (case.problem.floor.shape == 'polygon')


def test_beyond_a_face_a_length_takes_its_share():
    known = held(*solved('polygon', 3, **LONG))
    for leaf in certified.leaves(known['tree']):
        leaf.pop('shares', None)
    assert not judged(known).holds


@pytest.mark.parametrize(
    ('kind', 'floor'), [*itertools.product(('boxes', 'discs'), (SQUARE, ROUND))]
)
def test_floors_beside_bodies_have_words(kind, floor):
    known = held(*solved(kind, 1, floor=floor))
    headings = [each for each in splits(known['tree']) if 'wall' not in each]
    assert headings
    assert ('origins' in known) == ('at' in headings[0]) == (floor is ROUND)


def splits(node):
    """Yield the splits of a tree."""
    if 'parts' in node:
        yield node
        for part in node['parts']:
            yield from splits(part)


@pytest.fixture(scope='module')
def branched():
    """Return a problem in space whose tree has parts that are empty, and sides left out."""
    case, plan = between_walls()
    grounds = plan.proof.grounds
    assert grounds.empty.sum() > 5
    assert (grounds.counts[grounds.splits != LEAF] < 6).any()
    return case, plan, held(case, plan)


def test_parts_that_are_empty_and_sides_that_nothing_reaches_have_leaves(branched):
    _, plan, known = branched
    grounds = plan.proof.grounds
    left_out = (6 - grounds.counts[grounds.splits != LEAF]).sum()
    assert len(list(certified.leaves(known['tree']))) == len(grounds.points) + left_out


def test_without_their_multipliers_empty_parts_prove_nothing(branched):
    known = json.loads(json.dumps(branched[2]))
    empty = [leaf for leaf in certified.leaves(known['tree']) if 'point' not in leaf]
    assert len(empty) > 5
    for factor, holds in ((0.6, True), (0.4, False)):  # twice as large as would do
        made = json.loads(json.dumps(known))
        for leaf in certified.leaves(made['tree']):
            if 'point' not in leaf:
                leaf['presses'] = [factor * y for y in leaf['presses']]
        assert judged(made).holds == holds


@pytest.mark.parametrize('kind', ['boxes, shared faces', 'discs', 'turn rate', 'space, boxes'])
def test_mutants_are_refused_or_do_not_hold(kind):
    rng, known = np.random.default_rng(5), held(*solved(kind, 3))
    for _ in range(12):
        name, text = certified.mutant(known, rng)
        try:
            assert not verified(parsed(text.encode())).holds, name
        except Refused:
            continue


NO_WORDS = (
    ('boxes', ROUND, 1.0),
    ('space, boxes', Floor('polygon', faces=6, fraction=0.4), 0.0),
)


@pytest.mark.parametrize(('kind', 'floor', 'turn'), NO_WORDS)
def test_what_there_are_no_words_for_has_no_certificate(kind, floor, turn):
    step = solved(kind, 1)[0].problem.step
    case, plan = solved(kind, 1, floor=floor, max_rate=turn / step)
    assert plan.proof.checked
    assert kept(*case, plan.proof) is None


def test_a_disc_that_has_shrunk_to_nothing_asks_for_nothing():
    """From its middle, where the state decides that the first step ends as well."""
    problem = Problem(horizon=3, translation_order=2, obstacles=(Ball((0.0, 0.0), 0.5),))
    case = Case(problem, State.at(np.zeros(2), np.eye(2)), np.ones((3, 2)))
    none, leaves = np.zeros(0, np.int64), np.zeros(4, np.int64)
    by_end_of_first_step = np.array([1, LEAF, LEAF, LEAF, LEAF])
    nodes = np.array([1, 0, 0, 0, 0]), np.array([4, 0, 0, 0, 0]), np.zeros(5, np.int64)
    grounds = ChoiceGrounds(
        by_end_of_first_step, *nodes, np.array([0, 0, 1, 2, 3]), np.zeros((4, 3, 2)),
        leaves > 0, leaves, none, none, np.zeros(0), np.zeros((4, 0, 2)),
    )  # fmt: skip
    proof = Proof(0.0, 1, 1e-4, 1.0, '', checked=True, grounds=grounds)
    known = kept(*case, proof).document()
    wall = known['limits']['walls'][0]
    assert wall['radius'] + wall['grown'][0] < 0.0
    assert known['tree']['parts'][0]['wall'] == 0
    assert judged(known).leaves == 4
