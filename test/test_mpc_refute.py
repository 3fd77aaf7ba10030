# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Refutations: they exist for infeasible problems, and not for feasible ones."""

import functools
import itertools
import json
import sys
from dataclasses import replace

import adversary
import numpy as np
import pytest
from oracles import enumerated
from plans import judged
from problems import ORDERS, polled, rotation, seeds
from problems import state as state_of

from orbimpc_ros.loop.intercept import steps_before
from orbimpc_ros.mpc.errors import BadInput, Infeasible, SolverFailure
from orbimpc_ros.mpc.problem import Approach, Ball, Box, Floor, MovingObstacle, Problem, State
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.proof.document import (
    Unproved,
    held_in_time,
    parsed,
    refutation,
    text_of,
    verified,
)
from orbimpc_ros.mpc.proof.tree import EMPTY, one
from orbimpc_ros.mpc.solve.refute import refutation_of
from orbimpc_ros.mpc.solve.solver import Solver

WING = Problem(horizon=6, max_rate=0.6, floor=Floor('circle', fraction=1.0))
RADIUS = 0.15
AHEAD = State.at(np.zeros(2), np.eye(2))


def held(make):
    """Return what ``make`` returns if it passes verification, without a time limit; else None."""
    return held_in_time(lambda _: make(), lambda: 0.0, np.inf)


def hunting(problem, goal, state=AHEAD):
    """Return the capture problem of a vehicle and a goal at rest."""
    return Case(problem, state, np.tile(goal, (problem.horizon, 1)), RADIUS)


# --- problems, most of them infeasible


def arriving(rng, away, n=2, **given):
    """Return a case with a goal at ``away`` times the reach, in a random direction."""
    problem = Problem(n, horizon=int(rng.integers(3, 9)), terminal='constraint', **given)
    start, way = state_of(rng, problem), rng.normal(size=n)
    reach = np.abs(problem.maps.reach[-1]).sum()
    moved = problem.maps.places[-1, -2] * start.velocity if problem.inertial else 0.0
    return case(problem, start, start.position + moved + away * reach * way / np.linalg.norm(way))


def case(problem, start, goal):
    return Case(problem, start, np.tile(goal, (problem.horizon, 1)))


def out_of_reach(rng):
    orders = dict(ORDERS[int(rng.integers(len(ORDERS)))])
    return arriving(rng, rng.uniform(1.0, 1.6), orders.pop('dimension'), **orders)


def out_of_reach_above_a_floor(rng):
    shape = ('circle', 'polygon')[int(rng.integers(2))]
    floor = Floor(shape, 6, float(rng.uniform(0.3, 0.85)))
    return arriving(rng, rng.uniform(1.0, 1.4), floor=floor)


def behind_a_wing(rng):
    """Return an arrival that only a vehicle able to turn on the spot, or to wait, could reach."""
    limits = {'floor': Floor('circle', fraction=0.7), 'max_rate': 0.5}
    return arriving(rng, rng.uniform(0.1, 0.9), **limits)


def no_turn_meets_the_cone(rng):
    cone = Approach(float(rng.uniform(0.1, 0.6)), tuple(rotation(rng, 2)[0].tolist()))
    limits = {'floor': Floor('circle', fraction=0.7), 'max_rate': 0.5, 'approach': cone}
    start = State.at(np.zeros(2), rotation(rng, 2, 0.3))
    return case(Problem(horizon=int(rng.integers(2, 5)), **limits), start, rng.normal(size=2))


def walled_in(rng):
    """Return an arrival outside four walls, from inside them."""
    size = rng.uniform(1.2, 2.0)
    outer = size + rng.uniform(1.1, 1.6)
    corners = (-outer, size, outer, outer), (-outer, -outer, outer, -size)
    corners += (size, -outer, outer, outer), (-outer, -outer, -size, outer)
    problem = Problem(
        horizon=int(rng.integers(4, 6)), terminal='constraint', no_corner_cutting=True,
        obstacles=tuple(Box(each[:2], each[2:]) for each in corners),
    )  # fmt: skip
    start = State.at(rng.uniform(-0.3, 0.3, 2), rotation(rng, 2))
    return case(problem, start, (outer + 0.3) * np.sqrt(2.0) * rotation(rng, 2)[0])


def held_by_a_body(rng):
    """Return a start too deep inside a body to leave it within a step."""
    n = int(rng.integers(2, 4))
    half = rng.uniform(0.9, 2.0, size=n)
    problem = Problem(n, horizon=int(rng.integers(2, 6)), obstacles=(Box(-half, half),))
    start = State.at(rng.uniform(-0.3, 0.3, n), rotation(rng, n))
    return case(problem, start, rng.normal(size=n))


def held_by_a_ball_in_space(rng):
    ball = MovingObstacle.drifting(Ball(np.zeros(3), float(rng.uniform(8.0, 9.0))), np.zeros(3))
    start = State.at(np.zeros(3), rotation(rng, 3), hazards=(ball,))
    return case(Problem(3, horizon=3), start, 9.0 * rotation(rng, 3)[0])


def run_over(rng):
    """Return a start in the way of a body that is faster, and wide."""
    ahead, size = rotation(rng, 2)[0], rng.uniform(2.5, 5.0)
    body = Ball(-ahead * (size + 1.5), float(size))
    if rng.random() < 0.5:
        body = Box(body.centre - size, body.centre + size)
    hazard = MovingObstacle.drifting(body, rng.uniform(1.5, 3.0) * ahead)
    start = State.at(np.zeros(2), rotation(rng, 2), hazards=(hazard,))
    return case(Problem(horizon=int(rng.integers(3, 6))), start, rng.normal(size=2))


def too_slow_to_speed_up(rng):
    problem, start, _ = arriving(rng, 0.0, max_acceleration=float(rng.uniform(0.05, 0.2))).parts
    goal = start.position + rng.uniform(0.3, 0.8) * problem.horizon * start.attitude[:, 0]
    return case(problem, replace(start, rotation=0.2 * start.attitude), goal)


def too_steep_a_descent(rng):
    cones = {'tilt': float(rng.uniform(0.1, 0.5)), 'glide_slope': float(rng.uniform(0.2, 0.6))}
    problem = arriving(rng, 0.0, 3, translation_order=2, **cones).problem
    place = np.append(rng.uniform(-2.0, 2.0, 2), rng.uniform(1.0, 6.0)) * problem.horizon
    upright, velocity = np.eye(3)[:, [2, 0, 1]], np.append(rng.normal(size=2), -1.0)
    return case(problem, State.at(place, upright, velocity=velocity), np.zeros(3))


KINDS = {
    each.__name__.replace('_', ' '): each
    for each in (
        out_of_reach, out_of_reach_above_a_floor, behind_a_wing,
        no_turn_meets_the_cone, walled_in, held_by_a_body, held_by_a_ball_in_space, run_over,
        too_slow_to_speed_up, too_steep_a_descent,
    )
}  # fmt: skip


def sought_of(kind, seed=0):
    return KINDS[kind](np.random.default_rng([seed, *kind.encode()]))


@functools.cache
def refuted(kind):
    """Return problems of a kind that are refuted, at least one, with their refutations."""
    found = [
        (each, held(lambda each=each: refutation_of(each)))
        for each in map(functools.partial(sought_of, kind), seeds(*range(8)))
    ]
    found = [(each, made) for each, made in found if made is not None]
    assert found, f'nothing of {kind} is refuted'
    return found


@pytest.mark.parametrize('kind', KINDS)
def test_what_nothing_satisfies_is_refuted_and_has_no_plan(kind):
    for sought, made in refuted(kind):
        verdict = verified(parsed(text_of(made).encode()))
        assert verdict.holds
        assert verdict.claimed == verdict.proved == np.inf
        with pytest.raises((Infeasible, SolverFailure)):
            Solver(sought.problem).solve(sought.state, sought.goals, None, polled(100))


@pytest.mark.parametrize('seed', seeds(30))
def test_what_somebody_has_flown_is_not_refuted(seed):
    """Random flights at the edge of their limits, and one along a face, too slow for any plane."""
    flown = [*adversary.plans(seed, 40)]
    assert len(flown) > 10
    for drawn in flown:
        with pytest.raises(Unproved, match='no refutation'):
            refutation_of(drawn.case, 1, polled(100))
    slow = Problem(3, horizon=2, terminal='constraint', max_rate=1, floor=Floor('polygon', 6, 0.4))
    Solver(slow).solve(State.at(np.zeros(3), np.eye(3)), np.tile([1.5, 0.0, 0.0], (2, 1)))


def among_boxes(seed):
    """Return an arrival near the limit of reach, sometimes behind a box."""
    rng = np.random.default_rng([seed, 90])
    middle, half = rng.uniform(-2.0, 2.0, 2), rng.uniform(0.3, 1.5, 2)
    boxes = (Box(middle - half, middle + half),) if np.any(np.abs(middle) > half + 0.2) else ()
    shared, count = bool(rng.integers(2)), int(rng.integers(2, 4))
    problem = Problem(
        horizon=count, terminal='constraint', obstacles=boxes, no_corner_cutting=shared
    )
    way = rotation(rng, 2)
    goal = way[:, 0] + rng.uniform(0.6, 1.2) * (count - 1) * rotation(rng, 2)[:, 0]
    return Case(problem, State.at(np.zeros(2), way), np.tile(goal, (count, 1)))


@pytest.mark.parametrize('seed', range(20))
def test_what_is_refuted_has_no_solution_and_what_has_one_is_not(seed):
    """Compared with another solver that enumerates all choices of sides."""
    sought = among_boxes(seed)
    known = sought.parts
    made, best = held(lambda: refutation_of(sought)), enumerated(*known)
    if best < np.inf:
        assert made is None
        assert Solver(sought.problem).solve(*known[1:]).objective == pytest.approx(best, rel=1e-4)
        return
    with pytest.raises(Infeasible):
        Solver(sought.problem).solve(*known[1:])
    assert made is not None


# --- time limits


def test_refutations_are_given_up_when_it_is_late():
    with pytest.raises(Unproved, match='in time'):
        refutation_of(sought_of('run over'), 1, lambda: True)
    sought = hunting(WING, [4.0, 1.0])
    assert judged(text_of(refutation_of(sought, 3))) == 'holds'
    with pytest.raises(Unproved, match='in time'):
        refutation_of(sought, 3, polled(2))


@pytest.mark.parametrize(('end', 'known'), [(11.0, True), (9.0, False)])
def test_half_of_the_time_is_left_to_go_through_what_is_made(end, known):
    sought, times = sought_of('out of reach'), itertools.chain([0.0], itertools.repeat(5.0))
    made = held_in_time(lambda late: refutation_of(sought, 1, late), lambda: next(times), end)
    assert (made is not None) == known


@pytest.mark.parametrize('kind', ['out of reach', 'walled in', 'behind a wing'])
def test_what_is_made_and_does_not_hold_is_no_refutation(kind):
    sought, made = refuted(kind)[0]
    count, n = sought.problem.horizon, sought.problem.dimension
    nothing = one(np.zeros((count, n)), np.zeros(count))
    nothing = nothing._replace(nodes=np.array([[EMPTY, 0, 0, 0, 0]]))
    twice = {**made, 'refuted': {'trees': 2 * made['refuted']['trees']}}
    for each in (refutation(sought, [nothing]), twice, refutation(sought, [])):
        assert held(lambda each=each: each) is None
    assert held(lambda: made) is made


def test_without_clarabel_or_with_one_that_panics_nothing_is_refuted(monkeypatch):
    make = functools.partial(refutation_of, sought_of('held by a body'))
    monkeypatch.setattr('orbimpc_ros.mpc.solve.program.run', lambda *_: None)
    with pytest.raises(Unproved, match='no refutation of all'):
        make()
    for name in ('program', 'conic'):
        monkeypatch.delitem(sys.modules, f'orbimpc_ros.mpc.solve.{name}')
    monkeypatch.setitem(sys.modules, 'clarabel', None)
    with pytest.raises(BadInput, match='not installed'):
        make()
    assert held(make) is None


# --- catches


def test_a_catch_is_refuted_by_its_last_heading_alone():
    with pytest.raises(Unproved, match='catch at step 2'):
        refutation_of(hunting(WING, [2.0, 0.0]), 2)
    coned = replace(WING, approach=Approach(0.2, (-1.0, 0.0)))
    made = refutation_of(hunting(coned, [2.0, 0.0]), 4)
    assert judged(text_of(made)) == 'holds'


@pytest.mark.parametrize(('bound', 'count'), [(0.3, 2), (0.1, 0), (0.0, 0), (0.25, 2), (1.3, 12)])
def test_ends_before_a_time_are_counted_but_for_rounding(bound, count):
    assert steps_before(bound, 0.1) == count


def test_speeds_that_change_slowly_refute_a_catch():
    state = State.at(np.zeros(2), 0.1 * np.eye(2), attitude=np.eye(2))
    problem = Problem(horizon=4, max_acceleration=0.1)
    made = refutation_of(hunting(problem, [2.0, 0.0], state), 4)
    assert judged(text_of(made)) == 'holds'
    assert made['limits']['speeds'] == {'entry': 0.1, 'change': 0.1}
    del made['limits']['speeds']
    assert judged(text_of(made)) == 'does not hold'


# --- mutants


def of_catches():
    cone = Approach(0.3, (1.0, 0.0))
    problem = replace(WING, floor=Floor('circle', fraction=0.8), approach=cone)
    return refutation_of(hunting(problem, [1.0, 1.6]), 3)


def in_another_dimension(known):
    for tree in known['refuted']['trees']:
        tree['point'] = [[[*each, 0.0] for each in leaf] for leaf in tree['point']]


CHANGES = {
    'no tree': lambda known: known['refuted'].update(trees=[]),
    'too many trees': lambda known: known['refuted'].update(trees=3 * known['refuted']['trees']),
    'a cone of nothing': lambda known: known['refuted'].pop('radius'),
    'trees of nothing': lambda known: known.update(refuted={'trees': known['refuted']['trees']}),
    'a radius below zero': lambda known: known['refuted'].update(radius=-RADIUS),
    'a bound beside it': lambda known: known.update(lower_bound=0.0),
    'multipliers of another dimension': in_another_dimension,
}


@pytest.mark.parametrize('name', CHANGES)
def test_mutants_of_refuted_catches_are_refused_or_do_not_hold(name):
    known = of_catches()
    assert judged(json.dumps(known)) == 'holds'
    CHANGES[name](known)
    assert judged(json.dumps(known)) != 'holds'


def test_what_is_proved_of_catches_ends_at_the_first_that_is_not_refuted():
    known = of_catches()
    tree = known['refuted']['trees'][1]
    tree['point'] = (-np.array(tree['point'])).tolist()
    verdict = verified(known)
    assert not verdict.holds
    assert (verdict.claimed, verdict.proved) == (4.0, 2.0)


def test_below_a_floor_of_faces_the_first_change_of_speed_is_not_known():
    """The vehicle must be above a polyhedral floor in space within its first step."""
    problem = Problem(
        3, horizon=3, floor=Floor('polygon', 6, 0.5), max_acceleration=0.05, terminal='constraint'
    )
    start = State.at(np.zeros(3), 0.1 * np.eye(3), attitude=np.eye(3))
    goal = np.array([0.1 + 2 * 0.5, 0.0, 0.0])
    sought = Case(problem, start, np.tile(goal, (3, 1)))
    plan = Solver(problem).solve(start, sought.goals)
    assert np.linalg.norm(plan.positions[-1] - goal) < 1e-6
    with pytest.raises(Unproved, match='no refutation'):
        refutation_of(sought)
