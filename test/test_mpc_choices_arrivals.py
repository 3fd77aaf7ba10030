# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bounds of searches over choices with arrivals and weights on length, counted again."""

import itertools
from dataclasses import replace

import certified
import numpy as np
import pytest
from counting import changed, counted, mutants, said, solved

from benchmarks.bench.problems import COMPARISONS
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Approach, Box, Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.proof.choices import choices_bound
from orbimpc_ros.mpc.proof.grounds import LEAF, ChoiceGrounds, Grounds, Tangent, tangent
from orbimpc_ros.mpc.proof.recount import Recount
from orbimpc_ros.mpc.proof.sides import Sides, Symmetry
from orbimpc_ros.mpc.proof.slopes import terms_of
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Solver

pytestmark = pytest.mark.skipif(not COMPILED, reason='the search that leaves trees needs numba')
ARRIVES = {'terminal': 'constraint'}
LONG = {'weights': Weights(1.0, 0.05, 0.3, 10.0)}
SHORT = {**ARRIVES, 'weights': Weights(0.0, 0.0, 1.0, 0.0)}  # the shortest way
PENTAGON, CIRCLE = Floor('polygon', faces=5, fraction=0.6), Floor('circle', fraction=0.6)
CUBE = {'floor': Floor('polygon', faces=6, fraction=0.4)}
KINDS = {
    'hull, length alone': ('hull', SHORT),  # of which a plan does not tell the multipliers
    'boxes': ('boxes', ARRIVES),
    'boxes, length': ('boxes', LONG),
    'boxes, inertia': ('boxes, inertia', ARRIVES | LONG),
    'boxes, shared faces': ('boxes, shared faces', ARRIVES | LONG),
    'boxes that move': ('boxes that move', ARRIVES | LONG),
    'boxes, faces': ('boxes', ARRIVES | LONG | {'floor': PENTAGON}),
    'discs': ('discs', ARRIVES | LONG),
    'faces': ('polygon', ARRIVES),
    'faces, length': ('polygon', ARRIVES | LONG),
    'faces, inertia': ('polygon', ARRIVES | {'translation_order': 2}),
    'faces, length alone': ('polygon', SHORT),
    'circle, inertia': ('circle', ARRIVES | {'translation_order': 2}),
    'axes, boxes': ('axes, boxes', ARRIVES | {'weights': Weights(1.0, 0.0, 0.3, 10.0)}),
    'space, boxes': ('space, boxes', ARRIVES),
    'space, faces': ('space', ARRIVES | CUBE),
}


def posed(kind, seed):
    base, changes = KINDS[kind]
    return solved(base, seed, **changes)


@pytest.mark.parametrize(('kind', 'seed'), [*itertools.product(KINDS, range(2))])
def test_what_a_search_proves_is_proved_by_its_tree(kind, seed):
    case, plan = posed(kind, seed)
    assert isinstance(plan.proof.grounds, ChoiceGrounds | Grounds)  # where nothing was chosen
    assert plan.proof.checked
    again = counted(case, plan)
    assert (1.0 - 1e-9) * said(case) <= again <= plan.objective * (1.0 + 1e-7)


@pytest.mark.parametrize('key', ['dubins', 'dubins-length'])
def test_the_ways_of_a_dubins_vehicle_are_counted(key):
    comparison = next(each for each in COMPARISONS if each.key == key)
    (instance,) = comparison.instances(comparison.problem, 1)
    case = Case(comparison.problem, instance.state, instance.goals)
    plan = Solver(case.problem, gap_tolerance=comparison.gap).solve(*case[1:])
    assert plan.proof.checked
    assert counted(case, plan) >= (1.0 - 1e-9) * plan.lower_bound
    assert plan.gap < comparison.gap


def test_trees_with_arrivals_are_counted_by_the_same_machine_code():
    for kind in ('boxes, length', 'boxes, inertia', 'faces, length alone', 'space, boxes'):
        case, plan = posed(kind, 0)
        counted(case, plan)
    assert len(choices_bound.signatures) == 1  # else a tick would wait for it


@pytest.mark.parametrize(
    'kind', ['boxes', 'boxes, inertia', 'faces, length', 'faces, length alone', 'space, faces']
)
def test_no_grounds_prove_more_than_a_trajectory_costs(kind):
    """Whatever the numbers are, and wherever else the vehicle has to arrive."""
    case, plan = posed(kind, 3)
    grounds, rng = plan.proof.grounds, np.random.default_rng(7)
    for changes in mutants(grounds, rng, 200):
        again = counted(case, plan, **changes)
        assert again <= plan.objective * (1.0 + 1e-7)
    unit = 0.01 * case.problem.length_unit
    for _ in range(5):
        other = case._replace(goals=case.goals + unit * rng.normal(size=case.goals.shape[1]))
        cost = Solver(case.problem).solve(*other[1:]).objective
        assert counted(other, plan) <= cost * (1.0 + 1e-7)


def test_multipliers_of_an_arrival_hold_what_it_does():
    case, plan = posed('faces, length', 0)
    grounds, before = plan.proof.grounds, counted(*posed('faces, length', 0))
    held = np.flatnonzero(grounds.holders == 0)
    assert len(held) > 1
    assert counted(case, plan, presses=changed(grounds.presses, held, 0.0)) < 0.99 * before
    assert counted(case, plan, presses=changed(grounds.presses, held, -1.0)) == -np.inf
    last = 2 * case.problem.dimension
    for rows in (changed(grounds.rows, held, last), changed(grounds.rows, held[0], -1)):
        assert counted(case, plan, rows=rows) == -np.inf
    free = replace(case.problem, terminal='penalty')  # where it does not have to arrive
    assert Recount(free).bound(*case[1:], grounds, plan.proof.cost_unit) == -np.inf


@pytest.mark.parametrize(
    ('kind', 'seed'), [*itertools.product(('boxes', 'boxes, inertia'), range(2))]
)
def test_plans_arrive_in_all_half_spaces_of_an_arrival(kind, seed):
    case, plan = posed(kind, seed)
    sides = Sides(case.problem, terms_of(case.problem))
    places = sides.places(case.state)
    always = sides.always(case.state, case.goals)
    led = places.free + places.maps @ plan.rotations[1:, :, 0]
    assert len(always.places) == 4 * (1 + case.problem.inertial)
    past = np.einsum('ij,ij->i', led[always.places], always.normals) - always.offsets
    np.testing.assert_allclose(past, 0.0, atol=1e-6)
    if case.problem.inertial:
        unit = case.problem.length_unit / case.problem.step
        np.testing.assert_allclose(unit * led[-1], plan.velocities[-1], atol=1e-9 * unit)


# --- steps that cannot be told apart


def symmetry(problem, **state):
    here = State.at(np.zeros(2), np.eye(2), **state)
    sides = Sides(problem, terms_of(problem))
    away = np.zeros((problem.horizon, 2))
    known = sides.alternatives(here, away, sides.places(here))
    return sides.symmetry(known, sides.always(here, away))


SHORTEST = Problem(horizon=6, floor=PENTAGON, **SHORT)


def test_steps_cannot_be_told_apart_where_nothing_does():
    assert symmetry(SHORTEST) == Symmetry(5, 5)
    assert symmetry(replace(SHORTEST, discretisation='exact')).unseen == -1


@pytest.mark.parametrize(
    'changes',
    [
        {'weights': Weights(0.1, 0.0, 1.0, 0.0)},
        {'weights': Weights(0.0, 0.1, 1.0, 0.0)},
        {'weights': Weights(0.0, 0.0, 1.0, 0.0, attitude=0.1)},
        {'obstacles': (Box((1.0, 1.0), (2.0, 2.0)),)},
        {'max_rate': 0.5},
        {'translation_order': 2},
        {'rotation_order': 2},
        {'approach': Approach(0.3, (1.0, 0.0))},
        {'floor': CIRCLE},
        {'floor': Floor('none')},
    ],
)
def test_steps_that_anything_tells_apart_have_no_order(changes):
    assert symmetry(replace(SHORTEST, **changes)).ordered == 0


def test_what_is_out_of_order_costs_as_much_as_what_is_in_order():
    """A tree in order leaves parts out, and proves nothing where steps can be told apart."""
    case, plan = posed('faces, length alone', 1)
    grounds = plan.proof.grounds
    split = np.flatnonzero(grounds.splits != LEAF)
    assert (grounds.counts[split] < 5).any()
    again = counted(case, plan)
    assert again > 0.0
    for weights in (Weights(0.0, 0.01, 1.0, 0.0), Weights(0.01, 0.0, 1.0, 0.0)):
        other = Recount(replace(case.problem, weights=weights))
        assert other.bound(*case[1:], grounds, plan.proof.cost_unit) == -np.inf


def tree_of(splits, parts, counts, sides, horizon):
    """Return a tree of faces whose leaves hold nothing: tangents at rest."""
    leaves = splits.count(LEAF)
    nodes = [np.array(each) for each in (splits, parts, counts, np.zeros_like(sides), sides)]
    nothing = np.zeros(leaves, bool), np.zeros(leaves, np.int64), *np.zeros((2, 0), np.int64)
    points, tethers = np.zeros((leaves, horizon, 2)), np.zeros((leaves, 0, 2))
    return ChoiceGrounds(*nodes, points, *nothing, np.zeros(0), tethers)


@pytest.mark.parametrize(
    ('steps', 'sides', 'whole'),
    [
        ((0, 1), range(3, 5), True),  # the first one has face 3 here
        ((0, 1), range(4, 5), False),
        ((0, 1), range(3, 4), False),
        ((1, 0), range(3, 5), False),  # what an earlier step has is no less
        ((0, 5), range(1), True),  # what nothing sees has any face
        ((0, 5), range(1, 5), False),
        ((0, 5), range(5), True),
    ],
)
def test_parts_that_are_left_out_are_out_of_order(steps, sides, whole):
    """Of a first step's faces 0..4, the part of face 3 is split again."""
    count = len(sides)
    splits = [steps[0], LEAF, LEAF, LEAF, steps[1], LEAF, *[LEAF] * count]
    parts, counts = [1, 0, 0, 0, 6, 0, *[0] * count], [5, 0, 0, 0, count, 0, *[0] * count]
    tree = tree_of(splits, parts, counts, [0, *range(5), *sides], SHORTEST.horizon)
    state, goals = State.at(np.zeros(2), np.eye(2)), np.tile([2.0, 1.0], (6, 1))
    recount = Recount(SHORTEST)
    assert (recount.bound(state, goals, tree, 1.0) > -np.inf) == whole
    told_apart = Recount(replace(SHORTEST, weights=Weights(0.0, 0.1, 1.0, 0.0)))
    assert (told_apart.bound(state, goals, tree, 1.0) > -np.inf) == (count == 5)


def test_a_trajectory_in_order_costs_as_much():
    """The law behind it: sorted headings arrive at the same place, at the same cost."""
    problem, rng = SHORTEST, np.random.default_rng(4)
    solver = Solver(problem)
    state, goals = State.at(np.zeros(2), np.eye(2)), np.tile([2.0, 1.0], (6, 1))
    plan = solver.solve(state, goals)
    z = plan.rotations[1:, :, 0]
    for _ in range(5):
        mixed = np.concatenate([z[:5][rng.permutation(5)], z[rng.integers(6, size=1)]])
        flown = trajectory_of(problem, state, goals, mixed)
        np.testing.assert_allclose(flown.positions[-1], plan.positions[-1], atol=1e-12)
        assert flown.cost == pytest.approx(plan.objective, rel=1e-9)


def test_faces_of_space_are_choices_over_thrust_axes():
    """Splits by faces of the plane say nothing of them."""
    weights = {'weights': Weights(1.0, 0.0, 0.0, 10.0)}
    case = certified.case('axes, boxes', np.random.default_rng(2), longest=5)
    case = case._replace(problem=replace(case.problem, obstacles=(), **CUBE, **weights))
    plan = Solver(case.problem).solve(*case[1:])
    assert plan.proof.checked
    assert counted(case, plan) <= plan.objective * (1.0 + 1e-7)
    whole = tangent(plan.rotations[1:, :, 0], np.zeros(case.problem.horizon))
    recount, split = Recount(case.problem), [0, *[LEAF] * 6]
    assert recount.bound(*case[1:], whole, 1.0) > -np.inf
    points, bends = np.repeat(whole.points, 7, axis=0), np.repeat(whole.bends, 7, axis=0)
    parts = np.array([1, *[0] * 6]), np.full(7, np.nan)
    parted = Grounds(np.array(split), *parts, points, bends, whole.origins)
    assert recount.bound(*case[1:], parted, 1.0) == -np.inf


# --- round floors over SO(3), of whose patches nothing is told


@pytest.mark.parametrize('number', [0, 5, 7, 12])
def test_a_search_whose_root_is_as_good_leaves_its_tangent(number):
    comparison = next(each for each in COMPARISONS if each.key == 'lander')
    instance = comparison.instances(comparison.problem, 13)[number]
    case = Case(comparison.problem, instance.state, instance.goals)
    plan = Solver(case.problem, gap_tolerance=comparison.gap).solve(*case[1:])
    assert plan.proof.nodes > 1
    assert isinstance(plan.proof.grounds, Tangent)
    assert plan.proof.checked
    again = counted(case, plan)
    assert (1.0 - 2e-5) * said(case) <= again <= plan.objective * (1.0 + 1e-7)


def test_a_search_whose_root_is_not_as_good_leaves_its_tree():
    fast = Floor('circle', fraction=0.6)
    problem = Problem(dimension=3, horizon=2, floor=fast, weights=Weights(1.0, 0.5, 0.0, 2.0))
    case = Case(problem, State.at(np.zeros(3), np.eye(3)), np.tile([0.6, 0.1, 0.0], (2, 1)))
    solver = Solver(problem, gap_tolerance=5e-2)
    plan, units = solver.solve(*case[1:]), solver._units
    request = Request(units.state(case.state), units.lengths(case.goals))
    root = solver._method.program.relax(request)
    assert root.grounds is not None
    assert units.cost * root.bound < 0.7 * plan.lower_bound
    assert len(plan.proof.grounds.splits) > 1
    assert plan.status == 'optimal'
