# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The verifier: its cost, its brackets, what it refuses; all against other ways to know."""

import ast
import itertools
import json
import math
import shutil
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from orbimpc_ros.mpc.check import turn_margin
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.model.cost import length_weights
from orbimpc_ros.mpc.model.dynamics import translation_rollout
from orbimpc_ros.mpc.model.motion import controls
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Ball, Box, Floor, MovingObstacle, Problem, State, Weights
from orbimpc_ros.mpc.proof import verifier
from orbimpc_ros.mpc.proof.certificate import Certificate, Leaf, Split, statement
from orbimpc_ros.mpc.proof.verifier import least as closed
from orbimpc_ros.mpc.proof.verifier import reading
from orbimpc_ros.mpc.proof.verifier.bound import _least, bound, slid, towed
from orbimpc_ros.mpc.proof.verifier.cost import Added, tangent
from orbimpc_ros.mpc.proof.verifier.exact import (
    TINY,
    UNIT,
    Matrix,
    Vector,
    across,
    direction,
    lacking,
)
from orbimpc_ros.mpc.proof.verifier.limits import cone
from orbimpc_ros.mpc.proof.verifier.motion import steps
from orbimpc_ros.mpc.proof.verifier.regions import Sector
from orbimpc_ros.mpc.proof.verifier.splits import beside, beyond, halves, root, slower

MODELS = [
    *itertools.product((2, 3), (1, 2), (1, 2), ('euler', 'exact')),
    (2, 1, 2, 'held'),
]
WEIGHTS = Weights(position=1.3, input=0.07, length=0.0, terminal=4.0, attitude=0.6)


def exactly(values):
    """Return the rows of an array as they are."""
    return [Vector.of(map(float, row)) for row in values]


def units(values):
    """Return how many units each number is: a double is a whole number of them."""
    return [round(UNIT * Fraction(float(x))) for x in values]


def added(posed, stiffness=0, push=None, towed=None):
    """Return what is added to a cost: nothing, but for what is given, step by step."""
    flown = len(posed.weights.flown)
    push = np.zeros((flown, posed.n)) if push is None else push[:flown]
    towed = np.zeros((posed.horizon, posed.n)) if towed is None else towed
    bends = Vector([0] * posed.horizon)
    return Added(bends, Fraction(stiffness), *(across(exactly(each)) for each in (push, towed)))


def cost(posed, x, more):
    """Return the cost, with what is added, and its gradient, shape (N, d)."""
    touched = across(x)
    least, slopes = tangent(posed, touched, more)
    rise = sum(slope @ along for slope, along in zip(slopes, touched, strict=True))
    return Fraction(least, UNIT) + rise, across(slopes)


def rotation(n, rng):
    return exp(rng.normal(size=1 if n == 2 else 3))


def posed(problem, rng):
    """Return an exact problem with its parts, from a random state with random goals."""
    n = problem.dimension
    extra = {'velocity': rng.normal(size=n)} if problem.inertial else {}
    state = State.at(
        rng.normal(size=n),
        0.7 * rotation(n, rng),
        disturbance=rng.normal(size=n),
        wanted=rotation(n, rng),
        **extra,
    )
    goals = rng.normal(size=(problem.horizon, n))
    said = statement(problem, state, goals)
    return verifier.posed_by(said), state, goals


@pytest.mark.parametrize(('n', 'order', 'inertia', 'kind'), MODELS)
def test_its_cost_is_the_objective(n, order, inertia, kind):
    rng = np.random.default_rng([n, order, inertia])
    problem = Problem(n, order, inertia, 6, 0.3, 1.7, WEIGHTS, discretisation=kind)
    exact, state, goals = posed(problem, rng)
    x = rng.normal(size=(6, exact.width))
    if order == 2:
        x[0] = coordinates(state.rotation + problem.step * state.rotation_rate)
    value, _ = cost(exact, exactly(x), added(exact))
    assert float(value) == pytest.approx(trajectory_of(problem, state, goals, x).cost, rel=1e-12)


@pytest.mark.parametrize(('n', 'order', 'inertia', 'kind'), MODELS)
def test_its_gradient_is_exact(n, order, inertia, kind):
    rng = np.random.default_rng([n, order, inertia, 1])
    problem = Problem(
        n, order, inertia, 5, 0.3, 1.7, WEIGHTS, discretisation=kind, terminal='constraint'
    )
    exact, _, _ = posed(problem, rng)
    x, d = (exactly(rng.normal(size=(5, exact.width))) for _ in range(2))
    ahead, behind = (
        [u + v * sign for u, v in zip(x, d, strict=True)] for sign in map(Fraction, (1, -1))
    )
    more = added(exact, Fraction(3, 2), rng.normal(size=(6, n)), rng.normal(size=(5, n)))
    more = more._replace(bends=Vector.of(rng.normal(size=5)))
    slopes = cost(exact, x, more)[1]
    along = sum(u @ v for u, v in zip(slopes, d, strict=True))
    # Of a quadratic, differences from both sides are exact, but for units that are rounded.
    difference = cost(exact, ahead, more)[0] - cost(exact, behind, more)[0]
    assert abs(difference - 2 * along) < Fraction(100, UNIT)


@pytest.mark.parametrize(('n', 'order', 'inertia', 'kind'), MODELS)
def test_what_pushes_positions_is_weighed_as_it_moves_them(n, order, inertia, kind):
    rng = np.random.default_rng([n, order, inertia, 2])
    problem = Problem(n, order, inertia, 5, 0.3, 1.7, WEIGHTS, discretisation=kind)
    exact, state, goals = posed(problem, rng)
    x, push = rng.normal(size=(5, exact.width)), rng.normal(size=(6, n))
    if order == 2:
        x[0] = coordinates(state.rotation + problem.step * state.rotation_rate)
    headings = np.vstack([state.rotation[:, 0], x[:, :n]])
    positions, velocities = translation_rollout(problem, state, headings)
    (value, slopes), (pushed, steeper) = (
        cost(exact, exactly(x), added(exact, push=each)) for each in (None, push)
    )
    braked = push[5] * (inertia == 2)
    weighed = np.sum(push[:5] * (positions[1:] - goals)) + braked @ velocities[-1]
    assert float(pushed - value) == pytest.approx(weighed, abs=1e-11)
    more = np.array([list(b - a) for a, b in zip(slopes, steeper, strict=True)], float)
    maps = problem.maps
    slowed = np.outer(maps.pushed[-1, 1:], braked) if inertia == 2 else 0.0
    assert more[:, :n] == pytest.approx(maps.reach[:, 1:].T @ push[:5] + slowed)
    assert not more[:, n:].any()


@pytest.mark.parametrize('seed', range(8))
def test_least_within_a_cone_is_below_all_that_is_in_it(seed):
    rng = np.random.default_rng([seed, 9])
    n = 2 + seed % 2
    axis, slope, angle = rng.normal(size=n), rng.normal(size=n), rng.uniform(0.05, 3.0)
    width = np.cos(angle) * np.linalg.norm(axis)
    made = cone(*exactly([axis]), Fraction(float(width)))
    least = closed.towards(units(slope), made) / UNIT
    ways = rng.normal(size=(200_000, n))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    inside = ways[ways @ axis >= width]
    assert least <= (inside @ slope).min() + 1e-12
    assert least >= (inside @ slope).min() - 0.05 * np.linalg.norm(slope)


@pytest.mark.parametrize(('n', 'order', 'inertia', 'kind'), MODELS)
def test_places_are_the_control_points_of_steps(n, order, inertia, kind):
    rng = np.random.default_rng([n, order, inertia, 4])
    problem = Problem(n, order, inertia, 4, 0.3, 1.7, WEIGHTS, discretisation=kind)
    exact, state, _ = posed(problem, rng)
    headings = np.vstack([state.rotation[:, 0], rng.normal(size=(4, n))])
    flown = translation_rollout(problem, state, headings)
    led = controls(problem.translation.degree, problem.step, *flown)
    known = steps(exact.model, exact.positions, exact.velocities)
    for step, points in zip(known, led, strict=True):
        for place, point in zip(step, points, strict=True):
            free, reach = np.array(place.free, float), np.array(place.reach, float)
            assert free + reach @ headings[1:] == pytest.approx(point, abs=1e-12)


def paced(rng, problem):
    """Return an exact problem whose speed changes slowly, and 3000 ways to fly it.

    Directions and speeds, shape (3000, N).
    """
    attitude, share = rotation(2, rng), rng.uniform(problem.floor.fraction, 1.0)
    state = State.at(rng.normal(size=2), share * attitude, attitude=attitude)
    exact = verifier.posed_by(statement(problem, state, np.zeros((problem.horizon, 2))))
    begun = np.arctan2(attitude[1, 0], attitude[0, 0])
    shape = 3000, problem.horizon
    some = [rng.choice([-1.0, 1.0], shape) * rng.beta(1.0, 0.3, shape) for _ in range(2)]
    angles = begun + np.cumsum(problem.widest_turn * some[0], axis=1)
    speeds, before = np.empty(shape), np.full(3000, share)
    for k, change in enumerate(problem.speed_change * some[1].T):
        before = np.clip(before + change, problem.floor.fraction, 1.0)
        speeds[:, k] = before
    return exact, angles, speeds


def within(region, angles, speeds):
    """Return which ways are in a region, of all rounding."""
    if region is None:
        return np.zeros(len(angles), bool)
    (low, high), (slow, fast) = (
        np.array(each, float).T + np.array([[-1e-12], [1e-12]])
        for each in (region.sectors, region.speeds)
    )
    inside = (low <= angles) & (angles <= high) & (slow <= speeds) & (speeds <= fast)
    return inside.all(axis=1)


@pytest.mark.parametrize('seed', range(8))
def test_parts_below_and_above_an_angle_or_a_speed_leave_nothing_out(seed):
    rng = np.random.default_rng([seed, 15])
    floor = Floor('circle', fraction=rng.uniform(0.2, 0.7))
    pace = rng.choice([0.03, 0.1, 0.5])
    problem = Problem(horizon=5, floor=floor, max_rate=rng.uniform(0.1, 1.0), max_acceleration=pace)
    exact, *ways = paced(rng, problem)
    region = root(exact, None)
    assert within(region, *ways).all()
    for step in range(12):
        k, split = int(rng.integers(5)), (halves, slower)[step % 2]
        low, high = (region.sectors, region.speeds)[step % 2][k]
        at = low + Fraction(rng.uniform()) * (high - low)
        whole, parts = within(region, *ways), split(exact, region, k, at)
        inside = [within(each, *ways) for each in parts]
        assert (whole == inside[0] | inside[1]).all()
        fewer = [each for each in parts if each is not None]
        region = fewer[int(rng.integers(len(fewer)))]


@pytest.mark.parametrize('seed', range(12))
def test_what_a_step_adds_is_no_more_than_it_does_within_its_speeds_and_directions(seed):
    rng = np.random.default_rng([seed, 16])
    floor, length = Floor('circle', fraction=0.3), rng.choice([0.0, 0.5])
    weights = Weights(length=float(length))
    problem = Problem(horizon=5, weights=weights, floor=floor, max_rate=0.4, max_acceleration=0.1)
    exact, *_ = paced(rng, problem)
    region = root(exact, None)
    for split in (halves, slower):
        known = (region.sectors if split is halves else region.speeds)[2]
        parts = split(exact, region, 2, (known.low + known.high) / 2)
        region = parts[int(rng.integers(2))]
    slope, bend = rng.normal(size=2), rng.choice([0.0, 0.5, -0.5])
    (low, high), (slow, fast) = (map(float, each[2]) for each in (region.sectors, region.speeds))
    angles, speeds = np.meshgrid(np.linspace(low, high, 401), np.linspace(slow, fast, 201))
    along = slope[0] * np.cos(angles) + slope[1] * np.sin(angles) + length
    found = (along * speeds - 0.5 * bend * speeds**2).min()
    units = [round(UNIT * x) for x in slope]
    least = _least(exact, region, 2, units, round(UNIT * bend)) / UNIT
    assert found - 1e-3 <= least <= found + 1e-12


@pytest.mark.parametrize('seed', range(12))
def test_what_a_leaf_proves_is_below_the_cost_of_all_that_is_beyond_its_face(seed):
    rng = np.random.default_rng([seed, 17])
    weights = Weights(0.1, 0.07, float(rng.choice([0.0, 0.5])), 0.0)
    floor = Floor('polygon', 5, 0.5)
    problem = Problem(horizon=1, weights=weights, floor=floor, discretisation='exact')
    exact, state, goals = posed(problem, rng)
    face = int(rng.integers(5))
    region = beyond(exact, root(exact, None), 0)[face]
    z = rng.normal(size=(4000, 1, 2))
    z *= rng.uniform(0.5, 1.0, (4000, 1, 1)) / np.linalg.norm(z, axis=-1, keepdims=True)
    normal = np.array([np.cos(0.4 * np.pi * face), np.sin(0.4 * np.pi * face)])
    outside = z[(z @ normal)[:, 0] >= 0.5]
    costs = [trajectory_of(problem, state, goals, each).cost for each in outside]
    best, found = outside[np.argmin(costs)], []
    ahead = length_weights(problem)[1] * best / np.linalg.norm(best)
    for share in (0.0 * best, rng.normal(size=(1, 2)), -ahead):
        for bend in (0.0, 0.1, -0.1):
            known = {'point': best, 'bends': np.array([bend]), 'shares': share}
            leaf = {name: value.tolist() for name, value in known.items()}
            found.append(float(bound(exact, leaf, region)))
    assert max(found) <= min(costs) + 1e-12
    assert found[6] >= min(costs) - 0.06  # a length is no less than along the way of the best


def test_speeds_reach_as_far_as_they_change_from_where_they_begin():
    floor = Floor('circle', fraction=0.6)
    problem = Problem(horizon=3, step=0.5, forward=2.0, floor=floor, max_acceleration=0.4)
    for share, ends in (
        (0.85, [(0.75, 0.95), (0.65, 1.0), (0.6, 1.0)]),
        (0.3, [(0.6, 0.7), (0.6, 0.8), (0.6, 0.9)]),
    ):  # at the floor at once
        state = State.at(np.zeros(2), share * np.eye(2), attitude=np.eye(2))
        exact = verifier.posed_by(statement(problem, state, np.zeros((3, 2))))
        assert np.array(exact.limits.speeds, float) == pytest.approx(np.array(ends))
    free = statement(replace(problem, max_acceleration=0.0), state, np.zeros((3, 2)))
    assert verifier.posed_by(free).limits.speeds == ((Fraction(0.6), 1),) * 3


STEPS = list(itertools.product((1, 2), ('euler', 'exact')))


def passing(body, inertia, kind, rng):
    """Return the walls of a body that moves, what is on sides of step 2, and 4000 such steps.

    Their control points, shape (4000, m, 2), and where the body is by then.
    """
    problem = Problem(2, 1, inertia, 3, 0.3, 1.7, discretisation=kind)
    extra = {'velocity': rng.normal(size=2)} if inertia == 2 else {}
    drift = MovingObstacle.drifting(body, rng.normal(size=2))
    known = {'disturbance': rng.normal(size=2), 'hazards': (drift,), **extra}
    state = State.at(rng.normal(size=2), rotation(2, rng), **known)
    exact = verifier.posed_by(statement(problem, state, np.zeros((3, 2))))
    z = rng.normal(size=(4000, 3, 2))
    z /= np.maximum(1.0, np.linalg.norm(z, axis=-1))[..., None]
    points = []
    for each in z:
        flown = translation_rollout(problem, state, np.vstack([state.rotation[:, 0], each]))
        points.append(controls(problem.translation.degree, problem.step, *flown)[1])
    shares = np.linspace(0.3, 0.6, len(points[0]))[:, None]
    return exact.limits.walls, np.array(points), shares * drift.shifts[1]


@pytest.mark.parametrize(('inertia', 'kind'), STEPS)
def test_what_is_known_beside_a_disc_holds_of_all_steps_that_pass_it_there(inertia, kind):
    rng, tight = np.random.default_rng([inertia, len(kind), 11]), []
    for _ in range(4):
        centre, radius = 9.0 + rng.normal(size=2), rng.uniform(0.05, 0.4)
        walls, points, moved = passing(Ball(centre, radius), inertia, kind, rng)
        low = rng.uniform(0.0, 5.0)
        sector = Sector(Fraction(low), Fraction(low + rng.uniform(0.05, 1.2)))
        own = points - moved - centre
        # To the disc, from wherever they are: the hull then touches it in the sector.
        angles = rng.uniform(*map(float, sector), len(own))
        normals = np.column_stack([np.cos(angles), np.sin(angles)])
        nearest = np.einsum('emn,en->em', own, normals).argmin(axis=1)
        aside = radius * normals - own[np.arange(len(own)), nearest]
        for wall, told in zip(walls, (own[:, -1:], own), strict=True):
            beside = told + (radius * normals - told[:, -1])[:, None]
            if wall.of == 'step':
                beside = own + aside[:, None]
            rows = wall.side(sector, 1)
            assert len(rows) == told.shape[1]
            middles = centre + moved[-len(rows) :]
            for row, of, middle in zip(rows, beside.swapaxes(0, 1), middles, strict=True):
                normal, least = np.array(row.normal, float), float(row.least)
                worst = ((of + middle) @ normal).min() - least
                assert worst >= -1e-12
                if wall.of == 'end':
                    tight.append(worst < 0.01 * radius)
    assert all(tight)


@pytest.mark.parametrize(('inertia', 'kind'), STEPS)
def test_what_is_known_beside_a_box_that_moves_is_that_all_of_a_step_is(inertia, kind):
    rng = np.random.default_rng([inertia, len(kind), 12])
    low = 9.0 + rng.normal(size=2)
    (wall,), points, moved = passing(Box(low, low + 0.4), inertia, kind, rng)
    for i, away in enumerate((low - points + moved, points - moved - low - 0.4)):
        for axis in range(2):
            rows = wall.side(2 * i + axis, 1)
            assert len(rows) == points.shape[1]
            margins = [
                points[:, j] @ np.array(row.normal, float) - float(row.least)
                for j, row in enumerate(rows)
            ]
            assert pytest.approx(away[..., axis], abs=1e-12) == np.array(margins).T


@pytest.mark.parametrize('seed', range(4))
def test_what_slides_along_the_glide_slope_is_nowhere_above_what_is_eased(seed):
    rng = np.random.default_rng([seed, 10])
    angle, eased = rng.uniform(0.2, 1.3), np.array([0.0, 0.3])
    problem = Problem(3, 1, 1, 2, 0.3, 1.7, glide_slope=angle)
    said = statement(problem, State.at(np.zeros(3), np.eye(3)), np.zeros((2, 3)))
    said['limits']['glide_slope']['eased'] = eased.tolist()
    exact, way = verifier.posed_by(said), rng.uniform(0.0, 2.0 * np.pi)
    rim = np.array([np.cos(way), np.sin(way), -1.000001 / np.tan(angle)])
    slides = rng.uniform(0.0, 2.0, (2, 1)) * rim
    paid = sum(slid(exact, k, c) for k, c in enumerate(exactly(slides)))
    away = rng.uniform(-2.0, 2.0, (20_000, 2, 3))
    stray = np.sin(angle) * np.hypot(away[..., 0], away[..., 1]) - np.cos(angle) * away[..., 2]
    inside = away[(stray <= eased).all(axis=1)]
    assert len(inside)
    assert (np.sum(inside * slides, axis=(1, 2)) + float(paid)).max() <= 1e-12
    slides[:, 2] *= 0.99999
    with pytest.raises(verifier.Refused, match='not along the glide slope'):
        slid(exact, 0, exactly(slides)[0])


def tied(n, order, seed):
    """Return a problem with a turn limit, a state, goals, and rotations that the check calls legal.

    Axes move about as far as they may in a step, or as near to it as the hull lets them.
    """
    rng = np.random.default_rng([n, order, seed, 13])
    step, count = rng.uniform(0.1, 0.5), 4
    problem = Problem(n, order, 1, count, step, 1.7, WEIGHTS, max_rate=rng.uniform(0.3, 4.0))
    state = State.at(rng.normal(size=n), rotation(n, rng), wanted=rotation(n, rng))
    walks = np.empty((400, count + 1, n, n))
    walks[:, 0] = state.rotation
    for walk in walks:
        for k in range(count):
            wanted = rotation(n, rng) * rng.uniform()
            moved = np.linalg.norm((wanted - walk[k])[:, 0])
            walk[k + 1] = walk[k] + min(1.0, problem.chord / moved) * (wanted - walk[k])
        if order == 2:
            walk[1] = walk[0] + step * state.rotation_rate
            walk[2:] = walk[1] + np.minimum(1.0, 0.2 * problem.chord) * (walk[2:] - walk[1])
    legal = [walk for walk in walks if turn_margin(problem, state, walk).min() > -1e-12]
    assert len(legal) >= 100
    return problem, state, rng.normal(size=(count, n)), np.array(legal), rng


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize(('n', 'order'), [(2, 1), (3, 1), (2, 2), (3, 2)])
def test_what_tows_axes_adds_nothing_to_what_is_legal(n, order, seed):
    problem, state, goals, legal, rng = tied(n, order, seed)
    exact, axes = verifier.posed_by(statement(problem, state, goals)), legal[:, :, :, 0]
    for tethers in (rng.normal(size=(4, n)), np.diff(axes[0], axis=0)):
        forces, paid = towed(exact, exactly(tethers))
        added = np.einsum('wki,ki->w', axes[:, 1:], np.array(forces, float)) + float(paid)
        assert added.max() <= 1e-12
        chords = np.einsum('wki,ki->w', np.diff(axes, axis=1), tethers)
        sizes = problem.chord * np.linalg.norm(tethers, axis=1).sum()
        assert added == pytest.approx(chords - sizes, abs=1e-12)


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize(('n', 'order'), [(2, 1), (3, 1), (2, 2), (3, 2)])
def test_what_a_leaf_with_tethers_proves_is_below_the_cost_of_what_is_legal(n, order, seed):
    problem, state, goals, legal, rng = tied(n, order, seed)
    exact = verifier.posed_by(statement(problem, state, goals))
    costs = [trajectory_of(problem, state, goals, coordinates(x[1:])).cost for x in legal]
    best, found = legal[np.argmin(costs)], []
    for scale in (0.0, 0.1, 1.0):
        point = coordinates(best[1:])[:, : exact.width]
        tethers = scale * rng.normal(size=(4, n))
        leaf = {'point': point.tolist(), 'tethers': tethers.tolist()}
        found.append(float(bound(exact, leaf, root(exact, None))))
    assert max(found) <= min(costs)
    assert len(set(found)) == 3


@pytest.mark.parametrize(
    'changes',
    [
        {'max_rate': 0.0},
        {'max_rate': math.pi / 0.4},
        {'max_rate': 1.0, 'floor': Floor('circle', fraction=0.5)},
    ],
)
def test_tethers_are_refused_where_no_chord_is_a_limit(changes):
    problem = replace(Problem(step=0.4, horizon=2), **changes)
    exact, _, _ = posed(problem, np.random.default_rng(14))
    assert towed(exact, exactly(np.zeros((2, 2))))[1] == 0
    with pytest.raises(verifier.Refused, match='no turns are limited'):
        towed(exact, exactly(np.ones((2, 2))))


@pytest.mark.parametrize('kind', ['euler', 'exact', 'held'])
def test_lengths_are_priced_as_the_objective_does(kind):
    problem = Problem(
        2, 1, 1 if kind != 'held' else 2, 4, 0.3, 1.7, Weights(length=0.8), discretisation=kind
    )
    exact, _, _ = posed(problem, np.random.default_rng(3))
    assert [float(each) for each in exact.weights.length] == pytest.approx(length_weights(problem))


@pytest.mark.parametrize('angle', [0.0, 1.0, -2.5, 3.14159, 376.2, -1e-9])
def test_directions_are_bracketed(angle):
    cosine, sine = direction(Fraction(angle))
    assert abs(cosine * cosine + sine * sine - 1) < 4 * TINY
    assert (float(cosine), float(sine)) == pytest.approx(
        (math.cos(angle), math.sin(angle)), abs=1e-15
    )


@pytest.mark.parametrize('seed', range(6))
def test_what_a_matrix_lacks_of_semidefinite_is_bracketed(seed):
    rng = np.random.default_rng([seed, 5])
    factor = rng.normal(size=(5, 5 - seed % 3))
    matrix = factor @ factor.T - (0.1 * np.eye(5) if seed > 2 else 0.0)
    matrix = 0.5 * (matrix + matrix.T) * 10.0 ** rng.uniform(-9, 9)
    lack, least = float(lacking(Matrix.of(exactly(matrix)))), np.linalg.eigvalsh(matrix)[0]
    size = np.abs(matrix).max()
    assert lack >= -least - 1e-14 * size
    assert lack <= 20.0 * max(0.0, -least) + 1e-12 * size


@pytest.mark.parametrize('seed', range(8))
def test_least_over_a_sector_is_below_all_that_is_in_it(seed):
    rng = np.random.default_rng([seed, 6])
    low = rng.uniform(-9.0, 9.0)
    high = low + rng.choice([0.1, 1.0, 3.0, 4.0, 6.0, 7.0])
    slope, bend, floor = rng.normal(size=2), rng.normal(), 0.4
    steepest = closed.within(units(slope), Sector(Fraction(low), Fraction(high)))
    speeds = Fraction(floor), Fraction(1)
    least = closed.over_speeds(steepest, *units([bend]), *speeds) / UNIT
    angles, speeds = np.meshgrid(np.linspace(low, high, 801), np.linspace(floor, 1.0, 201))
    z = speeds * (slope[0] * np.cos(angles) + slope[1] * np.sin(angles))
    found = (z - 0.5 * bend * speeds**2).min()
    assert least <= found + 1e-12
    assert least >= found - 1e-3


@pytest.mark.parametrize('seed', range(8))
def test_least_beyond_a_face_is_below_all_that_is_beyond(seed):
    rng = np.random.default_rng([seed, 7])
    faces, face = 5, int(rng.integers(5))
    problem = Problem(floor=Floor('polygon', faces, 0.6))
    exact, _, _ = posed(problem, rng)
    slope = rng.normal(size=2)
    least = closed.beyond(units(slope), exact.floor, face) / UNIT
    angle = 2.0 * np.pi * face / faces + np.linspace(-1.0, 1.0, 2001) * math.acos(0.6)
    rim = np.column_stack([np.cos(angle), np.sin(angle)])  # the least of a line is at an end
    assert least == pytest.approx((rim @ slope).min(), abs=1e-5)
    assert least <= (rim @ slope).min() + 1e-12


@pytest.mark.parametrize('seed', range(12))
def test_least_over_a_sector_of_a_polygon_is_that_of_its_points(seed):
    rng = np.random.default_rng(seed)
    faces, fraction = int(rng.integers(3, 9)), rng.uniform(0.05, 0.9)
    fraction *= np.cos(np.pi / faces)
    problem = Problem(floor=Floor('polygon', faces, fraction))
    exact, _, _ = posed(problem, rng)
    low, slope = rng.uniform(-9.0, 9.0), rng.normal(size=2)
    high = low + rng.uniform(0.01, 3.1)
    sector = Sector(Fraction(low), Fraction(high))
    least = closed.reached(units(slope), exact.floor, sector) / UNIT
    angles = np.linspace(low, high, 2001)
    share = 2.0 * np.pi / faces
    reach = fraction / np.cos(angles - share * np.round(angles / share))
    along = slope[0] * np.cos(angles) + slope[1] * np.sin(angles)
    there = min(along.min(), (along * reach).min())
    assert there - 0.01 * np.linalg.norm(slope) <= least <= there + 1e-12


@pytest.mark.parametrize('seed', range(4))
def test_least_over_the_orbitope_is_below_all_rotations(seed):
    rng = np.random.default_rng([seed, 8])
    slope = rng.normal(size=9)
    sizes = np.linalg.svd(slope.reshape(3, 3).T, compute_uv=False)
    sign = -np.sign(np.linalg.det(slope.reshape(3, 3)))
    least = -(sizes[0] + sizes[1] + sign * sizes[2])
    found = [
        closed.over_orbitope(units(slope), *units([-least + off])) / UNIT
        for off in (0.0, 1.0, -1.0)  # tops that are loose, or too low
    ]
    assert found[0] == pytest.approx(least, abs=1e-9)
    assert max(found[1:]) <= least


def test_what_a_leaf_proves_is_the_same_after_another_was_stiff():
    problem = Problem(2, 1, 1, 4, 0.3, 1.7, WEIGHTS, terminal='constraint')
    exact, _, _ = posed(problem, np.random.default_rng(12))
    bent = {'point': np.full((4, 2), 0.3).tolist(), 'bends': [-2.0] * 4}
    alone = bound(exact, bent, root(exact, None))
    assert bound(exact, {**bent, 'stiffness': 1e3}, root(exact, None)) != alone
    assert bound(exact, bent, root(exact, None)) == alone


def test_it_imports_the_standard_library_alone():
    folder = Path(verifier.__file__).parent
    own = {path.stem for path in folder.glob('*.py')}
    for path in folder.glob('*.py'):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level:
                assert node.level == 1
                assert node.module is None or node.module in own
            elif isinstance(node, (ast.Import, ast.ImportFrom)):
                names = [node.module] if isinstance(node, ast.ImportFrom) else node.names
                tops = {getattr(each, 'name', each).partition('.')[0] for each in names}
                assert tops <= set(sys.stdlib_module_names)


WORKED = """
{"format": "orbimpc certificate 1",
 "problem": {"dimension": 2, "rotation_order": 1, "translation_order": 1, "discretisation": "euler",
             "horizon": 2, "step": 1.0, "forward": 1.0, "terminal": "penalty", "max_rate": 0.0,
             "weights": {"position": 1.0, "input": 0.05, "length": 0.0, "terminal": 10.0,
                         "attitude": 0.0, "arrival": 0.0},
             "floor": {"shape": "none"}},
 "state": {"position": [0.0, 0.0], "rotation": [[1.0, 0.0], [0.0, 1.0]], "velocity": [0.0, 0.0],
           "rotation_rate": [[0.0, 0.0], [0.0, 0.0]], "attitude": [[1.0, 0.0], [0.0, 1.0]],
           "disturbance": [0.0, 0.0], "coasted": null, "wanted": null},
 "goals": [[2.0, 1.0], [2.0, 1.0]],
 "lower_bound": 3.945560311138121,
 "tree": {"point": [[0.75, 0.66], [0.75, 0.66]], "bends": [9.0, 0.0]}}
"""


def worked_example():
    return json.loads(WORKED)


@pytest.mark.parametrize(
    ('bound', 'code', 'words'), [(2.1796, 0, 'holds'), (2.18, 1, 'NOT HOLD'), ('2', 2, 'refused')]
)
def test_its_folder_runs_alone(tmp_path, bound, code, words):
    folder = Path(verifier.__file__).parent
    shutil.copytree(folder, tmp_path / 'verifier', ignore=shutil.ignore_patterns('__pycache__'))
    known = worked_example() | {'lower_bound': bound}
    (tmp_path / 'proof.json').write_text(json.dumps(known))
    command = [sys.executable, '-E', '-s', '-S', '-m', 'verifier', 'proof.json']
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert words in done.stdout + done.stderr


def test_an_example_worked_by_hand_comes_to_what_it_should():
    known = worked_example()
    assert verifier.verified(known).proved == pytest.approx(2.17965, abs=5e-6)
    known['tree'] = {
        'point': [[0.7102990878738831, 0.7038999969921365]] * 2,
        'bends': [9.054439684627207, 0.0],
    }
    verdict = verifier.verified(known)
    assert verdict.holds
    assert verdict.proved == pytest.approx(3.9455603153727914, rel=1e-15)


# --- what it refuses


def sound():
    """Return a certificate with splits of both kinds' format, by hand: the bound of nothing."""
    problem = Problem(horizon=2, floor=Floor('polygon', 4, 0.5))
    state = State.at(np.zeros(2), np.eye(2))
    leaf = Leaf(np.zeros((2, 2)))
    halves = Split(2, (leaf, leaf), at=1.0)
    tree = Split(1, (leaf, leaf, halves, leaf))
    made = Certificate(problem, state, np.ones((2, 2)), 0.0, tree, np.zeros(2))
    return json.loads(made.text())


def changed(path, value):
    known = sound()
    *way, last = path
    inner = known
    for step in way:
        inner = inner[step]
    if value is ...:
        del inner[last]
    else:
        inner[last] = value
    return known


def test_a_sound_tree_is_taken():
    assert verifier.verified(sound()).leaves == 5


@pytest.mark.parametrize(
    ('path', 'value', 'word'),
    [
        (('format',), 'another', 'format'),
        (('goals',), ..., 'lacks goals'),
        (('lower_bound',), True, 'finite'),
        (('lower_bound',), 10**400, 'finite'),
        (('lower_bound',), '1', 'finite'),
        (('more',), 1, 'unknown'),
        (('goals', 0), [1.0], 'list of 2'),
        (('problem', 'horizon'), 2.0, 'whole'),
        (('problem', 'horizon'), 10**9, 'whole'),
        (('problem', 'step'), 0.0, 'step'),
        (('problem', 'weights', 'position'), -1.0, 'negative'),
        (('problem', 'floor', 'shape'), ['circle'], 'floor.shape'),
        (('problem', 'floor', 'fraction'), 1.5, 'floor'),
        (('problem', 'max_rate'), 0.1, 'origins'),
        (('state', 'attitude'), None, 'attitude'),
        (('tree', 'parts', 0), ..., 'parts'),
        (('tree', 'parts'), [], 'parts'),
        (('tree', 'parts', 0), {'points': []}, "unknown 'points'"),
        (('tree', 'split'), 3, 'whole'),
        (('tree', 'split'), 0, 'whole'),
        (('tree', 'parts', 2, 'at'), -0.1, 'within'),
        (('tree', 'parts', 2, 'at'), 7.0, 'within'),
        (('tree', 'parts', 0, 'point'), [[0.0, 0.0]], 'list of 2'),
        (('tree', 'parts', 0, 'bends'), [0.1], 'bends'),
        (('tree', 'parts', 0, 'pull'), [1.0], 'pull'),
        (('origins',), ..., 'within'),
        (('tree',), 7, 'leaf'),
    ],
)
def test_what_is_malformed_is_refused_in_one_line(path, value, word):
    with pytest.raises(verifier.Refused, match=word) as caught:
        verifier.verified(changed(path, value))
    assert '\n' not in str(caught.value)


def test_a_leaf_without_a_point_proves_what_it_would_if_nothing_cost_anything():
    rng = np.random.default_rng(6)
    box = Box(np.array([0.5, -2.0]), np.array([0.8, 2.0]))
    problem = Problem(horizon=4, max_rate=0.5, obstacles=(box,), weights=WEIGHTS)
    case = problem, State.at(np.zeros(2), np.eye(2), wanted=np.eye(2)), np.ones((4, 2))
    priced = verifier.posed_by(statement(*case))
    free = verifier.posed_by(statement(replace(problem, weights=Weights(0, 0, 0, 0)), *case[1:]))
    aside = beside(priced, root(priced, None), 2, 0, None)[1]  # below it
    for worth in (0.0, 1.0):
        multipliers = {
            'presses': [worth * rng.uniform(0.0, 3.0)],
            'tethers': (worth * rng.normal(size=(4, 2))).tolist(),
        }
        proved = bound(priced, multipliers, aside)
        assert proved == bound(free, {'point': np.zeros((4, 2)).tolist(), **multipliers}, aside)
    assert -1e-30 < bound(priced, {}, aside) <= 0  # a root is taken of nothing
    assert bound(priced, {'point': np.zeros((4, 2)).tolist()}, aside) < -1  # far from the best


def test_a_face_is_not_split_again():
    known = sound()
    known['tree']['parts'][0] = sound()['tree']
    with pytest.raises(verifier.Refused, match='none to split by'):
        verifier.verified(known)


@pytest.mark.parametrize(
    'text', [b'', b'{', b'{"a":NaN}', b'{"a":-Infinity}', b'{"a":1,"a":1}', b'\xff', b'[' * 10**5]
)
def test_what_is_no_json_is_refused(text):
    with pytest.raises(verifier.Refused):
        verifier.parsed(text)


def test_a_huge_file_is_refused_before_it_is_taken_apart(tmp_path, monkeypatch):
    file = tmp_path / 'huge.json'
    with file.open('wb') as made:
        made.truncate(1 << 30)  # sparse
    monkeypatch.setattr(reading, 'parsed', lambda text: pytest.fail('it was'))
    with pytest.raises(verifier.Refused, match='larger than'):
        verifier.read(file)


def test_vectors_of_two_lengths_have_no_product():
    with pytest.raises(ValueError, match='one length'):
        Matrix([[1]]) @ Vector([1, 2])


def test_a_leaf_without_a_point_knows_what_is_decided_at_rotation_order_2():
    rng = np.random.default_rng(3)
    problem = Problem(3, 2, 2, 3, 0.3, 1.7, WEIGHTS, terminal='constraint')
    exact, state, goals = posed(problem, rng)
    pull, missed = rng.normal(size=6), []
    for _ in range(2000):
        z = rng.normal(size=(4, 3))
        z /= np.linalg.norm(z, axis=1)[:, None]
        z[:2] = state.rotation[:, 0]  # what does not turn stays as it is
        positions, velocities = translation_rollout(problem, state, z)
        missed.append(np.concatenate([positions[-1] - goals[-1], velocities[-1]]) @ pull)
    proved = float(bound(exact, {'pull': pull.tolist()}, root(exact, None)))
    assert proved <= min(missed) <= proved + 0.05 * np.ptp(missed)


def test_both_ends_are_on_one_side_from_the_second_step_on():
    """How the first step begins is the state's, which may be on another side."""
    problem = Problem(horizon=2, obstacles=(Box((1.0, -1.0), (2.0, 1.0)),))
    state, told = State.at(np.zeros(2), np.eye(2)), {}
    for cut in (False, True):
        known = statement(replace(problem, no_corner_cutting=cut), state, np.ones((2, 2)))
        exact = verifier.posed_by(known)
        (wall,) = exact.limits.walls
        told[wall.of] = [[place for place, _ in wall.told(k)] for k in range(2)]
        _, first, second = exact.positions
        assert told[wall.of][0] == [first]
        assert told[wall.of][1][-1] == second
    assert list(map(len, told['end'])) == [1, 1]
    assert list(map(len, told['ends'])) == [1, 2]


def test_places_are_as_far_apart_as_what_a_body_rate_decides_leads():
    ball = Ball((3.0, 0.0), 0.5)
    problem = Problem(rotation_order=2, translation_order=1, discretisation='exact', horizon=2)
    spreads = []
    for rate in (0.0, 3.0):
        turning = rate * np.array([[0.0, -1.0], [1.0, 0.0]])
        state = State.at(np.zeros(2), np.eye(2), rotation_rate=turning)
        known = statement(replace(problem, obstacles=(ball,)), state, np.ones((2, 2)))
        exact = verifier.posed_by(known)
        spreads.append(float(exact.limits.walls[1].spread(0)))
        second = np.eye(2)[0] + problem.step * turning[:, 0]
        z = np.vstack([np.eye(2)[0], second, second])
        led = controls(2, problem.step, *translation_rollout(problem, state, z))[0]
        apart = np.linalg.norm(led[:, None] - led[None], axis=-1).max()
        assert spreads[-1] >= apart - 1e-12
    assert spreads[1] > 1.5 * spreads[0]


@pytest.mark.parametrize('width', [6.2831853, 6.5, 8.0, 20.0])
def test_a_sector_that_leaves_nothing_out_holds_nothing(width):
    sector = Sector(Fraction(-width / 2), Fraction(width / 2))
    for slope in ([1.0, 0.0], [1.0, 1e-8], [-3.0, 4.0]):
        least = closed.within(units(slope), sector) / UNIT
        assert least == pytest.approx(-math.hypot(*slope), rel=1e-12)
        assert least <= -math.hypot(*slope)


def test_balls_in_space_have_no_sides():
    state = State.at(np.zeros(3), np.eye(3))
    ball = Ball(np.array([1.0, 0.0, 0.0]), 0.5)
    exact = verifier.posed_by(
        statement(Problem(3, horizon=2, obstacles=(ball,)), state, np.ones((2, 3)))
    )
    assert [wall.of for wall in exact.limits.walls] == ['end', 'step']
    with pytest.raises(verifier.Refused, match='have no sides'):
        beside(exact, root(exact, None), 1, 0, 1.0)


@pytest.mark.parametrize(
    'changes',
    [
        {'rotation_order': 2, 'floor': Floor('circle', fraction=0.5)},
        {'rotation_order': 2, 'floor': Floor('polygon', 6, 0.5), 'max_rate': 0.3},
        {'dimension': 3, 'floor': Floor('polygon', 6, 0.5)},
    ],
)
def test_floors_of_which_there_are_no_proofs_are_no_use(changes):
    """Nor does a turn limit bound chords with them."""
    problem = replace(Problem(horizon=3, weights=WEIGHTS), **changes)
    case = posed(problem, np.random.default_rng(18))
    free = verifier.posed_by(statement(replace(problem, floor=Floor(), max_rate=0.0), *case[1:]))
    leaf = {'point': np.full((3, free.width), 0.2).tolist()}
    proved = [bound(each, leaf, root(each, None)) for each in (case[0], free)]
    assert proved[0] == proved[1]
    with pytest.raises(verifier.Refused, match='no turns are limited'):
        bound(case[0], {**leaf, 'tethers': np.ones((3, free.n)).tolist()}, root(case[0], None))
