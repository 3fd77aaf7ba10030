# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Distances of a plan from balls and moving obstacles at all times, for the check of plans.

They use no result of the search: the motion within a step is divided into short chords, and the
closest approach of each to the body on its track is computed; a box must be passed on the outside
of one face in each step.

Mathematics: docs/mathematics.md, 6.2.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Ball, Box, Problem, State
from orbimpc_ros.mpc.problem.traffic import Traffic, traffic_of

PIECES = 16  # chords per curved step


def clearances(problem: Problem, state: State, plan: Plan) -> dict[str, float]:
    """Return a plan's least distances from all balls and moving obstacles, < 0 inside [m]."""
    traffic = traffic_of(problem, state)
    if traffic is None:
        return {}
    times = _instants(problem, state, plan)
    tracks = np.zeros((len(traffic.bodies), len(times), problem.dimension))
    for j, hazard in enumerate(state.hazards, start=len(tracks) - len(state.hazards)):
        tracks[j] = hazard.moved(times)
    # A plan within the allowance for strays is still outside of the body, and has to stay there.
    eased = np.maximum(traffic.eased - traffic.strays, 0.0) - traffic.kept
    apart = _apart(problem, plan, traffic, _positions(problem, plan, times) - tracks, times)
    return dict(zip(traffic.names, (apart + eased).min(axis=1).tolist(), strict=True))


def _apart(problem: Problem, plan: Plan, traffic: Traffic, away: Array, times: Array) -> Array:
    """Return each step's distances from bodies, (J, N) [m], given offsets from them at times."""
    step = np.minimum((0.5 * (times[1:] + times[:-1]) / problem.step).astype(int), plan.horizon - 1)
    first = np.searchsorted(step, np.arange(plan.horizon))
    apart = np.empty((len(away), plan.horizon))
    balls = {j: each for j, each in enumerate(traffic.bodies) if isinstance(each, Ball)}
    if balls:
        nearest = _beyond_balls(list(balls.values()), away[list(balls)])
        apart[list(balls)] = np.minimum.reduceat(nearest, first, axis=1)
    for j, each in enumerate(traffic.bodies):
        if isinstance(each, Box):
            apart[j] = _beyond_a_face(each.clearances(away[j]), first)
    return apart


def _instants(problem: Problem, state: State, plan: Plan) -> Array:
    """Return the times between which vehicle and bodies move along chords, shape (M,) [s]."""
    pieces = 1 if problem.translation.degree == 1 else PIECES
    end = plan.horizon * problem.step
    turns = np.concatenate([[], *(each.turns for each in state.hazards)])
    return np.union1d(np.linspace(0.0, end, pieces * plan.horizon + 1), turns[turns < end])


def _positions(problem: Problem, plan: Plan, times: Array) -> Array:
    """Return the vehicle's positions, shape (M, n) [m], at times, shape (M,) [s].

    Within a step it moves along the Hermite polynomial through both ends with the velocity at the
    first and, if the degree is 3, that at the second.
    """
    h = problem.step
    k = np.minimum((times / h).astype(int), plan.horizon - 1)
    share = (times / h - k)[:, None]
    begin, way = plan.positions[k], plan.positions[k + 1] - plan.positions[k]
    degree, leaving = problem.translation.degree, way
    if degree > 1:
        leaving = h * plan.velocities[k]
    bent, cubic = way - leaving, 0.0
    if degree > 2:
        cubic = h * plan.velocities[k + 1] - leaving - 2.0 * bent
    return np.asarray(begin + share * leaving + share**2 * (bent - cubic) + share**3 * cubic)


def _beyond_balls(balls: Sequence[Ball], away: Array) -> Array:
    """Return distances from balls, shape (J, M) [m], of polylines, shape (J, M + 1, n)."""
    centres = np.array([each.centre for each in balls])
    begin, way = away[:, :-1] - centres[:, None], np.diff(away, axis=1)
    squared = np.maximum((way * way).sum(axis=-1), np.finfo(float).tiny)
    share = np.clip(-(begin * way).sum(axis=-1) / squared, 0.0, 1.0)
    nearest = np.linalg.norm(begin + share[..., None] * way, axis=-1)
    return np.asarray(nearest - np.array([[each.radius] for each in balls]))


def _beyond_a_face(beyond: Array, first: np.ndarray) -> Array:
    """Return the largest distance beyond a face that holds throughout a step, shape (N,) [m].

    ``beyond`` has a row per instant, (M + 1, 2 n); steps begin at the rows ``first``, shape (N,).
    """
    begun = np.minimum.reduceat(beyond[:-1], first)
    ended = beyond[np.append(first[1:], len(beyond) - 1)]
    return np.asarray(np.minimum(begun, ended).max(axis=1))
