# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Certificates of searches that split speeds, and of ways round to a cone of approach."""

import copy
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import certified
import numpy as np
import pytest
from counting import a_change, an_approach

from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Approach, Floor, Problem, State
from orbimpc_ros.mpc.proof.kept import kept
from orbimpc_ros.mpc.proof.prove import Unproved, certificate_of, certificates_for
from orbimpc_ros.mpc.proof.verifier import Refused, verified
from orbimpc_ros.mpc.solve.solver import Solver

pytestmark = pytest.mark.skipif(not COMPILED, reason='the search that is told of needs numba')

# Some split directions, some speeds, some both; 144 has no turn limit.
CHANGES = 11, 49, 54, 60, 97, 114, 121, 144
# Of a round floor those that are even, of a polygon the others; 12 knows speeds, too.
APPROACHES = 0, 1, 2, 4, 6, 12, 14, 22, 23


@cache
def plan_of(draw, seed):
    case = draw(seed)
    return case, Solver(case.problem).solve(case.state, case.goals)


def left(draw, seed):
    """Return a case, its plan, and the certificate that the method left."""
    case, plan = plan_of(draw, seed)
    assert plan.proof.checked
    return case, plan, kept(*case, plan.proof)


def judged(document):
    """Return what a document comes to, -inf where it is refused."""
    try:
        return verified(document).proved
    except Refused:
        return -np.inf


def splits(node: dict) -> Iterator[dict]:
    """Yield the splits of a tree."""
    for part in node.get('parts', ()):
        yield from splits(part)
    if 'parts' in node:
        yield node


@pytest.mark.parametrize('seed', CHANGES)
def test_what_a_search_with_limited_changes_of_speed_left_is_a_certificate(seed):
    case, plan, made = left(a_change, seed)
    verdict = verified(made.document())
    assert verdict.holds
    assert verdict.proved <= plan.objective * (1.0 + 1e-7)
    count = case.problem.horizon
    by_speed = [each for each in splits(made.document()['tree']) if 'speed' in each]
    assert len(by_speed) == (plan.proof.grounds.splits >= count).sum()


@pytest.mark.parametrize('seed', APPROACHES)
def test_what_a_search_within_a_cone_left_is_a_certificate(seed):
    _, plan, made = left(an_approach, seed)
    verdict = verified(made.document())
    assert verdict.holds
    assert verdict.proved <= plan.objective * (1.0 + 1e-7)


@pytest.mark.parametrize(
    'asked', [(a_change, 54), (a_change, 60), (a_change, 121), (an_approach, 12)]
)
def test_mutants_of_splits_are_refused_or_prove_less(asked):
    """A split that is gone, or is elsewhere, and speeds that change more, or begin elsewhere."""
    _, plan, made = left(*asked)
    rng, document, refused = np.random.default_rng(6), made.document(), 0
    for _ in range(25):
        known = copy.deepcopy(document)
        every = [each for each in splits(known['tree']) if 'speed' in each]
        one = every[rng.integers(len(every))]
        kind = rng.integers(4)
        if kind == 0:
            one['parts'].pop(rng.integers(2))
        elif kind == 1:
            one['speed'] += rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-3.0, 0.0)
        elif kind == 2:
            one['split'] = int(rng.integers(1, len(known['goals']) + 1))
        else:
            part = one['parts'][rng.integers(2)]
            one.clear()
            one.update(part)
        proved = judged(known)
        assert proved <= plan.objective * (1.0 + 1e-7)
        refused += proved == -np.inf
    assert 0 < refused < 25


@pytest.mark.parametrize('asked', [(a_change, 54), (an_approach, 12)])
def test_certificates_take_the_limit_of_changes_of_speed(asked):
    _, _, made = left(*asked)
    known = made.document()
    whole = verified(known).proved
    wider = copy.deepcopy(known)
    wider['limits']['speeds']['change'] *= 1.5
    assert judged(wider) < whole * (1.0 - 1e-6)
    del known['limits']['speeds']
    assert judged(known) < whole * (1.0 - 1e-6)


def test_certificates_take_the_speed_that_changes_begin_at():
    """From elsewhere, splits are not within what is reached, or more is."""
    case, _, made = left(a_change, 54)
    known = made.document()
    entry = known['limits']['speeds']['entry']
    assert entry == pytest.approx(np.linalg.norm(case.state.rotation[:, 0]))
    other = Solver(case.problem)
    for moved in (-0.2, -0.1, 0.1):
        known['limits']['speeds']['entry'] = entry + moved
        rotation = (entry + moved) / entry * case.state.rotation
        start = replace(case.state, rotation=rotation, attitude=case.state.attitude)
        elsewhere = other.solve(start, case.goals)
        proved = judged({**known, 'state': {**known['state'], 'rotation': rotation.tolist()}})
        assert proved <= elsewhere.objective * (1.0 + 1e-7)


@pytest.mark.parametrize('seed', [0, 14, 23])
def test_what_is_outside_of_the_cone_takes_a_proof(seed):
    _, _, made = left(an_approach, seed)
    known = made.document()
    outside = [leaf for leaf in certified.leaves(known['tree']) if 'point' not in leaf]
    assert len(outside) >= 2
    for each in outside:
        shares = each.pop('shares')
        assert not verified(known).holds
        each['shares'] = (-np.array(shares)).tolist()
        assert not verified(known).holds
        each['shares'] = shares
    assert verified(known).holds


def test_a_wider_cone_takes_another_proof():
    _, _, made = left(an_approach, 0)
    known = made.document()
    known['limits']['cones'][0]['angle'] += 1e-3
    assert not verified(known).holds


def test_without_one_of_the_ways_round_there_is_no_certificate():
    case, plan = plan_of(an_approach, 2)
    grounds = plan.proof.grounds
    parts = grounds.parts[grounds.splits >= 0]
    assert len(grounds.splits) == 2 + 2 * len(parts)  # two roots
    names = 'splits', 'parts', 'angles', 'points', 'bends'
    fewer = grounds._replace(**{name: getattr(grounds, name)[1:] for name in names})
    fewer = fewer._replace(parts=fewer.parts - 1)
    assert kept(*case, plan.proof) is not None
    assert kept(*case, replace(plan.proof, grounds=fewer)) is None


@pytest.mark.parametrize('kind', certified.PACED)
@pytest.mark.parametrize('seed', [1, 2])
def test_a_bound_is_proved_again_by_the_search_that_found_it(kind, seed):
    case = certified.case(kind, np.random.default_rng(seed))
    plan = Solver(case.problem).solve(case.state, case.goals)
    made = certificate_of(*case, plan.rotations[1:], plan.lower_bound)
    verdict = verified(made.document())
    assert verdict.holds
    assert verdict.proved <= plan.objective * (1.0 + 1e-7)
    with pytest.raises(Unproved, match='sectors prove'):
        certificate_of(*case, plan.rotations[1:], 1.001 * plan.objective)


def test_a_low_bound_takes_no_more_than_a_little_of_the_search():
    case, plan = plan_of(an_approach, 10)
    assert len(plan.proof.grounds.splits) > 1000
    made = certificate_of(*case, plan.rotations[1:], 0.9 * plan.lower_bound)
    verdict = verified(made.document())
    assert verdict.holds
    assert verdict.leaves < 100


def test_a_search_that_there_is_no_time_to_tell_of_has_no_certificate(monkeypatch):
    case, plan = plan_of(a_change, 34)
    asked = *case, plan.rotations[1:], plan.lower_bound
    assert verified(certificate_of(*asked, lambda: True).document()).holds
    monkeypatch.setattr('orbimpc_ros.mpc.solve.request.AFTERWARDS', 0)
    with pytest.raises(Unproved, match='no words'):
        certificate_of(*asked, lambda: True)


def test_what_a_search_left_comes_first_however_large_it_is():
    case, plan = plan_of(a_change, 97)
    assert len(plan.proof.grounds.splits) > 500
    first = next(certificates_for(*case, plan, plan.lower_bound))
    assert first.document() == kept(*case, plan.proof).document()


def test_polygons_within_ranges_of_speeds_have_no_words():
    case, plan = plan_of(a_change, 24)
    assert plan.proof.checked
    assert kept(*case, plan.proof) is None


def test_a_cone_that_all_turns_stay_within_needs_no_split():
    problem = Problem(horizon=3, floor=Floor('circle', fraction=0.6), max_rate=0.1,
                      approach=Approach(0.5, (1.0, 0.0)))  # fmt: skip
    case = problem, State.at(np.zeros(2), np.eye(2)), np.tile([1.0, 0.3], (3, 1))
    made = kept(*case, Solver(problem).solve(*case[1:]).proof)
    assert 'split' not in made.document()['tree']
    assert verified(made.document()).holds
