# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bounds of searches over choices counted again: as good as said, and never too high."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from counting import between_walls, changed, counted, mutants, said, solved

from orbimpc_ros.mpc.geometry.separation import separation
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.model.motion import control_maps, controls
from orbimpc_ros.mpc.problem import Ball, Box, Floor, MovingObstacle, Problem, State, Weights
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.proof.choices import QUARTERS, _out_of_reach, choices_bound, set_row
from orbimpc_ros.mpc.proof.grounds import LEAF, ChoiceGrounds, Grounds
from orbimpc_ros.mpc.proof.kept import kept
from orbimpc_ros.mpc.proof.recount import Recount
from orbimpc_ros.mpc.proof.sides import ARCS, SIDES, Faces, Sides
from orbimpc_ros.mpc.proof.slopes import terms_of
from orbimpc_ros.mpc.proof.verifier import parsed, verified
from orbimpc_ros.mpc.solve.solver import OUTWARD, Solver

pytestmark = pytest.mark.skipif(not COMPILED, reason='the search that leaves trees needs numba')
BESIDE = (
    'boxes',
    'boxes, shared faces',
    'boxes, inertia',
    'boxes that move',
    'discs',
    'discs that move',
)
TURNING = ('turn rate', 'turn rate, exact', 'turn rate, inertia', 'turn rate, boxes')
SPATIAL = ('axes, boxes', 'space, boxes')
FACELESS = Faces(np.zeros((0, 2)), np.zeros((0, 3, 3)))
FLOORS = {
    'circle': Floor('circle', fraction=0.6),
    'polygon': Floor('polygon', faces=5, fraction=0.6),
}


@pytest.mark.parametrize(
    ('kind', 'seed'), [*itertools.product((*BESIDE, *TURNING, *SPATIAL), range(2))]
)
def test_what_a_search_proves_is_proved_by_its_tree(kind, seed):
    case, plan = solved(kind, seed)
    assert plan.proof.checked
    again = counted(case, plan)
    assert (1.0 - 1e-9) * said(case) <= again <= plan.objective * (1.0 + 1e-7)


@pytest.mark.parametrize(
    ('n', 'aside', 'weights'),
    [
        (2, Box((3.0, 2.0), (4.0, 3.0)), Weights()),
        (2, Ball((3.0, 3.0), 1.0), Weights()),
        (3, Box((3.0, 2.0, 0.0), (4.0, 3.0, 1.0)), Weights(1.0, 0.0, 0.0, 10.0)),
    ],
)
def test_where_nothing_had_to_be_chosen_a_tangent_is_left(n, aside, weights):
    """It is counted faster than a tree, and is a certificate as it stands."""
    problem = Problem(dimension=n, weights=weights, obstacles=(aside,))
    case = Case(problem, State.at(np.zeros(n), np.eye(n)), np.tile(np.eye(n)[0] * 8.0, (5, 1)))
    plan = Solver(problem).solve(*case[1:])
    assert isinstance(plan.proof.grounds, Grounds)
    assert plan.proof.checked
    assert verified(parsed(kept(*case, plan.proof).text().encode())).holds


@pytest.mark.parametrize('share', [0.5, 1.0, 2.0])
def test_a_tree_is_counted_as_far_as_is_enough(share):
    """Over SO(3), where a leaf's bound is first one by columns, which is lower."""
    case, plan = solved('space, boxes', 1)
    grounds, unit, recount = plan.proof.grounds, plan.proof.cost_unit, Recount(case.problem)
    whole = recount.bound(case.state, case.goals, grounds, unit)
    again = recount.bound(case.state, case.goals, grounds, unit, share * whole)
    assert min(1.0, share) * whole * (1.0 - 1e-12) <= again <= whole * (1.0 + 1e-12)
    assert (again < whole * (1.0 - 1e-6)) == (share < 1.0)


@pytest.mark.parametrize('weight', [0.0, 0.05])
def test_a_round_floor_beside_a_box_in_space_is_counted(weight):
    problem = Problem(
        dimension=3,
        floor=Floor('circle', fraction=0.6),
        weights=Weights(1.0, weight, 0.0, 10.0),
        obstacles=(Box((1.0, -1.0, -1.0), (2.0, 1.0, 1.0)),),
        discretisation='exact',
    )
    plan = Solver(problem).solve(State.at(np.zeros(3), np.eye(3)), np.tile([4.0, 0.2, 0.0], (5, 1)))
    assert plan.status == 'optimal'


def test_a_search_among_boxes_in_space_tells_of_its_nodes():
    """Solved, raised by a step along a row, and refuted ones; sides out of reach are left out."""
    case, plan = between_walls()
    grounds = plan.proof.grounds
    assert plan.proof.checked
    assert grounds.empty.sum() > 5
    assert (grounds.counts[grounds.splits != LEAF] < 6).any()
    again = counted(case, plan)
    assert (1.0 - 1e-9) * said(case) <= again <= plan.objective * (1.0 + 1e-7)
    for i, changes in enumerate(spoilt(grounds)):
        if 'levels' not in changes:
            assert counted(case, plan, **changes) == -np.inf, (i, list(changes))


@pytest.mark.parametrize('seed', range(3))
def test_boxes_that_move_in_space_are_choices_over_rotations(seed):
    case, _ = solved('space, boxes', seed)
    problem, rng = case.problem, np.random.default_rng(seed)
    ways = 0.05 * problem.length_unit / problem.step * rng.normal(size=(2, 3))
    hazards = tuple(
        itertools.starmap(MovingObstacle.drifting, zip(problem.obstacles, ways, strict=True))
    )
    case = Case(replace(problem, obstacles=()), replace(case.state, hazards=hazards), case.goals)
    plan = Solver(case.problem).solve(case.state, case.goals)
    assert plan.proof.checked
    assert plan.proof.grounds.points.shape[1:] == (problem.horizon, 9)
    again = counted(case, plan)
    assert (1.0 - 1e-9) * said(case) <= again <= plan.objective * (1.0 + 1e-7)
    points = changed(plan.proof.grounds.points, (0, 0, 4), np.nan)
    assert counted(case, plan, points=points) == -np.inf
    for size in (0.5, 2.0):
        presses = size * plan.proof.grounds.presses
        assert counted(case, plan, presses=presses) <= again * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ('floor', 'rate', 'seed'), [*itertools.product(FLOORS, (0.0, 1.0), (1, 2))]
)
def test_floors_beside_boxes_are_choices_too(floor, rate, seed):
    step = solved('boxes', seed)[0].problem.step
    case, plan = solved('boxes', seed, floor=FLOORS[floor], max_rate=rate / step)
    assert plan.proof.checked
    again = counted(case, plan)
    assert (1.0 - 1e-9) * said(case) <= again <= plan.objective * (1.0 + 1e-7)


def test_trees_of_all_kinds_are_counted_by_the_same_machine_code():
    for kind in ('boxes', 'turn rate, boxes', 'space, boxes'):
        case, plan = solved(kind, 0)
        counted(case, plan)
    cube = replace(case.problem, obstacles=(), floor=Floor('polygon', faces=6, fraction=0.4))
    plan = Solver(cube).solve(case.state, case.goals)
    assert plan.proof.checked
    assert counted(case._replace(problem=cube), plan) <= plan.objective * (1.0 + 1e-7)
    assert len(choices_bound.signatures) == 1  # else a tick would wait for it


@pytest.fixture(scope='module')
def branched():
    """Return a problem whose tree has splits by boxes and by directions from discs."""
    case, plan = solved('discs that move', 2)
    assert len(plan.proof.grounds.splits) > 40
    assert plan.proof.grounds.levels.max() > 2
    return case, plan


def test_no_grounds_prove_more_than_there_is(branched):
    """Whatever the numbers are: multipliers, tangents, splits, who holds what."""
    case, plan = branched
    grounds, rng = plan.proof.grounds, np.random.default_rng(5)
    before = counted(case, plan)
    for changes in mutants(grounds, rng, 300):
        assert counted(case, plan, **changes) <= before * (1.0 + 1e-9)


def spoilt(grounds):
    """Yield trees that leave something out, or hold what does not hold."""
    split = int(np.flatnonzero(grounds.splits != LEAF)[-1])
    yield {'counts': changed(grounds.counts, split, grounds.counts[split] - 1)}
    yield {'counts': changed(grounds.counts, split, 10**6)}
    yield {'counts': changed(grounds.counts, split, -1)}
    yield {'parts': changed(grounds.parts, split, split)}
    yield {'parts': changed(grounds.parts, split, grounds.parts[0])}
    yield {'splits': changed(grounds.splits, 0, 10**6)}
    first = int(grounds.parts[split])
    yield {'sides': changed(grounds.sides, first, grounds.sides[first] + 1)}
    yield {'levels': changed(grounds.levels, first, 0)}
    yield {'presses': changed(grounds.presses, 0, -1.0)}
    yield {'presses': changed(grounds.presses, 0, np.nan)}
    yield {'rows': changed(grounds.rows, 0, 100)}
    yield {'rows': changed(grounds.rows, 0, -1)}
    yield {'holders': changed(grounds.holders, 0, 0)}  # nothing always holds here
    last = len(grounds.splits) - 1
    yield {'holders': changed(grounds.holders, 0, last)}
    yield {'holders': changed(grounds.holders, 0, last + 1)}
    yield {'holders': changed(grounds.holders, 0, -1)}
    full = int(np.flatnonzero(~grounds.empty)[0])
    yield {'points': changed(grounds.points, (full, 0, 0), np.nan)}
    yield {'points': grounds.points[:-1]}
    yield {'points': grounds.points[:, :-1]}
    yield {'tethers': grounds.tethers[:-1]}
    yield {'ends': grounds.ends[:-1]}
    yield {'ends': grounds.ends[::-1].copy()}
    yield {'ends': changed(grounds.ends, -1, grounds.ends[-1] + 5)}
    yield {'empty': np.ones_like(grounds.empty)}
    yield {'levels': grounds.levels[:-1]}
    yield {'presses': grounds.presses[:-1]}


def test_trees_that_leave_something_out_prove_nothing(branched):
    case, plan = branched
    for i, changes in enumerate(spoilt(plan.proof.grounds)):
        assert counted(case, plan, **changes) == -np.inf, (i, list(changes))


def tree_of(splits, parts, counts, sides, levels, horizon):
    """Return a tree in the plane whose leaves hold nothing: tangents at rest."""
    leaves = splits.count(LEAF)
    return ChoiceGrounds(
        np.array(splits),
        np.array(parts),
        np.array(counts),
        np.array(levels),
        np.array(sides),
        np.zeros((leaves, horizon, 2)),
        np.zeros(leaves, bool),
        np.zeros(leaves, np.int64),
        *np.zeros((2, 0), np.int64),
        np.zeros(0),
        np.zeros((leaves, 0, 2)),
    )


@pytest.mark.parametrize(
    ('splits', 'parts', 'counts', 'sides', 'levels', 'whole'),
    [
        ([0, *[LEAF] * 4], [1, *[0] * 4], [4, *[0] * 4], [0, 0, 1, 2, 3], [0] * 5, True),
        # A side of a box is no arc that could be halved.
        ([0, 0, *[LEAF] * 5], [1, 5, *[0] * 5], [4, 2, *[0] * 5], [0, 0, 1, 2, 3, 0, 1],
         [0, 0, 0, 0, 0, 1, 1], False),
        # No node is a part of two others.
        ([0, 1, 1, *[LEAF] * 6], [1, 5, 5, *[0] * 6], [4, 4, 4, *[0] * 6],
         [0, 0, 1, 2, 3, 0, 1, 2, 3], [0] * 9, False),
        # Nor is one of none.
        ([0, *[LEAF] * 5], [1, *[0] * 5], [4, *[0] * 5], [0, 0, 1, 2, 3, 0], [0] * 6, False),
    ],
)  # fmt: skip
def test_trees_part_what_there_is_once(splits, parts, counts, sides, levels, whole):
    case, plan = solved('boxes', 2)
    made = tree_of(splits, parts, counts, sides, levels, case.problem.horizon)
    assert (counted(case, plan, **made._asdict()) > -np.inf) == whole


def test_a_side_has_no_more_rows_than_its_choice_has_places():
    case, plan = solved('boxes', 2)
    rows = plan.proof.grounds.rows
    assert (rows == 0).all()
    assert counted(case, plan, rows=changed(rows, 0, 1)) == -np.inf


def test_problems_that_trees_say_nothing_of_have_nothing_proved():
    case, plan = solved('boxes', 2)
    other = replace(case.problem, rotation_order=2, max_rate=0.1)
    recount, grounds = Recount(other), plan.proof.grounds
    assert not recount.knows(grounds)
    assert recount.bound(case.state, case.goals, grounds, 1.0) == -np.inf


def test_tethers_of_turns_hold_what_a_turn_limit_does():
    case, plan = solved('turn rate', 0)
    grounds = plan.proof.grounds
    assert np.abs(grounds.tethers).max() > 1e-3
    before = counted(case, plan)
    assert counted(case, plan, tethers=0.0 * grounds.tethers) < (1.0 - 1e-3) * before
    assert counted(case, plan, tethers=2.0 * grounds.tethers) < before
    wider = replace(case.problem, max_rate=1.1 * case.problem.max_rate)
    again = Recount(wider).bound(case.state, case.goals, grounds, plan.proof.cost_unit)
    assert again < (1.0 - 1e-3) * before


def test_a_bound_beyond_its_tree_is_lowered_to_what_it_proves(monkeypatch):
    case, plan = solved('boxes', 2)
    solver = Solver(case.problem)
    method = solver._method
    told = method.solve

    def boasting(request):
        found = told(request)
        return replace(found, lower_bound=1.0001 * found.lower_bound)

    monkeypatch.setattr(method, 'solve', boasting)
    again = solver.solve(case.state, case.goals)
    assert again.proof.checked
    assert again.lower_bound == pytest.approx(plan.lower_bound, rel=1e-9 + OUTWARD)


# --- the choices themselves


@pytest.mark.parametrize(('kind', 'seed'), [*itertools.product(BESIDE, range(2))])
def test_places_are_where_headings_lead(kind, seed):
    case, plan = solved(kind, seed)
    problem, state = case.problem, case.state
    places = Sides(problem, terms_of(problem)).places(state)
    z = plan.rotations[1:, :, 0]
    led = problem.length_unit * (places.free + places.maps @ z)[problem.horizon :]
    within = controls(problem.translation.degree, problem.step, plan.positions, plan.velocities)
    expected = np.concatenate([plan.positions[1:], within.reshape(-1, 2)]) - state.position
    np.testing.assert_allclose(led, expected, atol=1e-9 * problem.length_unit)
    assert len(led) == problem.horizon + control_maps(problem)[:, :, 0].size


def rows_of(known, j, at, places, z, faces):
    """Return by how much headings clear the rows of a side."""
    normal, margins = np.zeros(2), []
    for i in range(known.counts[j]):
        offset = set_row(known, j, at, i, faces, normal)
        place = known.places[j] + i
        margins.append(normal @ (places.free[place] + places.maps[place] @ z) - offset)
    return np.array(margins)


@pytest.mark.parametrize(('kind', 'seed'), [*itertools.product(BESIDE, range(2))])
def test_whatever_keeps_clear_is_on_some_side_of_every_choice(kind, seed):
    case, plan = solved(kind, seed)
    sides, z = Sides(case.problem, terms_of(case.problem)), plan.rotations[1:, :, 0]
    places, normal = sides.places(case.state), np.zeros(2)
    known = sides.alternatives(case.state, case.goals, places)
    assert len(known.kinds) > 0
    for j, level in itertools.product(range(len(known.kinds)), (0, 1, 5)):
        count = 4 if known.kinds[j] == SIDES else QUARTERS << level
        each = [
            rows_of(known, j, (level, side), places, z, FACELESS).min() for side in range(count)
        ]
        assert max(each) > -2e-6
        out = [
            _out_of_reach(places, known, j, (level, side), FACELESS, normal)
            for side in range(count)
        ]
        assert not out[int(np.argmax(each))]


def test_a_direction_that_is_within_no_arc_of_a_disc_is_inside():
    """Of all arcs together, what is beyond none of their chords is within the disc."""
    problem = Problem(horizon=1, obstacles=(Ball((0.0, 2.0), 0.7),))
    sides, state = Sides(problem, terms_of(problem)), State.at(np.zeros(2), np.eye(2))
    places = sides.places(state)
    known = sides.alternatives(state, np.zeros((problem.horizon, 2)), places)
    (whole, end), rng = range(2), np.random.default_rng(3)
    assert (known.kinds == ARCS).all()
    for angle in rng.uniform(0.0, 2.0 * np.pi, 40):
        for away in (0.99, 1.01):
            at = np.array([0.0, 2.0]) + 0.7 * away * np.array([np.cos(angle), np.sin(angle)])
            free = places.free.copy()
            free[1:] = at / problem.length_unit
            moved = places._replace(free=free, maps=0.0 * places.maps)
            for j in (whole, end):
                still = known._replace(spreads=0.0 * known.spreads)
                margins = [
                    rows_of(still, j, (6, side), moved, np.zeros((1, 2)), FACELESS).min()
                    for side in range(QUARTERS << 6)
                ]
                assert (max(margins) >= 0.0) == (away > 1.0)


def test_a_step_beyond_a_disc_is_beyond_a_row_that_allows_for_its_length():
    """The rows of a whole step: a side that holds the direction of its nearest point."""
    hazard = MovingObstacle.drifting(Ball((0.5, 0.9), 0.4), np.array([0.1, -0.2]))
    problem = Problem(horizon=3, discretisation='exact', translation_order=2)
    state = State.at(np.zeros(2), np.eye(2), velocity=np.array([0.3, 0.2]), hazards=(hazard,))
    sides, rng = Sides(problem, terms_of(problem)), np.random.default_rng(8)
    places = sides.places(state)
    known = sides.alternatives(state, np.zeros((problem.horizon, 2)), places)
    clear = 0
    for _ in range(200):
        z = rng.normal(size=(3, 2))
        z /= np.maximum(1.0, np.linalg.norm(z, axis=1))[:, None]
        for j in range(0, len(known.kinds), 2):
            at = known.places[j] + np.arange(known.counts[j])
            points = places.free[at] + places.maps[at] @ z - known.centres[j]
            _, apart = separation(points[None])
            if apart[0] < known.sizes[j]:
                continue
            clear += 1
            for level in (0, 3):
                every = range(QUARTERS << level)
                margins = [
                    rows_of(known, j, (level, side), places, z, FACELESS).min() for side in every
                ]
                assert max(margins) >= -1e-12
    assert clear > 50


def test_nothing_that_is_empty_is_taken_for_so_without_a_proof(branched):
    case, plan = branched
    grounds = plan.proof.grounds
    full = int(np.flatnonzero(~grounds.empty)[0])
    empty = changed(grounds.empty, full, True)
    assert counted(case, plan, empty=empty) == -np.inf


@pytest.mark.parametrize('turn', [0.3, 0.9, 1.4, 2.5])
@pytest.mark.parametrize('least', [0.3, 1.0])
def test_what_always_holds_holds_of_all_that_turn_within_the_limit(turn, least):
    """Of slow and of fast headings, and of those that turn as fast as they may."""
    floor = Floor('circle', fraction=least)
    problem = Problem(horizon=6, step=0.5, floor=floor, max_rate=2.0 * turn)
    sides, rng = Sides(problem, terms_of(problem)), np.random.default_rng(6)
    tightest = np.inf
    for _ in range(300):
        begin = rng.uniform(-np.pi, np.pi)
        turns = turn * np.sign(rng.normal()) * np.clip(rng.normal(1.0, 0.5, 6), -1.0, 1.0)
        angles, speeds = begin + np.cumsum(turns), rng.choice([least, 1.0], 6)
        z = speeds[:, None] * np.transpose([np.cos(angles), np.sin(angles)])
        c, s = np.cos(begin), np.sin(begin)
        state = State.at(np.zeros(2), np.array([[c, -s], [s, c]]))
        always, places = sides.always(state, np.zeros((6, 2))), sides.places(state)
        led = places.free + places.maps @ z
        slack = np.einsum('ij,ij->i', always.normals, led[always.places]) - always.offsets
        assert slack.min(initial=1.0) >= -1e-12
        chords = np.linalg.norm(np.diff(z, axis=0), axis=1)
        assert chords.max() <= always.chord + 1e-12
        tightest = min(tightest, slack.min(initial=1.0))
    assert tightest < 1e-9 or turn > 0.5 * np.pi
