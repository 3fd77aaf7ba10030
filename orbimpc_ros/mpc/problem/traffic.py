# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Balls and moving obstacles over the steps of a plan, and escapes from them.

Within a step a body is modelled as moving uniformly between its places at both ends, and enlarged
by the deviation of its track from that.

A vehicle that was pushed inside of the margin around a body, or that cannot avoid entering it, must
not be left without a plan: it needs one the most. Clearances are then relaxed to those of an
*escape*, a rollout at full thrust that turns to a direction as fast as possible: in no step may a
plan be farther inside. Of all directions the escape takes the one that leaves the bodies soonest.
If none does within the horizon, nothing is relaxed: an enclosed vehicle has no plan.

Mathematics: docs/mathematics.md, 3.7.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.separation import separation
from orbimpc_ros.mpc.problem.cones import begun, turned_towards
from orbimpc_ros.mpc.problem.obstacle import Ball, Box, MovingObstacle, reserves
from orbimpc_ros.mpc.problem.problem import Problem, State

DIRECTIONS = 16  # number of escapes in the plane
INSIDE = 1e-7  # in units of a step's length: a plan that starts deeper than this starts inside
SPARE = 1e-3  # slack beyond the depth of the escape, in units of a step's length


class Traffic(NamedTuple):
    """Balls and moving obstacles, which plans stay clear of throughout every step.

    Attributes:
        names: of the J bodies: ``obstacle 0`` (its index among the obstacles), ``hazard 0``.
        bodies: shapes and places at the start of the plan.
        shifts: displacement of each at times 0, h, .., N h, shape (J, N + 1, n) [m].
        strays: largest deviation of each from uniform motion in each step, shape (J, N) [m].
        kept: margin around each in each step, shape (J, N) [m].
        eased: depth inside of each that a plan is allowed in each step, shape (J, N) [m].
    """

    names: tuple[str, ...]
    bodies: tuple[Box | Ball, ...]
    shifts: Array
    strays: Array
    kept: Array
    eased: Array

    @property
    def grown(self) -> Array:
        """Return the total by which each body is enlarged in each step, shape (J, N) [m]."""
        return self.strays + self.kept - self.eased


def traffic_of(problem: Problem, state: State) -> Traffic | None:
    """Return the balls and moving obstacles, cached per state; None if there are none."""
    return state.once(problem, lambda: _met(problem, state))


def _met(problem: Problem, state: State) -> Traffic | None:
    balls = {f'obstacle {i}': each for i, each in enumerate(problem.obstacles)}
    still = {name: each for name, each in balls.items() if isinstance(each, Ball)}
    if not still and not state.hazards:
        return None
    ends = problem.step * np.arange(problem.horizon + 1)
    count = len(still)
    names = (*still, *(f'hazard {i}' for i in range(len(state.hazards))))
    bodies = (*still.values(), *(each.body for each in state.hazards))
    shifts = np.zeros((len(bodies), len(ends), problem.dimension))
    strays, kept, eased = np.zeros((3, len(bodies), problem.horizon))
    for j, each in enumerate(state.hazards, start=count):
        shifts[j], strays[j] = each.moved(ends), _strays(each, ends)
    kept[count:] = reserves(state.hazards, problem.horizon, problem.step)
    met = Traffic(names, bodies, shifts, strays, kept, eased)
    return met._replace(eased=_eased(problem, state, met))


def _strays(hazard: MovingObstacle, ends: Array) -> Array:
    """Return the largest deviation of a track from uniform motion in each step, shape (N,) [m]."""
    strays, inside = np.zeros(len(ends) - 1), hazard.turns[hazard.turns < ends[-1]]
    if not len(inside):
        return strays
    at = np.searchsorted(ends, inside, side='right') - 1
    moved = hazard.moved(ends)
    share = (inside - ends[at]) / (ends[at + 1] - ends[at])
    even = moved[at] + share[:, None] * (moved[at + 1] - moved[at])
    np.maximum.at(strays, at, np.linalg.norm(hazard.moved(inside) - even, axis=-1))
    return strays


# --- escapes


def _eased(problem: Problem, state: State, traffic: Traffic) -> Array:
    """Return the depths inside of bodies that each step of a plan is allowed, shape (J, N) [m].

    A vehicle that enters only the margin of a body has to stay outside of the body itself.
    """
    eased, nothing = np.zeros_like(traffic.kept), INSIDE * problem.maps.unit
    deep = _decided_depths(problem, state, traffic)
    at = [0, *range(deep.shape[1] - 1)]  # the margin at the start is that of the first step
    held = np.asarray((deep + traffic.grown[:, at] > nothing).any(axis=1))
    if not held.any():
        return eased
    every = np.maximum(_depths(problem, state, traffic, directions(problem.dimension)), 0.0)
    best = min(every, key=lambda each: _price(each, held))
    if (best[held, -1] > 0.0).any():
        return eased
    eased[held] = np.where(best[held] > 0.0, best[held] + SPARE * problem.maps.unit, 0.0)
    deep[:, 1:] -= traffic.strays[:, at[1:]]
    entered = (deep > nothing).any(axis=1)
    eased[~entered] = np.minimum(eased, traffic.grown)[~entered]
    return eased


def _decided_depths(problem: Problem, state: State, traffic: Traffic) -> Array:
    """Return how deep the K steps that the state decides are inside of bodies, (J, 1 + K) [m].

    The first column is of the start; the others are -inf for bodies that are out of reach.
    """
    here, decided = state.position[None], problem.decided_steps
    deep = np.full((len(traffic.bodies), 1 + decided), -np.inf)
    deep[:, 0] = [float(body.depth(here)[0]) for body in traffic.bodies]
    if not decided:
        return deep
    driving = [state.rotation[:, 0], state.velocity, state.disturbance]
    reached = np.linalg.norm(problem.maps.started[:decided] @ driving, axis=-1).max()
    farthest = np.linalg.norm(traffic.shifts[:, : decided + 1], axis=2).max(axis=1)
    widest = traffic.grown[:, :decided].max(axis=1)
    near = deep[:, 0] + widest + farthest + reached > 0.0
    if near.any():
        (depths,) = _depths(problem, state, traffic, directions(problem.dimension)[:1])  # any
        deep[near, 1:] = (depths - traffic.grown)[near, :decided]
    return deep


def _depths(problem: Problem, state: State, traffic: Traffic, units: Array) -> Array:
    """Return depths inside of grown bodies, (A, J, N), of escapes in directions, (A, n)."""
    headings, maps = escapes(problem, state, units)[:, None], problem.maps
    coasted = maps.started @ [state.rotation[:, 0], state.velocity, state.disturbance]
    points = coasted + maps.controls @ headings[:, :, 1:] + state.position
    weights = np.linspace(0.0, 1.0, points.shape[2])[:, None]
    begin, end = traffic.shifts[:, :-1, None], traffic.shifts[:, 1:, None]
    away = points - (begin + weights * (end - begin))[:, None]  # (J, A, N, m, n)
    outside = np.array([_outside(*each) for each in zip(traffic.bodies, away, strict=True)])
    return np.asarray(traffic.grown - np.moveaxis(outside, 0, 1))


def ways_out(problem: Problem, state: State, traffic: Traffic) -> Array:
    """Return escapes in all directions, shape (A, N + 1, n), in order of depth within steps."""
    units = directions(problem.dimension)
    deep = np.maximum(_depths(problem, state, traffic, units), 0.0).sum(axis=(1, 2))
    return escapes(problem, state, units)[np.argsort(deep, kind='stable')]


def escapes(problem: Problem, state: State, units: Array) -> Array:
    """Return R_0 e1..R_N e1 of escapes in directions, shape (A, n): shape (A, N + 1, n).

    Headings that the state does not decide turn there as by :func:`turned_towards`.
    """
    decided, pointing = begun(problem, state)
    headings = np.empty((len(units), problem.horizon + 1, problem.dimension))
    headings[:, : len(decided)] = decided
    steps = np.arange(1.0, problem.horizon + 2 - len(decided))
    headings[:, len(decided) :] = turned_towards(problem, pointing, units, steps)
    return headings


def _outside(body: Box | Ball, points: Array) -> Array:
    """Return how far points, (..., m, n), are beyond the plane that parts them most from a body."""
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
