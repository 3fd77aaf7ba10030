# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Distances of a plan from balls and from what moves, at all times: for the check of plans.

Nothing of how plans are found enters: the motion within steps is followed along short chords, each
against the body as its track has it, and the closest approach of the two is worked out; a box is
passed in each step on the outside of one face.

Mathematics: docs/mathematics.md, 6.2.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Ball, Box, MovingObstacle, Problem, State
from orbimpc_ros.mpc.problem.obstacle import moved_together, simultaneous
from orbimpc_ros.mpc.problem.traffic import traffic_of

PIECES = 16  # of a step that is curved


def clearances(problem: Problem, state: State, plan: Plan) -> dict[str, float]:
    """Return how far a plan stays outside of every body that is round or moves, < 0 inside [m].

    Args:
        problem: gives the balls among its obstacles.
        state: gives the hazards, and how far inside of a body it lets a plan begin.
        plan: gives positions and velocities.
    """
    traffic = traffic_of(problem, state)
    if traffic is None:
        return {}
    standing, count = np.zeros(problem.dimension), len(traffic.bodies) - len(state.hazards)
    still = [MovingObstacle.drifting(body, standing) for body in traffic.bodies[:count]]
    every = [*still, *state.hazards]
    found = np.empty(len(every))
    for group in simultaneous(every):
        # Who is only where a body is taken to stray is outside of it, and has to stay so.
        inside = np.maximum(traffic.eased[group] - traffic.strays[group], 0.0)
        eased = inside - traffic.kept[group]
        found[group] = _apart([every[j] for j in group], eased, problem, plan)
    return dict(zip(traffic.names, found.tolist(), strict=True))


def _apart(hazards: Sequence[MovingObstacle], eased: Array, problem: Problem, plan: Plan) -> Array:
    """Return how far simultaneous hazards, eased by shape (J, N), are stayed clear of, (J,) [m]."""
    times = _instants(problem, plan, hazards[0])
    away = _positions(problem, plan, times) - moved_together(hazards, times)
    step = np.minimum((0.5 * (times[1:] + times[:-1]) / problem.step).astype(int), plan.horizon - 1)
    first = np.searchsorted(step, np.arange(plan.horizon))
    apart = np.empty((len(hazards), plan.horizon))
    balls = {j: each.body for j, each in enumerate(hazards) if isinstance(each.body, Ball)}
    if balls:
        nearest = _beyond_balls(list(balls.values()), away[list(balls)])
        apart[list(balls)] = np.minimum.reduceat(nearest, first, axis=1)
    for j, each in enumerate(hazards):
        if isinstance(each.body, Box):
            apart[j] = _beyond_a_face(each.body.clearances(away[j]), first)
    return np.asarray((apart + eased).min(axis=1))


def _instants(problem: Problem, plan: Plan, hazard: MovingObstacle) -> Array:
    """Return the instants between which both move along chords, shape (M,) [s]."""
    pieces = 1 if problem.translation.degree == 1 else PIECES
    end = plan.horizon * problem.step
    turns = hazard.turns[hazard.turns < end]
    return np.union1d(np.linspace(0.0, end, pieces * plan.horizon + 1), turns)


def _positions(problem: Problem, plan: Plan, times: Array) -> Array:
    """Return where the vehicle is at times, shape (M,) [s], shape (M, n) [m].

    Between the ends of a step that is the polynomial (Hermite's) that meets both, leaves the first
    with its velocity and, if its degree is 3, arrives at the second with its own.
    """
    h = problem.step
    k = np.minimum((times / h).astype(int), plan.horizon - 1)
    share = (times / h - k)[:, None]
    begin, way = plan.positions[k], plan.positions[k + 1] - plan.positions[k]
    if problem.translation.degree == 1:
        return np.asarray(begin + share * way)
    leaving, arriving = h * plan.velocities[k], h * plan.velocities[k + 1]
    bent = way - leaving
    if problem.translation.degree == 2:
        return np.asarray(begin + share * leaving + share**2 * bent)
    cubic = arriving - leaving - 2.0 * bent
    return np.asarray(begin + share * leaving + share**2 * (bent - cubic) + share**3 * cubic)


def _beyond_balls(balls: Sequence[Ball], away: Array) -> Array:
    """Return how far chords, (J, M + 1, n) end to end, stay outside of balls, shape (J, M) [m]."""
    centres = np.array([each.centre for each in balls])
    begin, way = away[:, :-1] - centres[:, None], np.diff(away, axis=1)
    squared = np.maximum((way * way).sum(axis=-1), np.finfo(float).tiny)
    share = np.clip(-(begin * way).sum(axis=-1) / squared, 0.0, 1.0)
    nearest = np.linalg.norm(begin + share[..., None] * way, axis=-1)
    return np.asarray(nearest - np.array([[each.radius] for each in balls]))


def _beyond_a_face(each: Array, first: np.ndarray) -> Array:
    """Return how far beyond one and the same face all of each step is, shape (N,) [m].

    Args:
        each: clearances of all faces at instants, shape (M + 1, 2 n).
        first: at which instants steps begin, shape (N,).
    """
    begun = np.minimum.reduceat(each[:-1], first)
    ended = each[np.append(first[1:], len(each) - 1)]
    return np.asarray(np.minimum(begun, ended).max(axis=1))
