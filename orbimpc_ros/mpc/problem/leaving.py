# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Escapes of a vehicle that is inside of a body or of the margin around it.

A vehicle that was pushed inside of the margin around a body, or that cannot avoid entering it, must
not be left without a plan: it needs one the most. Clearances are then relaxed to those of an
*escape*, a rollout at full thrust that turns to a direction as fast as possible: in no step may a
plan be farther inside. Of all directions the escape takes the one that leaves the bodies soonest.
If none does within the horizon, nothing is relaxed: an enclosed vehicle has no plan.

Mathematics: docs/mathematics.md, 3.7.
"""

from __future__ import annotations

import math

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.separation import separation
from orbimpc_ros.mpc.model.dynamics import control_maps, decided
from orbimpc_ros.mpc.problem.cones import begun, turned_towards
from orbimpc_ros.mpc.problem.obstacle import Ball, Box, Traffic
from orbimpc_ros.mpc.problem.problem import Problem
from orbimpc_ros.mpc.problem.state import State

DIRECTIONS = 16  # number of escapes in the plane
INSIDE = 1e-7  # in units of a step's length: a plan that starts deeper than this starts inside
SPARE = 1e-3  # slack beyond the depth of the escape, in units of a step's length


def inside(problem: Problem, state: State, traffic: Traffic) -> Array:
    """Return the depths inside of bodies that each step of a plan is allowed, shape (J, N) [m].

    A vehicle that enters only the margin of a body has to stay outside of the body itself.

    Args:
        problem: gives the model and its limits.
        state: where the plan starts.
        traffic: the bodies, not relaxed yet.
    """
    here, unit = state.position[None], problem.length_unit
    depth = np.array([float(body.depth(here)[0]) for body in traffic.bodies])
    eased = _eased(problem, state, traffic, depth)
    if eased.any():
        bare = traffic._replace(strays=-traffic.strays, kept=np.zeros_like(traffic.kept))
        met = (depth > INSIDE * unit) | _bound_to_enter(problem, state, bare, depth)
        eased[~met] = np.minimum(eased, traffic.grown)[~met]
    return eased


def _eased(problem: Problem, state: State, traffic: Traffic, depth: Array) -> Array:
    """Return the depths inside of the grown bodies that the escape needs, shape (J, N) [m]."""
    allowed, unit = np.zeros_like(traffic.kept), problem.length_unit
    depth = depth + traffic.grown[:, 0]
    held = (depth > INSIDE * unit) | _bound_to_enter(problem, state, traffic, depth)
    if not held.any():
        return allowed
    every = _depths(problem, state, traffic, directions(problem.dimension))
    best = min(every, key=lambda each: _price(each, held))
    if (best[held, -1] > 0.0).any():
        return allowed
    allowed[held] = np.where(best[held] > 0.0, best[held] + SPARE * unit, 0.0)
    return allowed


def _bound_to_enter(problem: Problem, state: State, traffic: Traffic, depth: Array) -> np.ndarray:
    """Return which bodies every plan enters in the steps that the state decides, shape (J,)."""
    known, unit = problem.decided_steps, problem.length_unit
    if not known:
        return np.zeros(len(depth), dtype=bool)
    reached = decided(problem, state)[0][: known + 1] - state.position
    ways = np.linalg.norm(traffic.shifts[:, : known + 1], axis=2).max(axis=1)
    near = depth + ways + known * unit + np.linalg.norm(reached, axis=1).max() > 0.0
    if not near.any():
        return np.asarray(near)
    (depths,) = _depths(problem, state, traffic, directions(problem.dimension)[:1])  # any of them
    return np.asarray(near & (depths[:, :known] > INSIDE * unit).any(axis=1))


def _depths(problem: Problem, state: State, traffic: Traffic, ways: Array) -> Array:
    """Return depths inside of bodies, (A, J, N), of escapes in directions, (A, n); 0 outside."""
    headings = escapes(problem, state, ways)[:, None]
    reach, started = control_maps(problem)
    coasted = started @ [state.rotation[:, 0], state.velocity, state.disturbance]
    points = coasted + reach @ headings[:, :, 1:] + state.position
    weights = np.linspace(0.0, 1.0, points.shape[2])[:, None]
    begin, end = traffic.shifts[:, :-1, None], traffic.shifts[:, 1:, None]
    away = points - (begin + weights * (end - begin))[:, None]  # (J, A, N, m, n)
    outside = np.array([_outside(*each) for each in zip(traffic.bodies, away, strict=True)])
    return np.maximum(traffic.grown - np.moveaxis(outside, 0, 1), 0.0)


def ways_out(problem: Problem, state: State, traffic: Traffic) -> Array:
    """Return escapes in all directions, shape (A, N + 1, n), in order of depth within steps.

    Args:
        problem: gives the model and its limits.
        state: where the plan starts.
        traffic: the bodies to stay clear of.
    """
    ways = directions(problem.dimension)
    deep = _depths(problem, state, traffic, ways).sum(axis=(1, 2))
    return escapes(problem, state, ways)[np.argsort(deep, kind='stable')]


def escapes(problem: Problem, state: State, ways: Array) -> Array:
    """Return R_0 e1..R_N e1 of escapes in directions, shape (A, n): shape (A, N + 1, n).

    Headings that the state does not decide turn there as by :func:`turned_towards`.
    """
    given, pointing = begun(problem, state)
    found = np.empty((len(ways), problem.horizon + 1, problem.dimension))
    found[:, : len(given)] = given
    steps = np.arange(1.0, problem.horizon + 2 - len(given))
    found[:, len(given) :] = turned_towards(problem, pointing, ways, steps)
    return found


def _outside(body: Box | Ball, points: Array) -> Array:
    """Return how far control points of steps, (..., m, n), are beyond one plane, shape (...,)."""
    if isinstance(body, Ball):
        return np.asarray(separation(points - body.centre)[1] - body.radius)
    beyond = body.clearances(points.reshape(-1, points.shape[-1]))
    return np.asarray(beyond.reshape(*points.shape[:-1], -1).min(axis=-2).max(axis=-1))


def _price(depths: Array, held: np.ndarray) -> tuple[float, int, float]:
    """Return the sort key of an escape: depth in other bodies, number of steps inside, depth."""
    steps = int((depths[held] > 0.0).any(axis=0).sum())
    return float(depths[~held].sum()), steps, float(depths[held].sum())


def directions(n: int) -> Array:
    """Return unit vectors in all directions, shape (A, n)."""
    if n == 2:
        angles = 2.0 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS
        return np.column_stack([np.cos(angles), np.sin(angles)])
    grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    around = grid[np.abs(grid).any(axis=1)]
    return np.asarray(around / np.linalg.norm(around, axis=1, keepdims=True))
