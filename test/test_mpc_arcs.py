# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Arcs of a round floor: their rows hold, their bounds are sound and the lifted relaxation's."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from problems import floor, goals, state, weights

from orbimpc_ros.mpc.kernels.dual import BOUND, ascent, climb
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.solve.annulus_newton import NOTHING, AnnulusNewton
from orbimpc_ros.mpc.solve.arc_search import cuts
from orbimpc_ros.mpc.solve.request import Request

NO_ARRIVAL = np.zeros(0)
FLOORS = [0.01, 0.3, 2.0 / 3.0, 1.0]


def some_arcs(rng, steps):
    """Arcs narrower than half a circle for some steps, the whole circle for others."""
    low = rng.uniform(-np.pi, np.pi, steps)
    width = rng.choice([0.01, 0.5, 1.5, 3.0], steps) * (rng.random(steps) < 0.7)
    return low, low + width


def headings(rng, low, high, least, count):
    """Random headings within arcs, shape (count, N, 2), every other one on an edge."""
    shape = (count, len(low))
    share = np.where(rng.random(shape) < 0.5, rng.integers(0, 2, shape), rng.random(shape))
    angle = low + share * np.where(high > low, high - low, 2.0 * np.pi)
    size = least + (1.0 - least) * rng.choice([0.0, 0.5, 1.0], shape)
    return size[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def case(rng, least, length=True):
    """An annulus, the linear terms of a tick, and the constant part of its cost."""
    chosen = weights(rng)
    if not length:
        chosen = replace(chosen, length=0.0)
    steps = int(rng.integers(2, 7))
    problem = Problem(horizon=steps, weights=chosen, floor=floor('circle', least))
    circle = AnnulusNewton(problem, 1e-6)
    start = state(rng, problem, full_speed=False)
    tick = circle._tick(Request(start, goals(rng, problem, distance=1.0)))
    return circle, tick


def bound_of(annulus, q, rows):
    progress = ascent(annulus, q, rows, -np.inf)
    while not climb(annulus, q, NO_ARRIVAL, rows, np.inf, progress, 1e9):
        pass
    return float(progress.numbers[BOUND])


def costs(annulus, q, z):
    """Costs of headings, shape (count, N, 2)."""
    return np.sum(z * (0.5 * annulus.hessian @ z + q), axis=(1, 2)) + (
        np.linalg.norm(z, axis=2) @ annulus.length
    )


def descended(annulus, q, z, low, high):
    """The same headings after projected descent over angles and moduli within their arcs."""
    size, angle = np.linalg.norm(z, axis=2), np.arctan2(z[..., 1], z[..., 0])
    middle = 0.5 * (low + high)
    angle = angle + 2.0 * np.pi * np.round((middle - angle) / (2.0 * np.pi))
    free = high == low
    rate = 0.5 / (np.linalg.eigvalsh(annulus.hessian)[-1] + np.abs(q).max() + 1e-9)
    for _ in range(300):
        unit = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        across = np.stack([-unit[..., 1], unit[..., 0]], axis=-1)
        force = annulus.hessian @ (size[..., None] * unit) + q
        slope = np.sum(force * unit, axis=2) + annulus.length
        angle = angle - rate * size * np.sum(force * across, axis=2)
        angle = np.where(free, angle, np.clip(angle, low, high))
        size = np.clip(size - rate * slope, annulus.floor, 1.0)
    return size[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


@pytest.mark.parametrize('least', FLOORS)
def test_the_rows_of_arcs_hold_within_them_and_touch_at_their_corners(least):
    rng = np.random.default_rng(1)
    for _ in range(30):
        low, high = some_arcs(rng, 4)
        rows = cuts(low, high, least)
        z = headings(rng, low, high, least, 200)[:, rows.steps]
        room = np.sum(rows.normals * z, axis=2) + rows.offsets
        room -= 0.5 * rows.bends * np.sum(z * z, axis=2)
        assert (room >= -1e-12).all()
        corners = [s * np.array([np.cos(a), np.sin(a)]) for a in (low, high) for s in (least, 1.0)]
        first = len(rows.steps) // 3
        for corner in corners:
            at = corner.T[rows.steps[:first]]
            over = np.sum(rows.normals[:first] * at, axis=1) + rows.offsets[:first]
            assert np.allclose(over, 0.5 * np.sum(at * at, axis=1), atol=1e-12)


def test_a_heading_beside_its_arc_violates_a_row():
    low, high = np.array([0.2]), np.array([1.4])
    rows = cuts(low, high, 0.5)
    for angle in (0.1, 1.5, -2.0, 3.0):
        for size in (0.5, 0.8, 1.0):
            z = size * np.array([np.cos(angle), np.sin(angle)])
            assert (rows.normals @ z + rows.offsets < 0.5 * rows.bends * size**2 - 1e-6).any()


@pytest.mark.parametrize('least', FLOORS)
@pytest.mark.parametrize('seed', range(5))
def test_no_bound_over_arcs_exceeds_what_descent_finds_within_them(seed, least):
    rng = np.random.default_rng(seed)
    for _ in range(4):
        circle, tick = case(rng, least)
        annulus, q = circle._annulus, tick.q
        low, high = some_arcs(rng, len(q))
        bound = bound_of(annulus, q, cuts(low, high, least))
        z = headings(rng, low, high, least, 60)
        found = min(costs(annulus, q, z).min(),
                    costs(annulus, q, descended(annulus, q, z, low, high)).min())  # fmt: skip
        assert bound <= found + 1e-9 * (abs(found) + abs(tick.constant))


def lifted(annulus, q, rows):
    """The relaxation over second moments X of the headings, with the rows of arcs."""
    steps = len(q)
    moments = cp.Variable((steps + 2, steps + 2), PSD=True)
    second, z = moments[:steps, :steps], moments[:steps, steps:]
    squares = cp.diag(second)
    held = [moments[steps:, steps:] == np.eye(2), squares >= annulus.floor**2, squares <= 1.0]
    for k, bend, normal, offset in zip(*rows, strict=True):
        held.append(0.5 * bend * squares[k] <= normal @ z[k] + offset)
    cost = 0.5 * cp.trace(annulus.hessian @ second) + cp.sum(cp.multiply(q, z))
    program = cp.Problem(cp.Minimize(cost), held)
    program.solve(solver=cp.CLARABEL)
    return program.value


@pytest.mark.parametrize('least', [0.3, 2.0 / 3.0, 1.0])
@pytest.mark.parametrize('seed', range(3))
def test_multipliers_bound_arcs_as_well_as_the_lifted_relaxation(seed, least):
    rng = np.random.default_rng(100 + seed)
    circle, tick = case(rng, least, length=False)
    rows = cuts(*some_arcs(rng, len(tick.q)), least)
    bound, known = bound_of(circle._annulus, tick.q, rows), lifted(circle._annulus, tick.q, rows)
    assert bound + tick.constant == pytest.approx(known + tick.constant, rel=1e-5, abs=1e-6)


def test_narrow_arcs_leave_no_gap():
    """Around a trajectory, ever narrower, the bound becomes its cost."""
    rng = np.random.default_rng(3)
    circle, tick = case(rng, 0.6)
    annulus, q = circle._annulus, tick.q
    angle = rng.uniform(-np.pi, np.pi, len(q))
    gaps = []
    for width in (0.4, 0.1, 0.025):
        low, high = angle - width, angle + width
        z = headings(rng, low, high, 0.6, 200)
        best = costs(annulus, q, descended(annulus, q, z, low, high)).min()
        gaps.append(best - bound_of(annulus, q, cuts(low, high, 0.6)))
    assert gaps[2] <= 1e-3 * max(gaps[0], 1e-3 * abs(best))
    assert min(gaps) >= -1e-9 * abs(best)


@pytest.mark.parametrize('least', [0.5, 1.0])
@pytest.mark.parametrize('seed', range(3))
def test_a_search_over_arcs_finds_what_trying_everything_does(seed, least):
    """Two steps, on a grid of their angles and moduli."""
    rng = np.random.default_rng(200 + seed)
    problem = Problem(horizon=2, weights=weights(rng), floor=floor('circle', least))
    circle = AnnulusNewton(problem, 1e-8)
    start = state(rng, problem, full_speed=False)
    tick = circle._tick(Request(start, goals(rng, problem, distance=0.3)))
    angles = np.linspace(0.0, 2.0 * np.pi, 181)
    around = np.column_stack([np.cos(angles), np.sin(angles)])
    disk = np.concatenate([size * around for size in np.linspace(least, 1.0, 4)])
    pairs = [np.stack([np.tile(one, (len(disk), 1)), disk], axis=1) for one in disk[::2]]
    known = min(costs(circle._annulus, tick.q, each).min() for each in pairs) + tick.constant
    poor = circle.local(start, np.asarray(tick.request.goals), disk[:2])
    found = circle._by_arcs(tick, circle._from(tick, NOTHING, disk[None, :2]))
    assert circle.settles(found)
    assert found.lower_bound <= known + 1e-9
    assert found.cost <= min(known, poor.cost) + 1e-6 * abs(known)
