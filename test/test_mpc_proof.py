# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Certificates of every kind of problem: what is published holds in exact arithmetic."""

import json
from dataclasses import replace
from functools import cache

import certified
import numpy as np
import pytest
from toy_floor import Eastward

from orbimpc_ros.mpc.problem import Ball, Box, Floor, Problem, State
from orbimpc_ros.mpc.problem.floor import SHAPES
from orbimpc_ros.mpc.proof.document import verified
from orbimpc_ros.mpc.proof.prove import Unproved, certificate_of
from orbimpc_ros.mpc.proof.reading import Refused, parsed
from orbimpc_ros.mpc.solve.solver import Solver

SEEDS = (0, 1)
KINDS = [
    *((kind, seed) for kind in certified.KINDS for seed in SEEDS),
    *((kind, 1) for kind in certified.LIMITED),
    *((kind, 0) for kind in certified.TIED),
]


def certificate(kind, seed):
    case = certified.case(kind, np.random.default_rng([seed, *kind.encode()]))
    coasting = case.state.coasted is not None
    plan = Solver(case.problem, coasting=coasting, patient=True).solve(case.state, case.goals)
    return plan, certificate_of(*case, plan.proof)


@pytest.mark.parametrize(('kind', 'seed'), KINDS)
def test_what_is_published_holds(kind, seed):
    plan, made = certificate(kind, seed)
    verdict = verified(parsed(made.text().encode()))
    assert verdict.holds
    assert verdict.claimed == max(0.0, plan.lower_bound)
    # What is proved is no more than what was found, but for what plans may miss constraints by.
    assert verdict.proved <= plan.objective * (1.0 + 1e-7)


def judged(text):
    try:
        return 'holds' if verified(parsed(text.encode())).holds else 'does not hold'
    except Refused as error:
        return str(error)


@cache
def in_the_way(body):
    """Return a certificate that takes all sides of a body, which the straight way goes through."""
    problem = Problem(horizon=4, obstacles=(body,))
    case = problem, State.at(np.zeros(2), np.eye(2)), np.tile([3.5, 0.0], (4, 1))
    plan = Solver(problem).solve(*case[1:])
    return plan, certificate_of(*case, plan.proof)


BOX, DISC = Box(np.array([1.2, -0.3]), np.array([2.4, 0.4])), Ball(np.array([1.6, 0.1]), 0.5)


@pytest.mark.parametrize('body', [BOX, DISC], ids=['box', 'disc'])
def test_a_proof_beside_a_body_takes_the_body(body):
    plan, made = in_the_way(body)
    free = Solver(replace(made.problem, obstacles=())).solve(made.state, made.goals)
    assert plan.lower_bound > 1.001 * free.objective
    known = made.document()
    for body in known['limits']['bodies']:
        body.update({'radius': 0.1} if 'radius' in body else {'max': [1.3, -0.2]})
    assert judged(json.dumps(known)) == 'does not hold'
    known['limits']['bodies'] = []
    assert judged(json.dumps(known)) != 'holds'


def test_a_bound_that_is_too_high_has_no_certificate():
    case = certified.case('hull', np.random.default_rng(3))
    plan = Solver(case.problem).solve(case.state, case.goals)
    made = certificate_of(*case, replace(plan.proof, lower_bound=1.00001 * plan.objective))
    assert not verified(made.document()).holds


def test_floors_that_the_format_cannot_state_have_no_certificates(monkeypatch):
    monkeypatch.setitem(SHAPES, 'eastward', Eastward())
    problem, state = Problem(floor=Floor('eastward')), State.at(np.zeros(2), np.eye(2))
    plan = Solver(problem).solve(state, np.ones((5, 2)))
    with pytest.raises(Unproved, match='no proof'):
        certificate_of(problem, state, np.ones((5, 2)), plan.proof)


def test_numbers_are_written_as_they_are():
    _, made = certificate('circle', 1)
    known = json.loads(made.text())
    assert np.array_equal(known['goals'], made.goals)
    assert np.array_equal(known['tree']['point'], made.tree.point)
    assert known['lower_bound'] == made.lower_bound
