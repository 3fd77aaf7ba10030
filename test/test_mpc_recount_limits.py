# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bounds counted again where plans have to arrive, and where changes of speed are limited."""

from dataclasses import replace

import certified
import numpy as np
import problems
import pytest
from counting import a_change, an_approach, told

from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.units import Units
from orbimpc_ros.mpc.proof.convexity import arriving
from orbimpc_ros.mpc.proof.grounds import LEAF, Grounds
from orbimpc_ros.mpc.proof.kept import kept
from orbimpc_ros.mpc.proof.recount import ALL, Recount, _least_between, _reached, _within_reach
from orbimpc_ros.mpc.proof.slopes import lack_arriving
from orbimpc_ros.mpc.proof.verifier import parsed, verified
from orbimpc_ros.mpc.solve.annulus_newton import NOTHING, AnnulusNewton
from orbimpc_ros.mpc.solve.arc_search import ArcSearch
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Solver

ACCURATE = 1e-5  # share of a bound: searches over arcs tell multipliers of arrivals as found

needs_machine_code = pytest.mark.skipif(
    not COMPILED, reason='the search that leaves grounds needs numba'
)


# --- arrivals


def an_arrival(seed, dimension=2):
    """Return a problem with a round floor, a state, and goals within reach, to arrive at."""
    rng = np.random.default_rng(seed)
    problem = Problem(
        dimension=dimension,
        horizon=int(rng.integers(4, 9)),
        step=10.0 ** rng.uniform(-1, 0),
        forward=10.0 ** rng.uniform(-0.5, 1),
        weights=Weights(1.0, 0.05 * (dimension == 2), float(rng.choice([0.0, 0.3])), 10.0),
        floor=Floor('circle', fraction=float(rng.choice([rng.uniform(0.3, 0.95), 1.0]))),
        terminal='constraint',
    )
    unit = problem.length_unit
    start = State.at(10.0 * unit * rng.normal(size=dimension), problems.rotation(rng, dimension))
    way = rng.normal(size=dimension)
    way *= rng.uniform(0.1, 0.7) * problem.horizon * unit / np.linalg.norm(way)
    return problem, start, np.tile(start.position + way, (problem.horizon, 1))


@pytest.mark.parametrize('seed', range(12))
@pytest.mark.parametrize(('dimension', 'lost'), [(2, 1e-8), (3, 1e-6)])
def test_what_an_arrival_rests_on_is_what_the_method_said(seed, dimension, lost):
    asked = an_arrival(seed, dimension)
    bound, cost, known = told(*asked)
    again = Recount(asked[0]).bound(*asked[1:], *known)
    assert bound * (1.0 - lost) <= again <= cost * (1.0 + 1e-9)


def bent(seed):
    """Return a Hessian and bends that are convex where headings arrive alone, and that arrival."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 9))
    a, axes = rng.normal(size=count), np.linalg.qr(rng.normal(size=(count, count)))[0]
    hessian = axes * rng.uniform(0.0, 1.0, count) @ axes.T
    free = np.linalg.svd(a[None])[2][1:]
    bends = rng.normal(size=count)
    low = np.linalg.eigvalsh(free @ (hessian + np.diag(bends)) @ free.T)[0]
    return hessian, bends - low + 10.0 ** rng.uniform(-12, -1), a, rng


@pytest.mark.parametrize('seed', range(40))
def test_a_tangent_that_has_to_arrive_is_convex_and_arrives(seed):
    hessian, bends, a, rng = bent(seed)
    z, left = rng.normal(size=(len(a), 2)), rng.normal(size=2)
    pull = rng.normal(size=2)
    leaf = arriving(hessian, (a, left), z, bends, pull)
    # A bend is raised only where the matrix is next to singular, and by next to nothing.
    top = np.abs(hessian + np.diag(bends)).max()
    assert (leaf.bends >= bends).all()
    assert (leaf.bends <= bends + 2e-9 * top).all()
    stiff = hessian + np.diag(leaf.bends) + leaf.stiffness * np.outer(a, a)
    assert np.linalg.eigvalsh(stiff)[0] >= -1e-15 * leaf.stiffness * (a @ a) - 1e-12
    missed = a @ leaf.point - left
    np.testing.assert_allclose(missed, 0.0, atol=1e-13 * len(a))
    rounding = 1e-14 * (1.0 + leaf.stiffness)
    np.testing.assert_allclose(leaf.pull + leaf.stiffness * missed, pull, atol=rounding)


@pytest.mark.parametrize('seed', range(40))
@pytest.mark.parametrize('short', [0.0, 1e-3])
def test_what_a_stiff_arrival_lacks_is_seen_beside_it(seed, short):
    hessian, bends, a, _ = bent(seed)
    stiffness = 1e7
    ends, axes = np.linalg.eigh(np.outer(a, a))
    curvature = hessian, np.ascontiguousarray(axes[:, ::-1]), ends[-1:].copy()
    e = lack_arriving(curvature, bends - short, 1.0, stiffness)
    turned = axes.T @ (hessian + np.diag(bends - short)) @ axes
    rest = turned[:-1, :-1] - np.outer(turned[:-1, -1], turned[-1])[:, :-1] / (
        turned[-1, -1] + stiffness * ends[-1]
    )
    low = np.linalg.eigvalsh(rest)[0]
    assert -low - 1e-14 <= e <= max(0.0, -1.1 * low) + 1e-12


def begun(seed):
    """Return a problem in natural units with a state and goals, its method, and a tick of it."""
    problem, start, goals = an_arrival(seed)
    units = Units.of(problem)
    circle = AnnulusNewton(units.problem, 1e-6)
    asked = units.state(start), units.lengths(goals)
    return (units.problem, *asked), circle, circle._tick(Request(*asked))


def test_arcs_are_not_searched_without_a_cost_to_undercut():
    _, circle, tick = begun(3)
    assert circle._by_arcs(tick, NOTHING) is NOTHING


def searched(seed, nodes=40):
    """Return a problem in natural units, and a search over arcs for where it has to arrive."""
    asked, circle, tick = begun(seed)
    best = circle._from_around(tick, circle._from_hull(tick, NOTHING))
    search = ArcSearch(circle._annulus, 1e-12, nodes)
    search.begin(tick.q, tick.left, tick.constant, best.cost - tick.constant)
    while not search.run():
        pass
    return asked, best.cost, search.bound + tick.constant, search.grounds()


@pytest.mark.parametrize('seed', range(7))
def test_arcs_know_arrivals(seed):
    asked, cost, bound, grounds = searched(seed)
    again = Recount(asked[0]).bound(*asked[1:], grounds, 1.0)
    assert bound - ACCURATE * abs(bound) <= again <= cost * (1.0 + 1e-9)
    proof = Solver(asked[0]).solve(*asked[1:]).proof
    left = replace(proof, grounds=grounds, cost_unit=1.0, checked=True, lower_bound=again)
    assert verified(parsed(kept(*asked, left).text().encode())).holds


def test_no_pulls_of_splits_prove_more_than_there_is():
    asked, cost, _, grounds = searched(3)
    assert (grounds.splits >= 0).any()
    rng, recount = np.random.default_rng(5), Recount(asked[0])
    for _ in range(60):
        size = 10.0 ** rng.uniform(-6.0, 1.0)
        moved = grounds._replace(
            points=grounds.points + size * rng.normal(size=grounds.points.shape),
            bends=grounds.bends + rng.choice([0.0, size]) * rng.normal(size=grounds.bends.shape),
            pulls=grounds.pulls + size * rng.normal(size=grounds.pulls.shape),
            stiffness=grounds.stiffness * rng.uniform(0.0, 2.0),
        )
        assert recount.bound(*asked[1:], moved, 1.0) <= cost * (1.0 + 1e-9)


@pytest.mark.parametrize(
    'spoilt',
    [
        lambda g: g._replace(pulls=g.pulls[:, :1].copy()),
        lambda g: g._replace(pulls=g.pulls[:-1]),
        lambda g: g._replace(pulls=g.pulls[:, :0].copy()),
        lambda g: g._replace(stiffness=g.stiffness[:-1]),
        lambda g: g._replace(stiffness=-1.0 - g.stiffness),
        lambda g: g._replace(pulls=g.pulls + np.nan),
        lambda g: g._replace(stiffness=g.stiffness + np.nan),
    ],
    ids=['short', 'few', 'none', 'few stiff', 'less than no stiffness', 'nan', 'nan stiffness'],
)
def test_pulls_that_fit_no_tree_prove_nothing(spoilt):
    asked, *_, grounds = searched(3)
    assert Recount(asked[0]).bound(*asked[1:], spoilt(grounds), 1.0) == -np.inf


def test_no_leaf_is_pulled_where_nothing_has_to_arrive():
    (problem, *asked), *_, grounds = searched(3)
    free = replace(problem, terminal='penalty')
    assert Recount(free).bound(*asked, grounds, 1.0) == -np.inf


# --- changes of speed


def slowing():
    """Return a problem whose bound rests on splits by speeds, with what that is."""
    asked = a_change(24)
    bound, cost, known = told(*asked)
    assert (known[0].splits >= asked[0].horizon).sum() > 5
    return asked, bound, cost, known


@needs_machine_code
@pytest.mark.parametrize('seed', range(30))
def test_what_ranges_of_speeds_prove_is_what_the_search_said(seed):
    asked = a_change(seed)
    bound, cost, known = told(*asked)
    recount = Recount(asked[0])
    assert recount.bound(*asked[1:], *known) <= cost * (1.0 + 1e-9)
    assert recount.bound(*asked[1:], *known, bound) >= bound * (1.0 - 1e-9)


@needs_machine_code
def test_what_a_child_gains_is_gained_on_the_dual_value_of_its_parents_minimiser():
    problem = Problem(
        horizon=3,
        weights=Weights(0.04154, 3.025, 0.0, 0.4154),
        floor=Floor('polygon', 4, 0.6665),
        max_rate=1.5,
        max_acceleration=0.02,
    )
    start = State.at(np.zeros(2), -0.8107 * np.eye(2), disturbance=np.array([0.00168, 0.04536]))
    goals = np.tile([0.2002, 0.5281], (3, 1))
    bound, cost, known = told(problem, start, goals)
    again = Recount(problem).bound(start, goals, *known, bound)
    assert bound * (1.0 - 1e-9) <= again <= cost * (1.0 + 1e-9)


@needs_machine_code
def test_no_split_by_speeds_proves_more_than_there_is():
    asked, _, cost, (grounds, unit) = slowing()
    rng, recount = np.random.default_rng(8), Recount(asked[0])
    inner, refused, count = np.flatnonzero(grounds.splits >= 0), 0, asked[0].horizon
    for _ in range(300):
        at, size = int(rng.choice(inner)), 10.0 ** rng.uniform(-4.0, 0.5)
        splits, angles = grounds.splits.copy(), grounds.angles.copy()
        splits[at] = rng.choice([splits[at], 0, count, 2 * count - 1, 2 * count])
        angles[at] += rng.choice([size * rng.normal(), np.nan])
        points = grounds.points + size * rng.normal(size=grounds.points.shape)
        moved = grounds._replace(splits=splits, angles=angles, points=points)
        again = recount.bound(*asked[1:], moved, unit)
        assert again <= cost * (1.0 + 1e-9)
        refused += again == -np.inf
    assert 0 < refused < 300


@needs_machine_code
def test_a_wider_change_of_speed_proves_less_and_none_proves_nothing():
    (problem, *asked), bound, _, known = slowing()
    wider = replace(problem, max_acceleration=3.0 * problem.max_acceleration)
    again = Recount(wider).bound(*asked, *known)
    assert again <= told(wider, *asked)[1] < 0.99 * bound
    assert Recount(replace(problem, max_acceleration=0.0)).bound(*asked, *known) == -np.inf


@needs_machine_code
def test_turns_by_up_to_half_a_circle_leave_all_directions():
    problem = Problem(horizon=4, floor=Floor('circle', fraction=0.6), max_rate=np.pi)
    asked = problem, State.at(np.zeros(2), np.eye(2)), np.tile([-0.3, 0.4], (4, 1))
    bound, cost, known = told(*asked)
    assert (known[0].splits >= 0).any()
    assert bound * (1.0 - 1e-9) <= Recount(problem).bound(*asked[1:], *known)
    free = replace(problem, max_rate=0.0)
    assert cost == pytest.approx(told(free, *asked[1:])[1], rel=1e-3)
    plan = Solver(problem).solve(*asked[1:])
    assert plan.proof.checked
    assert kept(*asked, plan.proof) is None  # the format counts directions from the attitude then


@needs_machine_code
@pytest.mark.parametrize('seed', range(2))
@pytest.mark.parametrize(
    'kind', ['acceleration', 'space, acceleration', 'circle, arrival, acceleration']
)
def test_what_knows_no_limit_of_speeds_hands_on_what_its_bound_rests_on(kind, seed):
    case = certified.case(kind, np.random.default_rng([seed, *kind.encode()]), longest=5)
    bound, _, known = told(*case)
    again = Recount(case.problem).bound(*case[1:], *known, bound)
    assert again >= bound * (1.0 - 1e-8)
    plan = Solver(case.problem).solve(*case[1:])
    assert plan.proof.checked
    assert plan.lower_bound == pytest.approx(bound, rel=1e-8)
    assert verified(parsed(kept(*case, plan.proof).text().encode())).holds


def a_sector(rng):
    """Return a floor's normals and least speed, the ends of a sector, and a range of speeds."""
    faces = int(rng.choice([0, 4, 6, 8]))
    around = 2.0 * np.pi * np.arange(faces) / max(faces, 1)
    normals = np.column_stack([np.cos(around), np.sin(around)])
    least = rng.uniform(0.2, 0.95 * np.cos(np.pi / faces) if faces else 0.9)
    slow, fast = np.sort(rng.uniform(least, 1.0, 2))
    low = rng.uniform(-4.0, 4.0)
    return normals, least, low, low + rng.choice([0.3, 1.5, 3.0, 5.0, 7.0]), slow, fast


def places(rng, normals, least, low, high, slow, fast):
    """Yield angles of a sector, and speeds there within floor and range."""
    for angle in rng.uniform(low, high, 200):
        begin = max(slow, _reached(normals, least, angle))
        if begin <= fast:
            yield from ((angle, speed) for speed in (begin, fast, rng.uniform(begin, fast)))


@pytest.mark.parametrize('seed', range(100))
def test_the_least_of_a_sector_and_a_range_of_speeds_is_below_all_there_is(seed):
    rng = np.random.default_rng(seed)
    normals, least, *rest = a_sector(rng)
    slope, length, bend = rng.normal(size=2), rng.choice([0.0, 0.3]), rng.choice([0.0, 0.4, -0.4])
    bound = _least_between(*slope, length, bend, normals, least, *rest)
    for angle, s in places(rng, normals, least, *rest):
        there = s * (slope @ [np.cos(angle), np.sin(angle)])
        assert bound <= there + length * s - 0.5 * bend * s * s + 1e-12


@pytest.mark.parametrize('seed', range(100))
def test_the_least_of_a_narrow_sector_is_where_it_is_least(seed):
    rng = np.random.default_rng(seed)
    normals, least, low, _, slow, _ = a_sector(rng)
    high, slope = low + rng.uniform(0.1, 3.0), rng.normal(size=2)
    bound = _least_between(*slope, 0.0, 0.0, normals, least, low, high, slow, 1.0)
    there = [
        (slope @ [np.cos(angle), np.sin(angle)])
        * np.array([max(slow, _reached(normals, least, angle)), 1.0])
        for angle in np.linspace(low, high, 2001)
    ]
    assert bound == pytest.approx(np.min(there), abs=3e-3)


def test_the_least_of_a_sector_is_beyond_a_face_and_at_no_less_than_the_least_speed():
    normals, low, high = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]), 0.0, 0.7
    slope = np.array([np.cos(0.3), np.sin(0.3)])
    bound = _least_between(*slope, 0.0, 0.0, normals, 0.6, low, high, 0.7, 1.0)
    # At 0 the face is slower, and at 0.7 what is as slow as can be is not beyond it.
    assert bound == pytest.approx(0.7 * np.cos(0.3), rel=1e-12)


@pytest.mark.parametrize('seed', range(100))
def test_what_is_left_of_a_sector_holds_all_that_a_range_of_speeds_reaches(seed):
    rng = np.random.default_rng(seed)
    normals, least, low, high, slow, fast = a_sector(rng)
    if high - low > ALL:
        high = low + 3.0
    begin, end = _within_reach(low, high, fast, normals, least)
    assert low <= begin
    assert end <= high
    for angle, _ in places(rng, normals, least, low, high, slow, fast):
        assert begin <= angle <= end
    assert len(normals) == 0 or _within_reach(low, high, 0.9 * least, normals, least)[1] < low


# --- cones of approach


@needs_machine_code
@pytest.mark.parametrize('seed', [*range(8), *range(9, 16)])  # 8 takes 28,000 nodes
def test_what_a_search_rests_on_within_a_cone_is_what_it_said(seed):
    asked = an_approach(seed)
    bound, cost, (grounds, unit) = told(*asked)
    again = Recount(asked[0]).bound(*asked[1:], grounds, unit)
    assert bound * (1.0 - 1e-9) <= again <= cost * (1.0 + 1e-7)


@needs_machine_code
def test_each_way_round_to_the_last_heading_has_a_root():
    """Without one of them nothing is proved, nor by one that is a part of another."""
    problem, state, goals = an_approach(5)
    _, _, (grounds, unit) = told(problem, state, goals)
    recount = Recount(problem)
    assert problem.horizon * problem.widest_turn > 2.0 * np.pi
    assert recount.bound(state, goals, grounds, unit) > 0.0
    fewer = [each[:1] for each in grounds[:5]]
    alone = Grounds(*fewer, grounds.origins)._replace(splits=np.array([LEAF]))
    assert recount.bound(state, goals, alone, unit) == -np.inf
    split = int(np.flatnonzero(grounds.splits != LEAF)[0])
    parts = grounds.parts.copy()
    parts[split] = split + 1  # the root of another way
    assert recount.bound(state, goals, grounds._replace(parts=parts), unit) == -np.inf


@needs_machine_code
def test_a_narrower_cone_is_another_problem():
    """What is said within a cone does not follow from a wider one."""
    problem, state, goals = an_approach(5)
    _, _, (grounds, unit) = told(problem, state, goals)
    bound = Recount(problem).bound(state, goals, grounds, unit)
    wider = replace(problem, approach=replace(problem.approach, cone=1.3))
    assert Recount(wider).bound(state, goals, grounds, unit) < bound * (1.0 - 1e-3)
