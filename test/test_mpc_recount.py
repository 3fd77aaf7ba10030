# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bounds counted again at every tick: as exact proofs have them, and never too high."""

import itertools
from dataclasses import replace

import certified
import numpy as np
import problems
import pytest
from counting import changed

from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Floor, Problem, State, Weights
from orbimpc_ros.mpc.proof.grounds import Tangent, tangent
from orbimpc_ros.mpc.proof.kept import kept
from orbimpc_ros.mpc.proof.recount import Recount
from orbimpc_ros.mpc.proof.tangents import tangents_bound, top_of
from orbimpc_ros.mpc.proof.verifier import parsed, verified
from orbimpc_ros.mpc.solve.request import Found
from orbimpc_ros.mpc.solve.solver import OUTWARD, Solver

needs_machine_code = pytest.mark.skipif(
    not COMPILED, reason='the methods that leave grounds need numba'
)
COUNTED = ('hull', 'polygon', 'circle', 'circle, constant speed', 'circle, length', 'shell')
TURNING = ('circle, turn rate', 'polygon, turn rate')
FLAT = (
    *('hull, length', 'hull, arrival', 'hull, inertia, arrival', 'hull, coasting'),
    *('circle, arrival', 'circle, length, arrival', 'shell, arrival'),
)
SPATIAL = ('space', 'space, coasting', 'space, arrival', 'space, coasting, length')


def solved(kind, seed):
    case = certified.case(kind, np.random.default_rng([seed, *kind.encode()]), longest=5)
    coasting = case.state.coasted is not None
    return case, Solver(case.problem, coasting=coasting).solve(case.state, case.goals)


@needs_machine_code
@pytest.mark.parametrize(
    ('kind', 'seed'),
    [*itertools.product(COUNTED, range(4)), *itertools.product(TURNING, (0, 1, 3))],
)
def test_what_is_counted_again_holds_in_exact_arithmetic(kind, seed):
    case, plan = solved(kind, seed)
    assert plan.proof.checked
    again = Recount(case.problem).bound(
        case.state, case.goals, plan.proof.grounds, plan.proof.cost_unit
    )
    assert plan.lower_bound <= again <= plan.objective * (1.0 + 1e-9)
    verdict = verified(parsed(kept(*case, plan.proof).text().encode()))
    assert verdict.holds
    # Floats keep a distance from what they may have rounded away.
    assert again <= verdict.proved <= again + 1e-9 * max(1.0, again)


@pytest.mark.parametrize(
    ('kind', 'seed'),
    [
        *itertools.product(FLAT, (3, 5)),
        *(
            pytest.param(*each, marks=needs_machine_code)
            for each in itertools.product(SPATIAL, (0, 1))
        ),
    ],
)
def test_what_is_counted_again_of_a_tangent_holds_in_exact_arithmetic(kind, seed):
    case, plan = solved(kind, seed)
    assert plan.proof.checked
    assert isinstance(plan.proof.grounds, Tangent)
    assert plan.gap < 1e-6
    again = Recount(case.problem).bound(case.state, case.goals, plan.proof.grounds, 1.0)
    verdict = verified(parsed(kept(*case, plan.proof).text().encode()))
    assert verdict.holds
    # Plans may miss constraints by so much.
    assert plan.lower_bound <= again <= plan.objective * (1.0 + 1e-7)
    assert verdict.proved == pytest.approx(again, rel=1e-9)
    if hasattr(tangents_bound, 'signatures'):  # compiled: for all at once, not in a tick
        assert len(tangents_bound.signatures) == 1


@pytest.mark.parametrize(
    'kind', [*FLAT, *(pytest.param(each, marks=needs_machine_code) for each in SPATIAL)]
)
def test_no_tangent_proves_more_than_there_is(kind):
    rng, (case, plan) = np.random.default_rng(5), solved(kind, 3)
    recount, leaf = Recount(case.problem), plan.proof.grounds
    for _ in range(60):
        size = 10.0 ** rng.uniform(-6.0, 1.0)
        moved = leaf._replace(
            point=leaf.point + size * rng.normal(size=leaf.point.shape),
            bends=leaf.bends + rng.choice([0.0, size]) * rng.normal(size=leaf.bends.shape),
            pull=(1.0 + size * rng.normal()) * leaf.pull,
            stiffness=float(rng.choice([0.0, -size, size])),
            tops=(1.0 + size * rng.normal()) * leaf.tops,
            ways=leaf.ways + rng.choice([0.0, size]) * rng.normal(size=leaf.ways.shape),
        )
        assert recount.bound(case.state, case.goals, moved, 1.0) <= plan.objective * (1.0 + 1e-7)
    lower = leaf._replace(tops=leaf.tops - 0.1 * plan.objective)  # of what it has to pay for
    assert recount.bound(case.state, case.goals, lower, 1.0) <= plan.objective * (1.0 + 1e-7)


@pytest.mark.parametrize(
    'spoilt',
    [
        lambda t: t._replace(pull=t.pull[:1]),
        lambda t: t._replace(stiffness=-1.0),
        lambda t: t._replace(point=t.point[:, :1]),
        lambda t: t._replace(point=changed(t.point, 0, np.nan)),
        lambda t: t._replace(tops=t.tops[1:]),
        lambda t: t._replace(ways=t.ways[1:]),
    ],
    ids=['a short pull', 'less than no stiffness', 'a coordinate', 'nan', 'few tops', 'few ways'],
)
def test_a_tangent_that_fits_no_problem_proves_nothing(spoilt):
    case, plan = solved('hull, arrival', 3)
    leaf = spoilt(plan.proof.grounds)
    assert Recount(case.problem).bound(case.state, case.goals, leaf, 1.0) == -np.inf


@needs_machine_code
def test_lengths_over_rotations_are_counted_along_ways_no_longer_than_1():
    case, plan = solved('space, coasting, length', 0)
    known = parsed(kept(*case, plan.proof).text().encode())
    shares = np.array(known['tree']['shares'])
    for factor in (0.0, 1.1):
        known['tree']['shares'] = (factor * shares).tolist()
        assert not verified(known).holds


@pytest.mark.parametrize('stiffness', [0.0, 1.0])
def test_nothing_pulls_where_nothing_has_to_arrive(stiffness):
    case, plan = solved('hull, arrival', 3)
    free = replace(case.problem, terminal='penalty')
    leaf = plan.proof.grounds._replace(stiffness=stiffness)
    assert Recount(free).bound(case.state, case.goals, leaf, 1.0) == -np.inf
    if stiffness:
        leaf = leaf._replace(pull=leaf.pull[:0], bends=leaf.bends - 0.1)
        assert Recount(free).bound(case.state, case.goals, leaf, 1.0) == -np.inf


def test_an_arrival_makes_costs_convex_that_bend_the_other_way():
    problem = Problem(horizon=2, terminal='constraint')  # which decides R_1, and R_2 moves nothing
    unit, state = problem.length_unit, State.at(np.zeros(2), np.eye(2))
    goals = np.tile([1.5 * unit, 0.3 * unit], (2, 1))
    plan = Solver(problem).solve(state, goals)
    recount, leaf, cost = Recount(problem), plan.proof.grounds, plan.proof.cost_unit
    bent = leaf._replace(bends=np.array([-3.0 * cost, 0.0]))
    stiff = bent._replace(stiffness=5.0 * cost / unit**2)
    assert recount.bound(state, goals, bent, 1.0) < 0.9 * plan.objective
    again = recount.bound(state, goals, stiff, 1.0)
    assert again == pytest.approx(plan.objective, rel=1e-6)
    assert again <= plan.objective * (1.0 + 1e-7)


@needs_machine_code
@pytest.mark.parametrize('kind', ['hull', 'polygon', 'circle', *TURNING])
def test_no_grounds_prove_more_than_there_is(kind):
    rng, (case, plan) = np.random.default_rng(5), solved(kind, 1)
    recount, grounds = Recount(case.problem), plan.proof.grounds
    for _ in range(100):
        size = 10.0 ** rng.uniform(-6.0, 1.0)
        points = grounds.points + size * rng.normal(size=grounds.points.shape)
        bends = grounds.bends + size * rng.normal(size=grounds.bends.shape)
        moved = grounds._replace(points=points, bends=bends)
        again = recount.bound(case.state, case.goals, moved, plan.proof.cost_unit)
        assert again <= plan.objective * (1.0 + 1e-9)


def branched():
    """Return a problem whose proof has splits, with its plan."""
    problem = Problem(floor=Floor('polygon', 4, np.sqrt(0.3)))
    state, goals = State.at(np.zeros(2), np.eye(2)), np.full((5, 2), 0.1)
    plan = Solver(problem).solve(state, goals)
    assert len(plan.proof.grounds.splits) > 1
    return problem, state, goals, plan


@needs_machine_code
@pytest.mark.parametrize(
    'spoilt',
    [
        lambda g: g._replace(parts=changed(g.parts, 0, 0)),
        lambda g: g._replace(parts=changed(g.parts, 0, len(g.parts))),
        lambda g: g._replace(parts=np.where(g.splits >= 0, 1, g.parts)),
        lambda g: g._replace(splits=changed(g.splits, 0, 5)),
        lambda g: g._replace(angles=changed(g.angles, 0, 7.0)),
        lambda g: g._replace(points=changed(g.points, -1, np.nan)),
        lambda g: g._replace(bends=changed(g.bends, np.flatnonzero(g.splits < 0), 0.1)),
    ],
    ids=['a circle', 'beyond the end', 'parts twice', 'no step', 'an angle', 'nan', 'bent faces'],
)
def test_grounds_that_leave_something_out_prove_nothing(spoilt):
    problem, state, goals, plan = branched()
    grounds = spoilt(plan.proof.grounds)
    assert Recount(problem).bound(state, goals, grounds, plan.proof.cost_unit) == -np.inf


def passing():
    """Return a problem whose goal is abeam of a wing, split by directions, with its plan."""
    problem = Problem(horizon=4, floor=Floor('circle', fraction=0.6), max_rate=0.7)
    state, goals = State.at(np.zeros(2), np.eye(2)), np.tile([-0.3, 0.4], (4, 1))
    plan = Solver(problem).solve(state, goals)
    assert (plan.proof.grounds.splits >= 0).sum() > 2
    return problem, state, goals, plan


@needs_machine_code
def test_no_split_by_directions_proves_more_than_there_is():
    problem, state, goals, plan = passing()
    rng, recount, grounds = np.random.default_rng(8), Recount(problem), plan.proof.grounds
    inner, refused = np.flatnonzero(grounds.splits >= 0), 0
    for _ in range(300):
        at, size = int(rng.choice(inner)), 10.0 ** rng.uniform(-4.0, 0.5)
        moved = grounds._replace(
            angles=changed(grounds.angles, at, grounds.angles[at] + size * rng.normal()),
            splits=changed(grounds.splits, at, rng.choice([grounds.splits[at], 0, 3])),
            points=grounds.points + size * rng.normal(size=grounds.points.shape),
        )
        again = recount.bound(state, goals, moved, plan.proof.cost_unit)
        assert again <= plan.objective * (1.0 + 1e-9)
        refused += again == -np.inf
    assert 0 < refused < 300  # angles out of their sectors, and others


@needs_machine_code
@pytest.mark.parametrize(('seed', 'parts'), [(0, 5), (32, 20)])  # with a weight on length, without
def test_a_search_over_arcs_leaves_what_proves_its_bound(seed, parts):
    rng = np.random.default_rng(seed)
    problem = Problem(
        horizon=int(rng.integers(3, 6)),
        weights=problems.weights(rng),
        floor=problems.floor('circle', rng.uniform(0.3, 1.0)),
    )
    state = problems.state(rng, problem, full_speed=False)
    goals = problems.goals(rng, problem, distance=rng.uniform(0.1, 1.5))
    plan = Solver(problem).solve(state, goals)
    grounds, known = plan.proof.grounds, (problem, state, goals)
    assert plan.proof.checked
    assert (grounds.splits < 0).sum() > parts
    assert plan.gap <= plan.proof.gap_tolerance
    assert verified(parsed(kept(*known, plan.proof).text().encode())).holds
    recount, asked = Recount(problem), (grounds, plan.proof.cost_unit)
    assert recount.bound(*known[1:], *asked) >= plan.lower_bound
    for _ in range(50):
        bends = grounds.bends + 10.0 ** rng.uniform(-6, 0) * rng.normal(size=grounds.bends.shape)
        moved = grounds._replace(bends=bends, origins=grounds.origins + 1e-3 * rng.normal())
        assert recount.bound(*known[1:], moved, asked[1]) <= plan.objective * (1.0 + 1e-9)


@needs_machine_code
def test_a_direction_that_is_left_out_is_counted():
    problem, state, goals, plan = passing()
    grounds = plan.proof.grounds
    leaf = np.flatnonzero(grounds.splits < 0)[-1]
    short = grounds._replace(
        **{name: getattr(grounds, name)[:leaf] for name in grounds._fields[:-1]}
    )
    assert Recount(problem).bound(state, goals, short, plan.proof.cost_unit) == -np.inf


@needs_machine_code
def test_a_wider_turn_limit_proves_less():
    problem, state, goals, plan = passing()
    wider = replace(problem, max_rate=1.4)
    again = Recount(wider).bound(state, goals, plan.proof.grounds, plan.proof.cost_unit)
    assert again <= Solver(wider).solve(state, goals).objective < 0.99 * plan.lower_bound


@needs_machine_code
def test_counting_ends_where_the_bound_is_enough():
    problem, state, goals, plan = passing()
    asked = state, goals, plan.proof.grounds, plan.proof.cost_unit
    recount = Recount(problem)
    whole = recount.bound(*asked)
    for enough in (0.5 * whole, plan.lower_bound, 2.0 * whole):
        assert min(enough, whole) <= recount.bound(*asked, enough) <= whole * (1.0 + 1e-12)


@pytest.mark.parametrize('excess', [1e-6, 1e-2])
def test_a_bound_beyond_its_grounds_is_lowered_to_what_they_prove(excess):
    problem = Problem(weights=Weights(terminal=3.0), horizon=3)
    case = certified.case('hull', np.random.default_rng(2))
    state, goals = case.state, case.goals[:1].repeat(3, axis=0)
    solver = Solver(problem, gap_tolerance=1e-9)
    honest = solver.solve(state, goals)
    x = honest.rotations[1:, :, 0]

    class Boaster:
        takes_guess = trusts_guess = False

        def solve(self, request):
            cost = honest.objective / solver._units.cost
            return Found(x, cost, (1.0 + excess) * cost, 1, '', tangent(x, np.zeros(3)))

    solver._method = Boaster()
    plan = solver.solve(state, goals)
    assert plan.proof.checked
    assert plan.lower_bound <= honest.objective * (1.0 - 0.5 * OUTWARD)


def test_a_bound_that_is_the_methods_word_is_not_published():
    goal, turns = np.tile([1.0, 2.0], (4, 1)), {'rotation_order': 2, 'max_rate': 1.0}
    problem = Problem(horizon=4, floor=Floor('polygon', faces=4, fraction=0.5), **turns)
    plan = Solver(problem).solve(State.at(np.zeros(2), np.eye(2)), goal)
    assert plan.proof.lower_bound > 0.0
    assert plan.proof.checked is False
    assert (plan.lower_bound, plan.gap, plan.status) == (0.0, 1.0, 'feasible')


def slopes_over_rotations(rng):
    """Yield matrices of any size, of rank one, nearly so, and whose least rotation is any turn."""
    u, v = problems.rotation(rng, 3), problems.rotation(rng, 3)
    size = 10.0 ** rng.uniform(-6.0, 6.0)
    yield size * rng.normal(size=(3, 3))
    yield size * np.outer(u[0], v[0])
    yield size * (np.outer(u[0], v[0]) + 1e-5 * u)
    yield size * u @ np.diag([1.0, 0.3, -0.3 - rng.choice([0.0, 1e-9, 1e-3])]) @ v
    yield np.zeros((3, 3))


@pytest.mark.parametrize('seed', range(40))
def test_the_top_of_a_slope_is_what_its_singular_values_say(seed):
    """Of max -<G, R> over rotations: the sum of G's, the least with the sign of det -G."""
    for matrix in slopes_over_rotations(np.random.default_rng(seed)):
        sizes = np.linalg.svd(matrix)[1]
        most = sizes[0] + sizes[1] + np.sign(np.linalg.det(-matrix)) * sizes[2]
        assert top_of(matrix.T.ravel()) == pytest.approx(most, rel=1e-11, abs=1e-300)


@needs_machine_code
@pytest.mark.parametrize('kind', ['circle, turn rate', 'boxes that move', 'hull, arrival'])
def test_arrays_of_other_shapes_or_kinds_prove_nothing_and_are_not_gone_through(kind):
    case, plan = solved(kind, 1)
    recount, left = Recount(case.problem), plan.proof.grounds
    assert recount.bound(case.state, case.goals, left, plan.proof.cost_unit) > -np.inf
    for name, each in left._asdict().items():
        if np.size(each) < 2 or name in ('leans', 'ways'):
            continue
        short, kinds = each[:-1], each.astype(complex)
        deep, sparse = each[..., None], np.repeat(each, 2, axis=-1)[..., ::2]
        for spoilt in (short, kinds, deep, sparse, each.tolist()):
            other = left._replace(**{name: spoilt})
            assert recount.bound(case.state, case.goals, other, 1.0) == -np.inf, name
    assert recount.bound(case.state, case.goals[:-1], left, 1.0) == -np.inf


@needs_machine_code
def test_parts_beyond_all_whole_numbers_prove_nothing():
    case, plan = solved('polygon, turn rate', 1)
    known = plan.proof.grounds
    split = known._replace(splits=changed(known.splits, 0, 0), angles=changed(known.angles, 0, 0.0))
    beyond = split._replace(parts=changed(known.parts, 0, np.iinfo(np.int64).max))
    assert Recount(case.problem).bound(case.state, case.goals, beyond, 1.0) == -np.inf
