# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Fallback trajectories without a search: straight on, to the goal, up, and turns that arrive.

A terminal constraint is linear in the headings z_k = R_k e1. Its residual is removed by Newton
steps of least norm, after each of which the speed of each heading is clipped between the least and
the full speed; headings at either limit are only turned.

Mathematics: docs/mathematics.md, 7.6.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED, carried
from orbimpc_ros.mpc.model.dynamics import adrift
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.cones import climb
from orbimpc_ros.mpc.problem.leaving import ways_out
from orbimpc_ros.mpc.problem.traffic import traffic_of

# [rad] turned over the horizon, positive towards the goal; clipped to ``max_rate``.
TURNS = (0.0, 3.0, -1.5, 1.5, 0.5, -4.0, 5.0, -6.3, 6.3)
WITHIN = 1.0 - 1e-9  # share of ``max_rate``
CORRECTIONS = 20
LARGEST = 0.5  # change of a heading in one correction
MET = 1e-10  # in units of a step's length: residual of an arrival that counts as zero
AT_LIMIT = 1e-9  # distance within which a speed counts as at its limit
SINGULAR = 1e-9
LATE = 2  # trajectories tried after the deadline: a millisecond or two each


def straight(problem: Problem, state: State, goals: Array) -> Iterator[Array]:
    """Yield R_1..R_N, shape (N, n, n), that go straight on, and straight to the goal.

    Straight on at the present speed, at the least speed of the floor, and at full speed; to the
    goal after a turn at ``max_rate``. With a tilt or glide slope also straight up, which the relief
    of these cones for states outside of them allows.

    Args:
        problem: what to solve.
        state: initial state.
        goals: g_1..g_N, shape (N, n) [m].
    """
    ahead, first = _ahead(problem, state)
    if first is not None:
        firsts = [first]
    else:
        least = float(problem.floor.least(ahead[:, 0]))
        present = float(np.linalg.norm(state.rotation[:, 0]))
        firsts = [share * ahead for share in dict.fromkeys((max(present, least), least, 1.0))]
    for each in firsts:
        yield np.tile(each, (problem.horizon, 1, 1))
    towards = goals[-1] - adrift(problem, state)[-1]
    distance = float(np.linalg.norm(towards))
    if distance > 0.0:
        axis, unit = ahead[:, 0], towards / distance
        angle = 2.0 * math.atan2(np.linalg.norm(unit - axis), np.linalg.norm(unit + axis))
        turns = np.arange(problem.horizon) + 2.0 - problem.rotation_order
        angles = np.minimum(angle, WITHIN * problem.widest_turn * turns)
        there = carried(ahead, _headings(problem, 1.0, axis, towards, angles))
        if problem.rotation_order == 2:
            there[0] = firsts[-1]
        yield there
    if problem.has_cones:
        upright = carried(ahead, climb(problem, state, goals)[1:])
        if first is not None:
            upright[0] = first
        yield upright


def turning(problem: Problem, state: State, goals: Array) -> Iterator[Array | None]:
    """Yield R_1..R_N, shape (N, n, n), that turn; obstacles are ignored.

    With hazards, escapes in all directions at the fastest turn come first, the clearest one before
    others. Then turns at the least and at full speed; with a terminal constraint at medium and at
    full speed, corrected until they satisfy it; None if a correction fails.

    Args:
        problem: what to solve.
        state: initial state.
        goals: g_1..g_N, shape (N, n) [m].
    """
    ahead, first = _ahead(problem, state)
    yield from _escaping(problem, state, ahead, first)
    least = min(1.0, float(problem.floor.least(ahead[:, 0])))
    arrives = problem.terminal == 'constraint'
    speeds = dict.fromkeys((0.5 * (1.0 + least) if arrives else least, 1.0))
    for turn in _turns(problem)[not arrives :]:  # `straight` already goes straight on
        for speed in speeds:
            towards = goals[-1] - adrift(problem, state)[-1]
            angles = turn * np.arange(1.0, problem.horizon + 1.0) / problem.horizon
            z = _headings(problem, speed, ahead[:, 0], towards, angles)
            if problem.rotation_order == 2:
                z[0] = speed * ahead[:, 0] if first is None else first[:, 0]
            met = _corrected(problem, state, goals, z) if arrives else z
            if met is None:
                yield None
                continue
            rotations = carried(ahead, met)
            if first is not None:
                rotations[0] = first
            yield rotations


def _escaping(problem: Problem, state: State, ahead: Array, first: Array | None) -> Iterator[Array]:
    """Yield R_1..R_N of escapes from hazards, the clearest one first."""
    traffic = traffic_of(problem, state) if state.hazards else None
    if traffic is None:
        return
    for headings in ways_out(problem, state, traffic):
        rotations = carried(ahead, headings[1:])
        if first is not None:
            rotations[0] = first
        yield rotations


def in_time(
    ways: Iterable[Array | None], out_of_time: Callable[[], bool] | None
) -> Iterator[Array]:
    """Yield trajectories that are not None until the deadline, then at most a few more.

    Args:
        ways: R_1..R_N or None, as from :func:`turning`.
        out_of_time: polled after each candidate; None for no deadline.
    """
    late = 0
    for way in ways:
        if way is not None:
            yield way
        late += out_of_time is not None and out_of_time()
        if late == LATE:
            return


def _ahead(problem: Problem, state: State) -> tuple[Array, Array | None]:
    """Return the rotation from which turns start, and R_1 if the state determines it."""
    if problem.rotation_order == 1:
        return state.attitude, None
    if state.coasted is not None:
        return state.coasted, None
    return state.attitude, state.rotation + problem.step * state.rotation_rate


def _turns(problem: Problem) -> list[float]:
    most = math.inf
    if problem.max_rate > 0.0:
        most = WITHIN * problem.max_rate * problem.step * problem.horizon
    return list(dict.fromkeys(min(most, max(-most, turn)) for turn in TURNS))


def _wanted(problem: Problem, state: State, goals: Array) -> Array:
    """Return the right-hand side of the terminal constraint, shape (1, n), inertial (2, n)."""
    maps = problem.maps
    place = goals[-1] - adrift(problem, state)[-1] - maps.drift[-1, 0] * state.velocity
    stopped = -maps.carried[-1, 0] * state.velocity - maps.hastened[-1, 0] * state.disturbance
    return np.array([place, stopped] if problem.inertial else [place])


def _headings(problem: Problem, speed: float, axis: Array, towards: Array, angles: Array) -> Array:
    """Return headings, shape (N, n), at angles from an axis in its plane with the goal."""
    aside = towards - axis * (axis @ towards)
    if np.linalg.norm(aside) <= HEADING_UNDEFINED * np.linalg.norm(towards):
        other = np.eye(len(axis))[np.argmin(np.abs(axis))]
        aside = other - axis * (axis @ other)
    aside = aside / np.linalg.norm(aside)
    units = np.outer(np.cos(angles), axis) + np.outer(np.sin(angles), aside)
    speeds = np.clip(problem.floor.least(units), speed, 1.0)
    return np.asarray(speeds[:, None] * units)


def _corrected(problem: Problem, state: State, goals: Array, z: Array) -> Array | None:
    """Return headings near z, shape (N, n), that arrive; None if the correction fails.

    At rotation order 2 the first heading is fixed.
    """
    z, given = z.copy(), problem.rotation_order - 1
    rows, wanted = problem.maps.arrival, _wanted(problem, state, goals)
    wanted = wanted - np.outer(rows[:, 0], state.rotation[:, 0])
    rows = rows[:, 1:]
    for _ in range(CORRECTIONS):
        missing = wanted - rows @ z
        missed = max(np.abs(missing[0]).max(), problem.step * np.abs(missing[1:]).max(initial=0.0))
        if missed <= MET * problem.length_unit:
            return z
        if given == problem.horizon or not np.isfinite(missed):
            return None
        sizes = np.linalg.norm(z, axis=1)
        units = z / np.maximum(sizes, HEADING_UNDEFINED)[:, None]
        least = problem.floor.least(units)
        bound = (sizes >= 1.0 - AT_LIMIT) | (sizes <= least + AT_LIMIT)
        change = _least_change(rows[:, given:], missing, units[given:], bound[given:])
        z[given:] += change
        sizes = np.linalg.norm(z, axis=1)[given:]
        limits = np.minimum(1.0, least[given:]), 1.0
        z[given:] *= (np.clip(sizes, *limits) / np.maximum(sizes, HEADING_UNDEFINED))[:, None]
    return None


def _least_change(rows: Array, missing: Array, units: Array, bound: np.ndarray) -> Array:
    """Return the change of headings of least norm, shape (K, n), that removes a residual.

    Args:
        rows: of the terminal constraint, shape (m, K).
        missing: the residual, shape (m, n).
        units: directions of the headings, shape (K, n).
        bound: which headings keep their speed, shape (K,).
    """
    count, n = units.shape
    free = np.eye(n) - np.einsum('k,ka,kb->kab', bound, units, units)
    matrix = np.einsum('ik,kab->iakb', rows, free).reshape(len(rows) * n, count * n)
    scale = np.repeat(np.maximum(np.abs(rows).max(axis=1), HEADING_UNDEFINED), n)
    change = np.linalg.lstsq(matrix / scale[:, None], missing.ravel() / scale, SINGULAR)[0]
    change = change.reshape(count, n)
    return change * min(1.0, LARGEST / np.abs(change).max(initial=LARGEST))
