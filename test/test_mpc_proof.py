# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Certificates of every kind of problem: what is published holds in exact arithmetic."""

import json
from dataclasses import replace
from functools import cache

import certified
import numpy as np
import pytest
from toy_floor import Eastward

from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Approach, Ball, Box, Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.floor import SHAPES
from orbimpc_ros.mpc.proof.certificate import statement
from orbimpc_ros.mpc.proof.prove import Unproved, certificate_of, patient
from orbimpc_ros.mpc.proof.sectors import SectorProof
from orbimpc_ros.mpc.proof.spatial import touching_freely
from orbimpc_ros.mpc.proof.verifier import Refused, parsed, verified
from orbimpc_ros.mpc.solve.solver import Solver

SEEDS = (0, 1)


def certificate(kind, seed):
    case = certified.case(kind, np.random.default_rng([seed, *kind.encode()]))
    coasting = case.state.coasted is not None
    plan = Solver(case.problem, coasting=coasting, patient=True).solve(case.state, case.goals)
    return plan, certificate_of(*case, plan.rotations[1:], plan.lower_bound)


@pytest.mark.parametrize('seed', SEEDS)
@pytest.mark.parametrize('kind', certified.KINDS)
def test_what_is_published_holds(kind, seed):
    plan, made = certificate(kind, seed)
    verdict = verified(parsed(made.text().encode()))
    assert verdict.holds
    assert verdict.claimed == max(0.0, plan.lower_bound)
    # What is proved is no more than what was found, but for what plans may miss constraints by.
    assert verdict.proved <= plan.objective * (1.0 + 1e-7)


def test_a_plan_that_is_a_little_off_is_as_good_to_prove_a_bound_from():
    """Over SO(3) a plan's own tangents lack the square of what it is off by."""
    kind, rng = 'space, arrival', np.random.default_rng(5)
    case = certified.case(kind, np.random.default_rng([1, *kind.encode()]))
    plan = Solver(case.problem, patient=True).solve(case.state, case.goals)
    turned = [r @ exp(1e-3 * rng.normal(size=3)) for r in plan.rotations[1:]]
    made = certificate_of(*case, np.array(turned), plan.lower_bound)
    assert verified(parsed(made.text().encode())).holds


@pytest.mark.parametrize(
    ('kind', 'seed'),
    [*((kind, 1) for kind in certified.LIMITED), *((kind, 0) for kind in certified.TIED)],
)
def test_what_is_published_beside_walls_within_cones_and_under_turn_limits_holds(kind, seed):
    plan, made = certificate(kind, seed)
    verdict = verified(parsed(made.text().encode()))
    assert verdict.holds
    assert verdict.proved <= plan.objective * (1.0 + 1e-7)


@pytest.mark.parametrize('kind', ['turn rate', 'space, turn rate, inertia'])
def test_a_proof_with_a_turn_limit_takes_the_limit(kind):
    case = certified.case(kind, np.random.default_rng([1, *kind.encode()]))
    aside = case.state.position - 0.5 * (case.goals[0] - case.state.position)
    goals = np.tile(aside + case.problem.length_unit, (case.problem.horizon, 1))
    plan = Solver(case.problem).solve(case.state, goals)
    made = certificate_of(case.problem, case.state, goals, plan.rotations[1:], plan.lower_bound)
    free = Solver(replace(case.problem, max_rate=0.0)).solve(case.state, goals)
    assert verified(made.document()).proved > 1.001 * free.objective
    for factor, outcome in ((1.1, 'does not hold'), (0.0, 'no turns are limited')):
        known = made.document()
        known['problem']['max_rate'] *= factor
        assert outcome in judged(json.dumps(known))


def judged(text):
    try:
        return 'holds' if verified(parsed(text.encode())).holds else 'does not hold'
    except Refused as error:
        return str(error)


@pytest.mark.parametrize('kind', ['hull', 'polygon', 'circle, turn rate', 'space', 'hull, arrival'])
def test_mutants_are_refused_or_do_not_hold(kind):
    rng, known = np.random.default_rng(7), certificate(kind, 0)[1].document()
    for _ in range(15):
        name, text = certified.mutant(known, rng)
        assert judged(text) != 'holds', name


@pytest.mark.parametrize('kind', ['boxes', 'axes, boxes'])
def test_mutants_with_walls_are_refused_or_do_not_hold(kind):
    rng, known = np.random.default_rng(8), certificate(kind, 1)[1].document()
    for _ in range(10):
        name, text = certified.mutant(known, rng)
        assert judged(text) != 'holds', name


BODIES = {
    'box': Box(np.array([1.2, -0.3]), np.array([2.4, 0.4])),
    'disc': Ball(np.array([1.6, 0.1]), 0.5),
}


@cache
def in_the_way(name):
    """Return a certificate that takes all sides of a body, which the straight way goes through."""
    problem = Problem(horizon=4, obstacles=(BODIES[name],))
    case = problem, State.at(np.zeros(2), np.eye(2)), np.tile([3.5, 0.0], (4, 1))
    plan = Solver(problem).solve(*case[1:])
    return plan, certificate_of(*case, plan.rotations[1:], plan.lower_bound)


@pytest.mark.parametrize('name', BODIES)
def test_what_is_in_the_way_is_proved_to_cost_what_the_way_around_it_does(name):
    plan, made = in_the_way(name)
    free = Solver(replace(made.problem, obstacles=())).solve(made.state, made.goals)
    assert verified(parsed(made.text().encode())).proved > 1.001 * free.objective
    assert plan.lower_bound > 1.001 * free.objective


@pytest.mark.parametrize(
    ('path', 'value', 'outcome'),
    [
        (('limits', 'walls', 0, 'max'), [1.3, -0.2], 'does not hold'),
        (('limits', 'walls', 0, 'min'), [41.2, -0.3], 'does not hold'),
        (('limits', 'walls'), [], 'wall is not a whole number'),
        (('tree', 'wall'), 1, 'wall is not a whole number'),
        (('tree', 'at'), 0.0, 'has no angle'),
    ],
)
def test_a_proof_beside_a_box_takes_the_box(path, value, outcome):
    known = in_the_way('box')[1].document()
    inner = known
    for name in path[:-1]:
        inner = inner[name]
    inner[path[-1]] = value
    assert outcome in judged(json.dumps(known))


@pytest.mark.parametrize(
    ('path', 'value', 'outcome'),
    [
        (('limits', 'walls', 0, 'radius'), 0.1, 'does not hold'),
        (('limits', 'walls', 0, 'of'), 'end', 'presses is not a list'),
        (('limits', 'walls', 0, 'of'), 'ends', 'have no sides'),
        (('tree', 'at'), 7.0, 'not within what it splits'),
        (('problem', 'discretisation'), 'exact', 'presses is not a list'),
    ],
)
def test_a_proof_beside_a_disc_takes_the_disc(path, value, outcome):
    known = in_the_way('disc')[1].document()
    for wall in known['limits']['walls'] if path[0] == 'limits' else ():
        wall[path[-1]] = value
    if path[0] != 'limits':
        known[path[0]][path[1]] = value
    assert outcome in judged(json.dumps(known))


def test_pressing_from_the_wrong_side_is_refused():
    known = in_the_way('box')[1].document()
    leaf = next(each for each in certified.leaves(known['tree']) if any(each['presses']))
    leaf['presses'] = [-y for y in leaf['presses']]
    assert 'presses are negative' in judged(json.dumps(known))


@pytest.mark.parametrize('seed', range(4))
def test_a_tangent_touches_where_slopes_vanish_but_for_rounding(seed):
    """Of what its slopes are off by there, each step's bound lacks as much."""
    rng, count = np.random.default_rng([seed, 21]), 40
    axes = np.linalg.qr(rng.normal(size=(count, count)))[0]
    bent = axes * 10.0 ** rng.uniform(-5.0, 0.0, count) @ axes.T
    bent = 0.5 * (bent + bent.T)
    q, nothing = bent @ rng.normal(size=(count, 2)), (np.zeros((0, count)), np.zeros((0, 2)))
    point, _ = touching_freely([bent], q, nothing)
    left = bent.astype(np.longdouble) @ point + q
    assert np.abs(left).max() < 3e-16


def test_a_bound_that_is_too_high_has_no_certificate():
    case = certified.case('hull', np.random.default_rng(3))
    plan = Solver(case.problem).solve(case.state, case.goals)
    with pytest.raises(Unproved, match='one tangent proves'):
        certificate_of(*case, plan.rotations[1:], 1.00001 * plan.objective)


def test_a_search_that_is_too_long_has_no_certificate(monkeypatch):
    monkeypatch.setattr('orbimpc_ros.mpc.proof.faces.FaceProof.most', 10)
    case = certified.case('polygon', np.random.default_rng(3))
    plan = Solver(case.problem).solve(case.state, case.goals)
    with pytest.raises(Unproved, match='10 leaves'):
        certificate_of(*case, plan.rotations[1:], 1.00001 * plan.objective)


BESIDE = {2: np.array([1.0, 2.5]), 3: np.array([1.0, 2.5, 0.0])}
CUBE = Box(BESIDE[3], BESIDE[3] + 0.5)
SECOND = {'rotation_order': 2, 'translation_order': 1}
# Of these the verifier knows nothing: a floor, a turn limit, bodies or a cone.
LEFT_OUT = {
    'floor': SECOND | {'floor': Floor('circle', fraction=0.3)},
    'polygon and turn rate': SECOND | {'floor': Floor('polygon', 6, 0.3), 'max_rate': 1.5},
    'disc': SECOND | {'obstacles': (Ball(BESIDE[2], 0.5),)},
    'approach': SECOND | {'approach': Approach(1.0, (1.0, 0.0))},
    'polygon in space': {'dimension': 3, 'floor': Floor('polygon', 6, 0.2)},
    'turn rate in space': {'dimension': 3, 'floor': Floor('circle', fraction=0.2), 'max_rate': 1.5},
    'ball in space': {'dimension': 3, 'obstacles': (Ball(BESIDE[3], 0.5), CUBE)},
    'box': SECOND | {'dimension': 3, 'obstacles': (CUBE,)},
}


def ahead(kind, away):
    """Return a problem with a goal so far ahead, and a plan of it."""
    problem = Problem(horizon=4, weights=Weights(1.0, 0.05, 0.0, 10.0), **LEFT_OUT[kind])
    n = problem.dimension
    still = np.eye(n) if problem.rotation_order == 2 else None
    case = problem, State.at(np.zeros(n), np.eye(n), coasted=still), away * np.eye(n)[[0] * 4]
    return case, Solver(problem, coasting=True).solve(*case[1:])


@pytest.mark.parametrize('kind', LEFT_OUT)
def test_what_proofs_leave_out_is_stated_and_needs_none_where_it_is_out_of_the_way(kind):
    case, plan = ahead(kind, 5.0)
    made = certificate_of(*case, plan.rotations[1:], plan.lower_bound)
    verdict = verified(parsed(made.text().encode()))
    assert verdict.holds
    assert verdict.proved <= plan.objective * (1.0 + 1e-7)
    known, stated = made.document(), statement(*case)
    assert {name: known[name] for name in stated} == stated


@pytest.mark.parametrize('kind', ['floor', 'polygon and turn rate', 'polygon in space'])
def test_where_what_proofs_leave_out_matters_words_say_how_much_is_proved(kind):
    case, plan = ahead(kind, 0.1)
    bound = plan.proof.lower_bound
    assert bound > 0.0
    with pytest.raises(Unproved, match=r'nothing to split|as accurate'):
        certificate_of(*case, plan.rotations[1:], bound)


def test_floors_that_the_format_cannot_state_have_no_certificates(monkeypatch):
    monkeypatch.setitem(SHAPES, 'eastward', Eastward())
    problem, state = Problem(floor=Floor('eastward')), State.at(np.zeros(2), np.eye(2))
    with pytest.raises(Unproved, match=r'floor\.shape'):
        certificate_of(problem, state, np.ones((5, 2)), np.tile(np.eye(2), (5, 1, 1)), 1.0)


def test_numbers_are_written_as_they_are():
    _, made = certificate('circle', 1)
    known = json.loads(made.text())
    assert np.array_equal(known['goals'], made.goals)
    assert np.array_equal(known['tree']['point'], made.tree.point)
    assert known['lower_bound'] == made.lower_bound


def test_a_bound_that_no_sector_proves_is_given_up_before_the_interpreter_does():
    problem = Problem(horizon=16, floor=Floor('circle', fraction=0.6))
    state, goals = State.at(np.zeros(2), np.eye(2)), np.tile([3.0, 1.0], (16, 1))
    x = np.tile([0.6, 0.0], (16, 1))
    assert SectorProof(problem, state, goals, x, np.inf, patient).tree() is None


def test_where_nothing_is_split_words_are_about_the_tangent():
    case = certified.case('space, coasting', np.random.default_rng(4))
    plan = Solver(case.problem, coasting=True).solve(case.state, case.goals)
    with pytest.raises(Unproved, match='one tangent proves'):
        certificate_of(*case, plan.rotations[1:], 1.1 * plan.objective)
