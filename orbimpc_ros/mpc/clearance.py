"""Distances of a plan from balls and from what moves, at all times: for the check of plans.

Nothing of how plans are found enters: the motion within steps is followed along short chords, each
against the body as its track has it, and the closest approach of the two is worked out.

Mathematics: docs/mathematics.md, 6.2.
"""

from __future__ import annotations

import itertools

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Ball, Box, Hazard, Problem, State
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
    standing = np.zeros(problem.dimension)
    found = {}
    moving = {f'hazard {i}': each for i, each in enumerate(state.hazards)}
    for name, body, eased in zip(traffic.names, traffic.bodies, traffic.eased, strict=True):
        hazard = moving.get(name) or Hazard.drifting(body, standing)
        found[name] = _clearance(problem, plan, hazard, eased)
    return found


def _clearance(problem: Problem, plan: Plan, hazard: Hazard, eased: Array) -> float:
    times = _instants(problem, plan, hazard)
    away = _positions(problem, plan, times) - hazard.moved(times)
    step = np.minimum((0.5 * (times[1:] + times[:-1]) / problem.step).astype(int), plan.horizon - 1)
    apart = _apart(hazard.body, away[:-1], away[1:])
    return float((apart + eased[step]).min())


def _instants(problem: Problem, plan: Plan, hazard: Hazard) -> Array:
    """Return the instants between which both move along chords, shape (M,) [s]."""
    pieces = 1 if problem.translation.degree == 1 else PIECES
    end = plan.horizon * problem.step
    turns = hazard.times[(hazard.times > 0.0) & (hazard.times < end)]
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


def _apart(body: Box | Ball, begin: Array, end: Array) -> Array:
    """Return how far chords, from (M, n) to (M, n), stay outside of a body, shape (M,) [m]."""
    if isinstance(body, Box):
        return _beyond_faces(body.clearances(begin), body.clearances(end))
    begin, way = begin - body.centre, end - begin
    squared = np.maximum((way * way).sum(axis=1), np.finfo(float).tiny)
    share = np.clip(-(begin * way).sum(axis=1) / squared, 0.0, 1.0)
    return np.asarray(np.linalg.norm(begin + share[:, None] * way, axis=1) - body.radius)


def _beyond_faces(begin: Array, end: Array) -> Array:
    """Return the least of the largest of clearances, shape (M, 2 n), that change evenly.

    It is at an end, or where two of them are equal.
    """
    shares = [np.zeros(len(begin)), np.ones(len(begin))]
    for i, j in itertools.combinations(range(begin.shape[1]), 2):
        first, last = begin[:, i] - begin[:, j], end[:, i] - end[:, j]
        change = np.where(first != last, first - last, np.inf)
        shares.append(np.clip(first / change, 0.0, 1.0))
    each = np.array(shares)[:, :, None]
    outside = (begin + each * (end - begin)).max(axis=2)
    return np.asarray(outside.min(axis=0))
