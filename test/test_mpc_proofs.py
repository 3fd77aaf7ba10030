# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Random problems of every route, judged by an evaluation and a solver that share no code."""

from dataclasses import replace

import numpy as np
import pytest
from problems import ANSWERS, CASES

SEED = 3
QUICK = 12  # steps; longer horizons are for the long form


@pytest.fixture(scope='module')
def proofs():
    """The judge, where IPOPT is installed (extra ``study``)."""
    pytest.importorskip('casadi', reason='needs casadi: pip install orbimpc_ros[study]')
    import proofs

    return proofs


@pytest.fixture(scope='module')
def solved(proofs):
    """A case with its good answer and a legal trajectory that costs as much."""
    case = proofs.judge.case_of(CASES['uav_circle_0'])
    answer = proofs.by_api(case.mapping, 10.0)
    return case, answer, proofs.beater.Rival(answer.objective, answer.rotations, 'itself')


def quick_indices(instances, route):
    """The first two problems of a route with a short horizon."""
    every = range(route, 100_000, len(instances.ROUTES))
    short = (i for i in every if instances.draw(SEED, i)['horizon'] <= QUICK)
    return [next(short), next(short)]


@pytest.mark.parametrize('route', range(24))
def test_plans_are_legal_and_proofs_are_true(proofs, route):
    for index in quick_indices(proofs.instances, route):
        found = proofs.task(SEED, index, 'api', patience=1.0)
        assert not found['findings'], proofs.shown(found)


@pytest.mark.parametrize('name', CASES)
def test_the_judge_knows_the_reference_optima(proofs, name):
    case, expected = proofs.judge.case_of(CASES[name]), ANSWERS[name]['objective']
    plan = proofs.by_api(case.mapping, 10.0).rotations
    rng = np.random.default_rng(SEED)
    costs = [legal.cost for legal in proofs.beater.trajectories(case, plan, rng, 1.0)]
    assert proofs.judge.worst(case, plan) < proofs.EXACT
    costs.append(proofs.judge.cost(case, plan))
    assert min(costs) > expected - 1e-4 * abs(expected)
    assert min(costs) < expected + 1e-3 * abs(expected)


def kinds(proofs, solved, **changes):
    case, answer, other = solved
    return [proofs.kind(text) for text in proofs.verdict(case, replace(answer, **changes), [other])]


def test_a_good_answer_has_no_findings(proofs, solved):
    assert kinds(proofs, solved) == []


def test_each_false_claim_is_found(proofs, solved):
    case, answer, other = solved
    less = replace(other, cost=(1.0 - 1.1e-4) * other.cost)
    assert 'beaten' in [proofs.kind(text) for text in proofs.verdict(case, answer, [less])]
    above = answer.objective * (1.0 + 1.1e-6)
    assert kinds(proofs, solved, bound=above) == ['bound']
    assert kinds(proofs, solved, bound=np.inf) == ['bound']
    assert kinds(proofs, solved, objective=above) == ['objective']
    assert kinds(proofs, solved, positions=answer.positions + 1.1e-6 * case.unit) == ['illegal']
    assert kinds(proofs, solved, positions=np.nan * answer.positions) == ['illegal']
    for status in ('infeasible', 'failed', 'raised', 'refused', 'endless'):
        assert kinds(proofs, solved, status=status, rotations=None) == [status]


def test_no_plan_is_no_finding_where_nothing_legal_is_known(proofs, solved):
    case, answer, _ = solved
    none = replace(answer, status='infeasible', rotations=None)
    assert proofs.verdict(case, none, []) == []
