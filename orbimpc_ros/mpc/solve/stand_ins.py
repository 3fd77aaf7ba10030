# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Fallback trajectories without a search: straight on, to the goal, up, and turns that arrive.

Mathematics: docs/mathematics.md, 7.6.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import holds
from orbimpc_ros.mpc.geometry.rotations import aside_of, carried, coordinates
from orbimpc_ros.mpc.model.dynamics import adrift
from orbimpc_ros.mpc.plan import UNPROVED, assemble
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.cones import climb
from orbimpc_ros.mpc.problem.traffic import traffic_of, ways_out
from orbimpc_ros.mpc.solve.arrivals import WITHIN, arc_of, arriving
from orbimpc_ros.mpc.solve.request import Request

# [rad] turned over the horizon, positive towards the goal; clipped to ``max_rate``.
TURNS = (0.0, 3.0, -1.5, 1.5, 0.5, -4.0, 5.0, -6.3, 6.3)
LATE, EACH = 8, 4  # corrections of an arc after the deadline; a trajectory takes as long as EACH


def straight(problem: Problem, state: State, goals: Array) -> Iterator[Array]:
    """Yield coordinates of R_1..R_N, shape (N, d), that go straight on, and straight to the goal.

    Straight on at the present speed, at the least speed of the floor, and at full speed; to the
    goal after a turn at ``max_rate``. With a tilt or glide slope also straight up, which the relief
    of these cones for states outside of them allows.

    Args:
        problem: what to solve.
        state: initial state.
        goals: g_1..g_N, shape (N, n) [m].
    """
    begun = ahead, first = _begun(problem, state)
    least = float(problem.floor.least(ahead[:, 0]))
    present = float(np.linalg.norm(state.rotation[:, 0]))
    shares = dict.fromkeys((max(present, least), least, 1.0))
    for each in [share * ahead for share in shares] if first is None else [first]:
        yield coordinates(np.tile(each, (problem.horizon, 1, 1)))
    towards = goals[-1] - adrift(problem, state)[-1]
    distance = float(np.linalg.norm(towards))
    if distance > 0.0:
        axis, unit = ahead[:, 0], towards / distance
        angle = 2.0 * math.atan2(np.linalg.norm(unit - axis), np.linalg.norm(unit + axis))
        turns = np.arange(problem.horizon) + 2.0 - problem.rotation_order
        angles = np.minimum(angle, WITHIN * problem.widest_turn * turns)
        yield _along(begun, _headings(problem, 1.0, axis, towards, angles))
    if problem.has_cones:
        yield _along(begun, climb(problem, state, goals)[1:])


def turning(problem: Problem, state: State, goals: Array) -> Iterator[Array | None]:
    """Yield coordinates of R_1..R_N, shape (N, d), that turn; obstacles are ignored.

    With hazards, escapes in all directions at the fastest turn come first, the clearest one before
    others. Then turns at the least and at full speed; with a terminal constraint at medium and at
    full speed, corrected until they satisfy it; None before each correction.

    Args:
        problem: what to solve.
        state: initial state.
        goals: g_1..g_N, shape (N, n) [m].
    """
    begun = ahead, first = _begun(problem, state)
    traffic = traffic_of(problem, state) if state.hazards else None
    for headings in () if traffic is None else ways_out(problem, state, traffic):
        yield _along(begun, headings[1:])
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
            ways: Iterable[Array | None] = [z]
            if arrives:
                ways = arriving(problem, state, goals, arc_of(problem, ahead, z, towards, turn))
            for met in ways:
                yield None if met is None else _along(begun, met)


def sound(
    problem: Problem, request: Request, ways: Iterable[Array | None]
) -> Iterator[tuple[float, Array]]:
    """Yield the costs and the coordinates of those of the ways that pass the check of plans."""
    known = problem, request.state, request.goals
    for x in ways:
        if x is not None:
            plan = assemble(*known, x, projection='thrust_aligned', proof=UNPROVED)
            if holds(*known, plan):
                yield plan.objective, x


def in_time(
    ways: Iterable[Array | None], out_of_time: Callable[[], bool] | None
) -> Iterator[Array]:
    """Yield trajectories that are not None until the deadline, then for a few milliseconds.

    Args:
        ways: coordinates or None, as from :func:`turning`.
        out_of_time: polled after each of them; None for no deadline.
    """
    late = 0
    for way in ways:
        if way is not None:
            yield way
        if out_of_time is not None and out_of_time():
            late += 1 if way is None else EACH
        if late >= LATE:
            return


def _begun(problem: Problem, state: State) -> tuple[Array, Array | None]:
    """Return the rotation from which turns start, and R_1 if the state determines it."""
    if problem.rotation_order == 1:
        return state.attitude, None
    if state.coasted is not None:
        return state.coasted, None
    return state.attitude, state.rotation + problem.step * state.rotation_rate


def _along(begun: tuple[Array, Array | None], headings: Array) -> Array:
    """Return the coordinates of rotations turned onto headings, shape (N, n), but a given R_1."""
    ahead, first = begun
    rotations = carried(ahead, headings)
    if first is not None:
        rotations[0] = first
    return coordinates(rotations)


def _turns(problem: Problem) -> list[float]:
    most = math.inf
    if problem.max_rate > 0.0:
        most = WITHIN * problem.max_rate * problem.step * problem.horizon
    return list(dict.fromkeys(min(most, max(-most, turn)) for turn in TURNS))


def _headings(problem: Problem, speed: float, axis: Array, towards: Array, angles: Array) -> Array:
    """Return headings, shape (N, n), at angles from an axis in its plane with the goal."""
    aside = aside_of(axis, towards)
    units = np.outer(np.cos(angles), axis) + np.outer(np.sin(angles), aside)
    speeds = np.clip(problem.floor.least(units), speed, 1.0)
    return np.asarray(speeds[:, None] * units)
