# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Refutations: of what nothing satisfies there is one, and of what something does there is none."""

import copy
import functools
import itertools
import json
import sys
from contextlib import suppress
from dataclasses import replace
from fractions import Fraction

import certified
import numpy as np
import pytest
import refutable
from problems import rotation

from orbimpc_ros.loop.intercept import steps_before
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Approach, Ball, Box, Floor, MovingObstacle, Problem, State
from orbimpc_ros.mpc.problem.sought import Sought
from orbimpc_ros.mpc.proof.certificate import Leaf, plain, statement
from orbimpc_ros.mpc.proof.prove import Unproved, held, held_in_time
from orbimpc_ros.mpc.proof.refutation_program import Motion, RefutationProgram
from orbimpc_ros.mpc.proof.refute import (
    catches_refuted,
    refutation_of,
    stated,
)
from orbimpc_ros.mpc.proof.verifier import Refused, parsed, posed_by, refuted_by, verified
from orbimpc_ros.mpc.proof.verifier.bound import bound
from orbimpc_ros.mpc.proof.verifier.exact import UNIT
from orbimpc_ros.mpc.proof.verifier.least import over_speeds
from orbimpc_ros.mpc.proof.verifier.regions import Sector
from orbimpc_ros.mpc.proof.verifier.splits import root
from orbimpc_ros.mpc.proof.verifier.walls import BoxWall
from orbimpc_ros.mpc.solve.solver import Solver

WING = Problem(horizon=6, max_rate=0.6, floor=Floor('circle', fraction=1.0))
RADIUS = 0.15


def judged(text):
    """Return whether a certificate holds, or why it is none."""
    try:
        return 'holds' if verified(parsed(text.encode())).holds else 'does not hold'
    except Refused as error:
        return str(error)


def refuted(kind, seeds=range(20)):
    """Return the first refutation of a kind of problem."""
    for seed in seeds:
        case = refutable.KINDS[kind](np.random.default_rng([seed, *kind.encode()]))
        try:
            return refutation_of(Sought(*case))
        except Unproved:
            continue
    raise AssertionError(f'nothing of {kind} is refuted')


@pytest.mark.parametrize('kind', refutable.KINDS)
def test_what_nothing_satisfies_is_refuted(kind):
    verdict = verified(parsed(refuted(kind).text().encode()))
    assert verdict.holds
    assert verdict.claimed == verdict.proved == np.inf


@pytest.mark.parametrize('kind', [*certified.KINDS, *certified.LIMITED])
def test_what_has_a_plan_is_not_refuted(kind):
    case = certified.case(kind, np.random.default_rng([1, *kind.encode()]))
    with pytest.raises(Unproved, match='no refutation'):
        refutation_of(Sought(*case))


def test_balls_in_space_are_left_out_of_what_is_refuted_and_nothing_else_is():
    problem, goals = Problem(3, horizon=4, terminal='constraint'), np.tile([9.0, 0.0, 0.0], (4, 1))
    bodies = Ball(np.full(3, 9.0), 1.0), Box(np.full(3, 8.0), np.full(3, 9.0))
    moving = tuple(MovingObstacle.drifting(each, np.eye(3)[2]) for each in bodies)
    made = refutation_of(Sought(problem, State.at(np.zeros(3), np.eye(3), hazards=moving), goals))
    assert judged(made.text()) == 'holds'
    assert len(made.document()['limits']['walls']) == 1
    around = (MovingObstacle.drifting(Ball(np.zeros(3), 9.0), np.zeros(3)),)
    held = State.at(np.zeros(3), np.eye(3), hazards=around)
    with pytest.raises(Unproved, match='no refutation'):
        refutation_of(Sought(replace(problem, terminal='penalty'), held, goals))


def test_who_is_below_a_floor_that_is_not_known_changes_speed_from_nobody_knows_where():
    """It is told to be at its floor at once: a polygon in space, which is left out."""
    problem = Problem(3, horizon=3, floor=Floor('polygon', 6, 0.5), max_acceleration=0.05)
    start = State.at(np.zeros(3), 0.1 * np.eye(3), attitude=np.eye(3))
    goal = np.array([0.1 + 2 * 0.5, 0.0, 0.0])
    sought = Sought(replace(problem, terminal='constraint'), start, np.tile(goal, (3, 1)))
    plan = Solver(sought.problem).solve(start, sought.goals)
    assert np.linalg.norm(plan.positions[-1] - goal) < 1e-6
    with pytest.raises(Unproved, match='no refutation'):
        refutation_of(sought)


# --- in time


def sought_of(kind, seed=0):
    return Sought(*refutable.KINDS[kind](np.random.default_rng([seed, *kind.encode()])))


@pytest.mark.parametrize('kind', refutable.KINDS)
def test_what_is_refuted_in_time_holds_and_is_what_it_is_without_a_deadline(kind):
    for seed in range(3):
        sought = sought_of(kind, seed)
        made = held(lambda sought=sought: [refutation_of(sought)])
        try:
            known = refutation_of(sought).text()
        except Unproved:
            assert made is None
            continue
        assert judged(known) == 'holds'
        assert made.text() == known


def test_a_refutation_polls_before_each_part_and_is_given_up_when_it_is_late(monkeypatch):
    sought, parts, polls = sought_of('run over'), [], []
    answer = RefutationProgram.answer
    monkeypatch.setattr(RefutationProgram, 'answer', lambda *a: parts.append(0) or answer(*a))
    refutation_of(sought, lambda: polls.append(len(parts)))
    assert len(parts) > 1
    assert polls == list(range(len(parts)))
    for late in range(len(polls)):
        count = itertools.count()
        with pytest.raises(Unproved, match='in time'):
            refutation_of(sought, lambda late=late, count=count: next(count) >= late)


def test_catches_are_given_up_when_it_is_late_too():
    state = State.at(np.zeros(2), np.eye(2))
    sought = Sought(WING, state, np.tile([4.0, 1.0], (6, 1)), RADIUS)
    assert judged(catches_refuted(sought, 3).text()) == 'holds'
    polls = itertools.count()
    with pytest.raises(Unproved, match='in time'):
        catches_refuted(sought, 3, lambda: next(polls) >= 2)


@pytest.mark.parametrize(('end', 'known'), [(11.0, True), (9.0, False)])
def test_half_of_the_time_is_left_to_go_through_what_is_made(end, known):
    sought, times = sought_of('out of reach'), iter([0.0, 5.0])  # begins; before the only part
    made = held_in_time(lambda late: [refutation_of(sought, late)], lambda: next(times), end)
    assert (made is not None) == known


@pytest.mark.parametrize('kind', ['out of reach', 'walled in', 'behind a wing'])
def test_what_is_made_and_does_not_hold_is_no_refutation(kind):
    made = refuted(kind)
    nothing = Leaf(np.zeros((made.sought.problem.horizon, made.sought.problem.dimension)))
    for trees in ((nothing,), 2 * made.trees, ()):
        each = replace(made, trees=trees)
        assert held(lambda each=each: [each]) is None
    assert held(lambda: [each, made]) is made


def test_who_has_no_clarabel_or_one_that_panics_refutes_nothing(monkeypatch):
    make = functools.partial(refutation_of, sought_of('out of reach'))
    monkeypatch.setattr('orbimpc_ros.mpc.solve.conic.run', lambda *_: None)
    with pytest.raises(Unproved, match='no refutation of all'):
        make()
    monkeypatch.delitem(sys.modules, 'orbimpc_ros.mpc.solve.conic')
    monkeypatch.setitem(sys.modules, 'clarabel', None)
    with pytest.raises(BadInput, match='not installed'):
        make()
    assert held(lambda: [make()]) is None


# --- catches


def flown(rng, problem, state, goals, count):
    """Return s_1..s_N of legal trajectories, shape (count, N, 2)."""
    turns = problem.step * problem.max_rate * rng.choice([-1.0, 0.0, 1.0], (count, problem.horizon))
    angles = np.arctan2(*state.attitude[::-1, 0]) + np.cumsum(turns, axis=1)
    sizes = rng.uniform(problem.floor.fraction, 1.0, (count, problem.horizon))
    headings = sizes[..., None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.array([trajectory_of(problem, state, goals, x).positions[1:] for x in headings])


def every_flight(problem, state, goals, ways):
    """Return s_1..s_N of all plans at full speed whose turns are so many shares of the widest."""
    shares = np.linspace(-1.0, 1.0, ways)
    turns = np.array(list(itertools.product(shares, repeat=problem.horizon - 1)))
    angles = np.arctan2(*state.attitude[::-1, 0]) + problem.step * problem.max_rate * np.cumsum(
        turns, axis=1
    )
    before = np.column_stack([state.rotation[:, 0]])
    moved = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    first = np.broadcast_to(before.T[None], (len(moved), 1, 2))
    steps = problem.step * problem.forward * np.concatenate([first, moved], axis=1)
    return state.position + np.cumsum(steps, axis=1)


@pytest.mark.parametrize('seed', range(4))
def test_catches_are_refuted_up_to_the_first_one_of_all_flights_of_a_wing(seed):
    rng = np.random.default_rng([seed, 31])
    way = rotation(rng, 2)
    state = State.at(rng.normal(size=2), way, attitude=way)
    place = state.position + rng.uniform(1.0, 4.0) * way @ [np.cos(1.3), rng.choice([-1, 1])]
    goals = np.tile(place, (6, 1)) + 0.1 * np.cumsum(rng.normal(size=(6, 2)), axis=0)
    sought = Sought(WING, state, goals, RADIUS)
    miss = np.linalg.norm(every_flight(WING, state, goals, 7) - goals, axis=-1).min(axis=0)
    for k in range(1, 7):
        # Between flights of the grid others come nearer by what a seventh of a turn moves.
        if miss[k - 1] > RADIUS + 0.35:
            assert judged(catches_refuted(sought, k).text()) == 'holds'
        elif miss[k - 1] < RADIUS:
            with pytest.raises(Unproved, match=f'of a catch at step {k}'):
                catches_refuted(sought, k)
            break
        else:
            break


@pytest.mark.parametrize('kind', ['any speed', 'exact', 'polygon', 'no turn limit'])
def test_no_legal_trajectory_is_where_a_catch_is_refuted(kind):
    given = {
        'any speed': {'floor': Floor('circle', fraction=0.5)},
        'exact': {'discretisation': 'exact'},
        'polygon': {'floor': Floor('polygon', 6, 0.7)},
        'no turn limit': {'max_rate': 0.0},
    }[kind]
    problem, rng = replace(WING, **given), np.random.default_rng([5, *kind.encode()])
    turning = problem if problem.max_rate else replace(problem, max_rate=3.0)
    found = 0
    for _ in range(12):
        way = rotation(rng, 2)
        state = State.at(np.zeros(2), way, attitude=way, disturbance=0.1 * rng.normal(size=2))
        goals = np.tile(rng.uniform(0.5, 5.0) * rotation(rng, 2)[:, 0], (6, 1))
        places = flown(rng, turning, state, goals, 300)
        if problem.floor.shape == 'polygon':  # full speed is beyond every face
            places = every_flight(problem, replace(state, disturbance=np.zeros(2)), goals, 5)
            state = replace(state, disturbance=np.zeros(2))
        miss = np.linalg.norm(places - goals, axis=-1).min(axis=0)
        for k in range(1, 7):
            try:
                catches_refuted(Sought(problem, state, goals, RADIUS), k)
            except Unproved:
                break
            assert miss[k - 1] > RADIUS
            found += 1
    assert found > 12


def test_a_catch_is_refuted_by_its_last_heading_alone():
    cone = Approach(0.2, (-1.0, 0.0))
    state = State.at(np.zeros(2), np.eye(2))
    goals = np.tile([2.0, 0.0], (6, 1))
    with pytest.raises(Unproved, match='catch at step 2'):
        catches_refuted(Sought(WING, state, goals, RADIUS), 2)
    made = catches_refuted(Sought(replace(WING, approach=cone), state, goals, RADIUS), 4)
    assert judged(made.text()) == 'holds'


@pytest.mark.parametrize('horizon', [1, 2, 3, 4])
def test_a_cone_that_no_turn_meets_is_refuted_however_near_it_is(horizon):
    farthest = horizon * refutable.WING['max_rate']
    state = State.at(np.zeros(2), 0.8 * np.eye(2), attitude=np.eye(2))
    for gap in (0.02, 0.3):
        angle = farthest + 0.3 + gap
        cone = Approach(0.3, (float(np.cos(angle)), float(np.sin(angle))))
        problem = Problem(horizon=horizon, approach=cone, **refutable.WING)
        sought = Sought(problem, state, np.zeros((horizon, 2)))
        assert judged(refutation_of(sought).text()) == 'holds'


@pytest.mark.parametrize(('bound', 'count'), [(0.3, 2), (0.1, 0), (0.0, 0), (0.25, 2), (1.3, 12)])
def test_ends_before_a_time_are_counted_but_for_rounding(bound, count):
    assert steps_before(bound, 0.1) == count


def test_speeds_that_change_slowly_refute_a_catch():
    state = State.at(np.zeros(2), 0.1 * np.eye(2), attitude=np.eye(2))
    sought = Sought(
        Problem(horizon=4, max_acceleration=0.1), state, np.tile([2.0, 0.0], (4, 1)), RADIUS
    )
    made = catches_refuted(sought, 4)
    assert judged(made.text()) == 'holds'
    known = made.document()
    assert known['limits']['speeds'] == {'entry': 0.1, 'change': 0.1}
    del known['limits']['speeds']
    assert judged(json.dumps(known)) == 'does not hold'


# --- the verifier


def caught(rng, **given):
    """Return what is sought, and the coordinates of a trajectory that catches its goal."""
    problem = Problem(horizon=5, **given)
    n = problem.dimension
    extra = {'velocity': rng.normal(size=n)} if problem.inertial else {}
    if problem.rotation_order == 2:
        extra['coasted'] = rotation(rng, n)
    state = State.at(rng.normal(size=n), rotation(rng, n), disturbance=rng.normal(size=n), **extra)
    x = rng.normal(size=(5, n))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    if problem.rotation_order == 2:
        x[0] = 0.7 * state.coasted[:, 0]
    motion = Motion.of(problem, state, np.zeros((5, n)))
    off = rng.normal(size=n)
    places = motion.free + motion.reach @ x
    goals = places + RADIUS * off / np.linalg.norm(off)
    return Sought(problem, state, goals, RADIUS), places


@pytest.mark.parametrize('seed', range(6))
@pytest.mark.parametrize(
    ('n', 'order', 'inertia'), [(2, 1, 1), (3, 1, 2), (2, 2, 1), (3, 2, 2), (3, 1, 1)]
)
def test_no_multipliers_refute_what_is_caught(n, order, inertia, seed):
    rng = np.random.default_rng([seed, n, order, inertia])
    sought, _ = caught(rng, dimension=n, rotation_order=order, translation_order=inertia)
    for k in range(1, 6):
        posed = refuted_by(stated(sought).document(), k)[-1]
        leaf = {'point': [[0.0] * n] * k, 'meets': rng.normal(size=n).tolist()}
        assert bound(posed, leaf, root(posed, None)) <= 0
        # That of the goal's direction is as near to zero as what is left to be caught.
        (*_, nearer) = refuted_by(stated(replace(sought, radius=1e-3 * RADIUS)).document(), k)
        assert nearer.radius < posed.radius


@pytest.mark.parametrize('seed', range(6))
def test_multipliers_beside_walls_do_not_refute_who_is_outside(seed):
    rng = np.random.default_rng([seed, 77])
    sought, places = caught(rng)
    low = places[3] + np.array([0.01, -1.0])
    sought = replace(sought, problem=replace(sought.problem, obstacles=(Box(low, low + 2.0),)))
    posed = refuted_by(stated(sought).document(), 5)[-1]
    region = root(posed, None)
    region = region._replace(rows=tuple(posed.limits.walls[0].side(0, 3)))  # below on the x axis
    for _ in range(20):
        leaf = {
            'point': [[0.0, 0.0]] * 5,
            'meets': rng.normal(size=2).tolist(),
            'presses': rng.uniform(0.0, 2.0, len(region.rows)).tolist(),
        }
        assert bound(posed, leaf, region) <= 0


def sides_of(walls, count):
    """Return what is known of the first steps beside walls; later ones have no part in it."""
    found = []
    for wall, k in itertools.product(walls, range(count)):
        which = 0 if isinstance(wall, BoxWall) else Sector(Fraction(0), Fraction(1))
        for place, normal, least in wall.side(which, k):
            own, later = list(place.reach)[:count], list(place.reach)[count:]
            assert not any(later)
            found.append((list(place.free), own, list(normal), least))
    return found


@pytest.mark.parametrize('kind', ['hazards', 'descent', 'pace'])
def test_the_first_steps_of_a_problem_are_those_of_a_shorter_one(kind):
    rng = np.random.default_rng([3, *kind.encode()])
    if kind == 'descent':
        case = refutable.too_steep_a_descent(rng)
        problem, state, goals = replace(case.problem, terminal='penalty'), case.state, case.goals
    else:
        hazards = [Ball(np.array([3.0, 1.0]), 0.5), Box(np.array([1.0, 1.0]), np.array([2.0, 2.0]))]
        moving = tuple(MovingObstacle.drifting(each, rng.normal(size=2)) for each in hazards)
        problem = Problem(horizon=5, max_acceleration=0.1 * (kind == 'pace'))
        state = State.at(np.zeros(2), 0.5 * np.eye(2), attitude=np.eye(2), hazards=moving)
        goals = rng.normal(size=(5, 2))
    known = stated(Sought(problem, state, goals, RADIUS)).document()
    for k in range(1, problem.horizon + 1):
        shorter = replace(problem, horizon=k)
        other = stated(Sought(shorter, state, goals[:k], RADIUS)).document()
        first, second = (refuted_by(each, k)[-1] for each in (known, other))
        assert first.limits[:4] == second.limits[:4]
        assert first.positions == second.positions
        assert first.goals == second.goals
        places = [sides_of(each.limits.walls, k) for each in (first, second)]
        assert places[0] == places[1]
        assert bool(places[0]) == (kind != 'descent')


@pytest.mark.parametrize('seed', range(5))
def test_least_speed_along_a_slope_is_below_all_that_are_allowed(seed):
    rng = np.random.default_rng(seed)
    slope, bend = rng.normal(size=2)
    low, high = np.sort(rng.random(2))
    given = round(UNIT * slope), round(UNIT * bend), Fraction(low), Fraction(high)
    least = over_speeds(*given) / UNIT
    speeds = np.linspace(low, high, 1001)
    values = slope * speeds - 0.5 * bend * speeds**2
    assert least == pytest.approx(values.min(), abs=1e-5)
    assert least <= values.min() + 1e-15


EXACT = {
    'disks': {},
    'chords': {'max_rate': 0.8},
    'speeds': {'max_acceleration': 0.1},
    'sectors': {'floor': Floor('circle', fraction=0.8), 'max_rate': 0.3},
    'cones': {'approach': Approach(0.2, (0.8, 0.6)), 'floor': Floor('circle', fraction=1.0),
              'max_rate': 0.3},
}  # fmt: skip


@pytest.mark.parametrize('kind', EXACT)
def test_what_the_program_says_is_missed_is_what_its_multipliers_prove(kind):
    problem = Problem(horizon=4, step=0.5, forward=0.6, **EXACT[kind])
    state = State.at(np.zeros(2), 0.8 * np.eye(2), attitude=np.eye(2))
    sought = Sought(problem, state, np.tile([1.3, 0.9], (4, 1)), 0.1)
    posed = refuted_by(stated(sought).document(), 4)[-1]
    motion = Motion.of(problem, state, sought.goals)
    answer = RefutationProgram(motion, posed).answer(root(posed, None))
    assert not answer.feasible
    end = motion.free[-1] + motion.reach[-1] @ answer.x
    miss = np.linalg.norm(end - sought.goals[-1]) - 0.1
    proved = float(bound(posed, plain(answer.leaf), root(posed, None)))
    assert proved == pytest.approx(miss, rel=1e-4)


def test_a_goal_beyond_the_farthest_is_missed_by_what_it_is_beyond():
    state = State.at(np.zeros(2), np.eye(2))
    sought = Sought(Problem(horizon=3), state, np.tile([4.0, 1.0], (3, 1)), RADIUS)
    posed = refuted_by(stated(sought).document(), 3)[-1]
    program = RefutationProgram(Motion.of(sought.problem, state, sought.goals), posed)
    leaf = plain(program.answer(root(posed, None)).leaf)
    away = np.hypot(3.0, 1.0) - 2.0 - RADIUS  # R_0 decides the first step
    assert float(bound(posed, leaf, root(posed, None))) == pytest.approx(away)


def test_a_goal_beyond_the_farthest_takes_no_program_and_one_on_the_rim_does(monkeypatch):
    parts, answer = [], RefutationProgram.answer
    monkeypatch.setattr(RefutationProgram, 'answer', lambda *a: parts.append(0) or answer(*a))
    for problem in (WING, replace(WING, max_rate=0.0), Problem(horizon=6), Problem(3, horizon=6)):
        n = problem.dimension
        far = Sought(problem, State.at(np.zeros(n), np.eye(n)), 7.0 * np.eye(n)[[0] * 6], RADIUS)
        assert judged(catches_refuted(far, 6).text()) == 'holds'
        assert not parts
    goals = np.tile([3.0 + RADIUS, 0.0], (6, 1))
    rim = Sought(WING, State.at(np.zeros(2), np.eye(2)), goals, RADIUS)
    with pytest.raises(Unproved, match='catch at step 3'):
        catches_refuted(rim, 3)
    assert parts


def test_shares_without_a_cone_are_refused():
    state = State.at(np.zeros(2), np.eye(2))
    sought = Sought(Problem(horizon=2), state, np.zeros((2, 2)), RADIUS)
    posed = refuted_by(stated(sought).document(), 2)[-1]
    leaf = {'point': [[0.0, 0.0]] * 2, 'shares': [[1.0, 0.0], [0.0, 0.0]]}
    with pytest.raises(Refused, match='no cone'):
        bound(posed, leaf, root(posed, None))


@pytest.mark.parametrize('seed', range(10))
def test_no_shares_refute_a_heading_that_is_in_its_cone_and_its_sector(seed):
    rng = np.random.default_rng([seed, 12])
    angle = rng.uniform(-0.5, 0.5)
    cone = Approach(0.3, (float(np.cos(angle)), float(np.sin(angle))))
    problem = Problem(horizon=1, approach=cone, **refutable.WING)
    sought = Sought(problem, State.at(np.zeros(2), np.eye(2)), np.zeros((1, 2)))
    posed = refuted_by(stated(sought).document(), 1)[-1]
    for _ in range(50):
        leaf = {'point': [[0.0, 0.0]], 'shares': [rng.normal(size=2).tolist()]}
        assert bound(posed, leaf, root(posed, None)) <= 0


# --- mutants

ARRIVAL = 'out of reach'


def of_catches():
    state = State.at(np.zeros(2), np.eye(2))
    goals = np.tile([1.0, 1.6], (6, 1))
    cone = Approach(0.3, (1.0, 0.0))
    problem = replace(WING, floor=Floor('circle', fraction=0.8), approach=cone)
    return catches_refuted(Sought(problem, state, goals, RADIUS), 3).document()


def changed(known, *path):
    """Return a copy, and the mapping or list in it that a path leads to."""
    made = copy.deepcopy(known)
    place = made
    for name in path:
        place = place[name]
    return made, place


def every_leaf(known):
    return [leaf for tree in known['refuted']['trees'] for leaf in certified.leaves(tree)]


def mutants(known):
    """Yield changed refutations, none of which may hold, each with what was done."""
    made, _ = changed(known)
    for leaf in every_leaf(made):
        leaf['meets'] = [0.0, 0.0]
    yield 'no multipliers', made
    made, _ = changed(known)
    for leaf in every_leaf(made):
        leaf['meets'] = [-x for x in leaf['meets']]
    yield 'multipliers of the other sign', made
    made, refuting = changed(known, 'refuted')
    refuting['radius'] = 5.0
    yield 'a larger goal', made
    made, _ = changed(known)
    made['goals'] = [[1.0 + k, 0.0] for k in range(6)]
    yield 'a goal straight on', made
    made, _ = changed(known)
    made['problem']['max_rate'] = 0.0
    yield 'no turn limit', made
    made, refuting = changed(known, 'refuted')
    refuting['trees'] = []
    yield 'no tree', made
    made, refuting = changed(known, 'refuted')
    refuting['trees'] = refuting['trees'] * 3
    yield 'more trees than steps', made
    made, refuting = changed(known, 'refuted')
    del refuting['radius']
    yield 'a cone of nothing', made
    del refuting['cone']
    yield 'several trees of nothing', made
    made, refuting = changed(known, 'refuted')
    refuting['radius'] = -RADIUS
    yield 'a radius below zero', made
    made, _ = changed(known)
    yield 'a bound beside it', {**made, 'lower_bound': 0.0}
    made, _ = changed(known)
    for leaf in every_leaf(made):
        leaf['meets'] = [*leaf['meets'], 0.0]
    yield 'multipliers of another dimension', made


def test_mutants_of_refuted_catches_are_refused_or_do_not_hold():
    known = of_catches()
    assert judged(json.dumps(known)) == 'holds'
    for name, made in mutants(known):
        assert judged(json.dumps(made)) != 'holds', name


def test_what_is_proved_of_catches_ends_at_the_first_that_is_not_refuted():
    known = of_catches()
    known['refuted']['trees'][1] = {'point': [[0.0, 0.0]] * 2}
    verdict = verified(known)
    assert not verdict.holds
    assert (verdict.claimed, verdict.proved) == (4.0, 2.0)


@pytest.mark.parametrize('kind', ['walled in', 'run over', 'behind a wing', 'out of reach'])
def test_mutants_of_refutations_are_refused_or_do_not_hold(kind):
    known = refuted(kind).document()
    assert judged(json.dumps(known)) == 'holds'
    for name in ('presses', 'pull'):
        made, _ = changed(known)
        for leaf in every_leaf(made):
            leaf.pop(name, None)
        if made != known:
            assert judged(json.dumps(made)) != 'holds', name
    made, _ = changed(known)
    for leaf in every_leaf(made):
        leaf['meets'] = [1.0] * len(known['state']['position'])
    assert judged(json.dumps(made)) != 'holds'
    made, refuting = changed(known, 'refuted')
    refuting['trees'] = 2 * refuting['trees']
    assert judged(json.dumps(made)) != 'holds'
    part = known['refuted']['trees'][0]
    if 'parts' in part:
        made, refuting = changed(known, 'refuted')
        refuting['trees'][0]['parts'].pop()
        assert judged(json.dumps(made)) != 'holds'


JUNK = (None, True, -1, 1e400, 'x', [], [None], {}, {'x': 1}, [[1.0]], 10**400)


def places_of(value, path=()):
    """Yield the paths to everything in a document."""
    yield path
    keys = value if isinstance(value, dict) else range(len(value) if isinstance(value, list) else 0)
    for name in keys:
        each = value[name]
        yield from places_of(each, (*path, name))


@pytest.mark.parametrize('seed', range(3))
def test_junk_anywhere_is_refused_in_words(seed):
    rng = np.random.default_rng([seed, 8])
    known = of_catches()
    known['limits'] = {
        'cones': [{'axis': [1.0, 0.0], 'angle': 1.5, 'least': 0.0, 'steps': [1, 2]}],
        'walls': [{'centre': [9.0, 9.0], 'radius': 0.1, 'of': 'end', 'grown': [0.0] * 6,
                   'shifts': [[0.0, 0.0]] * 7}],
        'speeds': {'entry': 0.0, 'change': 1.0},
    }  # fmt: skip
    assert judged(json.dumps(known)) == 'holds'
    paths = [each for each in places_of(known) if each]
    for _ in range(150):
        path = paths[int(rng.integers(len(paths)))]
        made, place = changed(known, *path[:-1])
        place[path[-1]] = JUNK[int(rng.integers(len(JUNK)))]
        with suppress(Refused):  # and nothing else
            verified(made)


def test_speeds_that_are_none_are_refused():
    state = State.at(np.zeros(2), np.eye(2))
    made = {**statement(Problem(horizon=2), state, np.zeros((2, 2)))}
    for speeds in (
        [0.1, 0.2],
        {'entry': 0.1},
        {'entry': -0.1, 'change': 0.1},
        {'entry': 0.1, 'change': -0.1},
        {'entry': 0.1, 'change': 0.1, 'most': 1.0},
    ):
        with pytest.raises(Refused, match=r'speeds|entry|change'):
            posed_by({**made, 'limits': {'speeds': speeds}})
