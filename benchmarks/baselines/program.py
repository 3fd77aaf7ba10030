# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The base of baselines by programs: from a state and chosen thrust axes to a plan."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.model.dynamics import drift
from orbimpc_ros.mpc.plan import UNPROVED, Plan, assemble
from orbimpc_ros.mpc.problem import Ball, Problem, State


class Program(ABC):
    """Plans a planar problem of orders (1, 1) at every tick, and proves nothing.

    Args:
        problem: what to plan.

    Raises:
        BadInput: a problem that the baselines cannot state.
    """

    def __init__(self, problem: Problem) -> None:
        _require_stateable(problem)
        self.problem = problem
        self._previous: Array | None = None  # thrust axes z_1..z_N of the last plan

    def plan(self, state: State, goals: Array) -> Plan:
        """Return the plan from a state towards goals g_1..g_N, shape (N, 2) [m]."""
        z = within_speeds(self.problem, self.axes(state, goals))
        self._previous = z
        return assemble(
            self.problem,
            state,
            goals,
            z,
            projection='nearest',
            proof=UNPROVED,
        )

    @abstractmethod
    def axes(self, state: State, goals: Array) -> Array:
        """Return thrust axes z_1..z_N, shape (N, 2), whose lengths are still to be limited."""

    def shifted(self, state: State) -> Array:
        """Return the previous plan's axes one step on, the last held; at first the heading's."""
        if self._previous is None:
            return np.tile(state.attitude[:, 0], (self.problem.horizon, 1))
        return np.concatenate([self._previous[1:], self._previous[-1:]])


def least_fraction(problem: Problem, directions: Array) -> Array:
    """Return the least speed fraction that a floor allows in directions, shape (N, 2), as (N,)."""
    return np.array([problem.floor.least(direction) for direction in directions])


def coasting(problem: Problem, state: State) -> Array:
    """Return where s_1..s_N are without z_1..z_N, shape (N, 2) [m]."""
    first = np.outer(problem.maps.reach[:, 0], state.rotation[:, 0])
    return np.asarray(drift(problem, state) + first)


def balls_of(problem: Problem, state: State) -> tuple[Array, Array]:
    """Return where balls that move are at the ends of steps, and how large, (J, N, 2) and (J,) [m].

    Raises:
        BadInput: something else than a ball moves.
    """
    times = problem.step * np.arange(1, problem.horizon + 1)
    centres = np.empty((len(state.hazards), len(times), 2))
    radii = np.empty(len(state.hazards))
    for j, hazard in enumerate(state.hazards):
        if not isinstance(hazard.body, Ball):
            raise BadInput('state.hazards', hazard.body, 'balls for a baseline')
        centres[j], radii[j] = hazard.body.centre + hazard.moved(times), hazard.body.radius
    return centres, radii


def within_speeds(problem: Problem, axes: Array) -> Array:
    """Return axes, shape (N, 2), made as long as the floor and full speed allow."""
    lengths = np.maximum(np.linalg.norm(axes, axis=1), 1e-9)[:, None]
    directions = axes / lengths
    return directions * np.clip(lengths, least_fraction(problem, directions)[:, None], 1.0)


def _require_stateable(problem: Problem) -> None:
    for name, wanted in (
        ('dimension', 2),
        ('rotation_order', 1),
        ('translation_order', 1),
        ('terminal', 'penalty'),
        ('obstacles', ()),
    ):
        if getattr(problem, name) != wanted:
            raise BadInput(name, getattr(problem, name), f'{wanted} for a baseline')
    if problem.weights.length > 0.0:
        raise BadInput('weights.length', problem.weights.length, '0 for a baseline')
