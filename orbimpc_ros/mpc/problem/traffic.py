# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Balls, and bodies that move, over the steps of a plan.

Within a step a body counts as moving evenly from where it is at the beginning to where it is at the
end, and as larger by as much as its track strays from that.

Mathematics: docs/mathematics.md, 3.7.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem.leaving import inside
from orbimpc_ros.mpc.problem.obstacle import (
    Ball,
    Box,
    MovingObstacle,
    moved_together,
    reserves,
    simultaneous,
)
from orbimpc_ros.mpc.problem.problem import Problem
from orbimpc_ros.mpc.problem.state import State


class Traffic(NamedTuple):
    """Bodies that plans stay clear of at the ends of steps and in between.

    Attributes:
        names: of J bodies: ``obstacle 0`` (its number among obstacles), ``hazard 0``.
        bodies: when the plan starts.
        shifts: how far each has moved by the ends of steps 0..N, shape (J, N + 1, n) [m].
        strays: by how much each strays from even motion in each step, shape (J, N) [m].
        kept: by how much each is kept away from as if it were larger, shape (J, N) [m].
        eased: how far inside of each a plan may be in each step, shape (J, N) [m].
    """

    names: tuple[str, ...]
    bodies: tuple[Box | Ball, ...]
    shifts: Array
    strays: Array
    kept: Array
    eased: Array

    @property
    def grown(self) -> Array:
        """Return how much larger each counts in each step, shape (J, N) [m]."""
        return self.strays + self.kept - self.eased


def traffic_of(problem: Problem, state: State) -> Traffic | None:
    """Return what is round or moves; None if nothing does. Of a state it is worked out once."""
    return state.once(problem, lambda: _met(problem, state))


def _met(problem: Problem, state: State) -> Traffic | None:
    balls = {f'obstacle {i}': each for i, each in enumerate(problem.obstacles)}
    still = {name: each for name, each in balls.items() if isinstance(each, Ball)}
    if not still and not state.hazards:
        return None
    ends = problem.step * np.arange(problem.horizon + 1)
    count = len(still)
    bodies = (*still.values(), *(each.body for each in state.hazards))
    shifts = np.zeros((len(bodies), len(ends), problem.dimension))
    strays = np.zeros((len(bodies), problem.horizon))
    for group in simultaneous(state.hazards):
        moving = [state.hazards[j] for j in group]
        at = [count + j for j in group]
        shifts[at], strays[at] = moved_together(moving, ends), _strays(moving, ends)
    names = (*still, *(f'hazard {i}' for i in range(len(state.hazards))))
    kept = np.zeros_like(strays)
    kept[count:] = reserves(state.hazards, problem.horizon, problem.step)
    eased = inside(problem, state, bodies, shifts, strays, kept)
    return Traffic(names, bodies, shifts, strays, kept, eased)


def _strays(hazards: Sequence[MovingObstacle], ends: Array) -> Array:
    """Return by how much simultaneous tracks stray from even motion in steps, shape (J, N) [m]."""
    strays, turns = np.zeros((len(hazards), len(ends) - 1)), hazards[0].turns
    inside = turns[turns < ends[-1]]
    if not len(inside):
        return strays
    at = np.searchsorted(ends, inside, side='right') - 1
    moved = moved_together(hazards, ends)
    share = (inside - ends[at]) / (ends[at + 1] - ends[at])
    even = moved[:, at] + share[:, None] * (moved[:, at + 1] - moved[:, at])
    apart = np.linalg.norm(moved_together(hazards, inside) - even, axis=-1)
    np.maximum.at(strays.T, at, apart.T)
    return strays
