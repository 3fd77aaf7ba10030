# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Balls and moving obstacles over the steps of a plan.

Within a step a body is modelled as moving uniformly between its places at both ends, and enlarged
by the deviation of its track from that.

Mathematics: docs/mathematics.md, 3.7.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem.leaving import inside
from orbimpc_ros.mpc.problem.obstacle import Ball, MovingObstacle, Traffic, reserves
from orbimpc_ros.mpc.problem.problem import Problem
from orbimpc_ros.mpc.problem.state import State


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
    return met._replace(eased=inside(problem, state, met))


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
