# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Fallback trajectories without a search: straight on, to the goal, up, and turns that arrive.

Mathematics: docs/mathematics.md, 7.6.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import holds
from orbimpc_ros.mpc.geometry.rotations import carried, coordinates
from orbimpc_ros.mpc.model.dynamics import adrift
from orbimpc_ros.mpc.plan import UNPROVED, assemble
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.cones import climb
from orbimpc_ros.mpc.problem.reach import entry_speed, moved_towards
from orbimpc_ros.mpc.problem.traffic import escapes, traffic_of, ways_out
from orbimpc_ros.mpc.solve.arrivals import WITHIN, Begun, arc_of, flown, least_arriving
from orbimpc_ros.mpc.solve.request import Request

# [rad] turned over the horizon, positive towards the goal; clipped to the widest turns.
TURNS = (0.0, 3.0, -1.5, 1.5, 0.5, -4.0, 5.0, -6.3, 6.3)
LATE, EACH = 8, 4  # corrections of an arc after the deadline; a trajectory takes as long as EACH


def straight(problem: Problem, state: State, goals: Array) -> Iterator[Array]:
    """Yield coordinates of R_1..R_N, shape (N, d), that go straight on, and straight to the goal.

    Straight on at the present speed, at the least speed of the floor, and at full speed; with a
    terminal constraint the least headings that arrive; to the goal after a turn at ``max_rate``.
    With a tilt or glide slope also straight up, which the relief of these cones for states outside
    of them allows.

    Args:
        problem: what to solve.
        state: initial state.
        goals: g_1..g_N, shape (N, n) [m].
    """
    ahead, first = _begun(problem, state)
    least = float(problem.floor.least(ahead[:, 0]))
    present = float(np.linalg.norm(state.rotation[:, 0]))
    if first is not None:
        yield coordinates(np.tile(first, (problem.horizon, 1, 1)))
    else:
        for share in dict.fromkeys((max(present, least), least, 1.0)):
            yield _along(problem, state, np.tile(share * ahead[:, 0], (problem.horizon, 1)))
        if problem.terminal == 'constraint':
            yield _along(problem, state, least_arriving(problem, state, goals))
    towards = goals[-1] - adrift(problem, state)
    distance = float(np.linalg.norm(towards))
    if distance > 0.0:
        there = escapes(problem, state, towards[None] / distance)[0, 1:]
        yield _along(problem, state, there)
    if problem.has_cones:
        yield _along(problem, state, climb(problem, state, goals)[1:])


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
    begun = ahead, _ = _begun(problem, state)
    traffic = traffic_of(problem, state) if state.hazards else None
    for headings in () if traffic is None else ways_out(problem, state, traffic):
        yield _along(problem, state, headings[1:])
    least = min(1.0, float(problem.floor.least(ahead[:, 0])))
    arrives = problem.terminal == 'constraint'
    speeds = dict.fromkeys((0.5 * (1.0 + least) if arrives else least, 1.0))
    towards = goals[-1] - adrift(problem, state)
    most = WITHIN * problem.widest_turn * problem.horizon
    turns = list(dict.fromkeys(np.clip(TURNS, -most, most).tolist()))
    for turn in turns[not arrives :]:  # `straight` already goes straight on
        for speed in speeds:
            arc = arc_of(problem, begun, towards, speed, turn)
            for met in flown(problem, state, goals, arc):
                yield None if met is None else _along(problem, state, met)


def sound(
    problem: Problem, request: Request, candidates: Iterable[Array | None]
) -> Iterator[tuple[float, Array]]:
    """Yield the costs and the coordinates of the candidates that pass the check of plans."""
    posed = problem, request.state, request.goals
    for x in candidates:
        if x is not None:
            plan = assemble(*posed, x, projection='thrust_aligned', proof=UNPROVED)
            if holds(*posed, plan):
                yield plan.objective, x


def in_time(
    candidates: Iterable[Array | None], out_of_time: Callable[[], bool] | None
) -> Iterator[Array]:
    """Yield trajectories that are not None until the deadline, then for a few milliseconds.

    Args:
        candidates: coordinates or None, as from :func:`turning`.
        out_of_time: polled after each of them; None for no deadline.
    """
    late = 0
    for candidate in candidates:
        if candidate is not None:
            yield candidate
        if out_of_time is not None and out_of_time():
            late += 1 if candidate is None else EACH
        if late >= LATE:
            return


def _begun(problem: Problem, state: State) -> Begun:
    """Return the rotation from which turns start, and R_1 if the state determines it."""
    if problem.rotation_order == 1:
        return state.attitude, None
    if state.coasted is not None:
        return state.coasted, None
    return state.attitude, state.rotation + problem.step * state.rotation_rate


def _along(problem: Problem, state: State, headings: Array) -> Array:
    """Return the coordinates of rotations turned onto headings, (N, n); a given R_1 is kept.

    Speeds change from the entry speed on as fast as ``max_acceleration`` allows.
    """
    ahead, first = _begun(problem, state)
    if problem.max_acceleration:
        headings, speed = headings.copy(), entry_speed(problem, state)
        for heading in headings:
            size = float(np.linalg.norm(heading))
            speed = moved_towards(problem, speed, size)
            heading[:] = speed * (heading / size if size else ahead[:, 0])
    rotations = carried(ahead, headings)
    if first is not None:
        rotations[0] = first
    return coordinates(rotations)
