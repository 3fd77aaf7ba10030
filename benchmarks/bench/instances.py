# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Seeded streams of states and goals to solve for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from flying import planned
from scenarios import retrieval

from orbimpc_ros.loop.goal.forecast import Hold
from orbimpc_ros.loop.planner import Decision, Planner
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Box, Problem, State
from orbimpc_ros.sim.world import Flight, departure

APPROACH = 20  # ticks from the start to the rope and a first turn around it
SEED = 1


class Instance(NamedTuple):
    """One solve.

    Attributes:
        state: where the plan starts.
        goals: g_1..g_N, shape (N, n) [m].
    """

    state: State
    goals: Array


def circling(problem: Problem, count: int) -> list[Instance]:
    """Return consecutive ticks of the closed loop around the swinging rope, the approach skipped.

    That is the hard regime: the goal is nearer than the floor lets the vehicle stay.
    """
    return [
        Instance(tick.state, np.tile(flight.goal, (problem.horizon, 1)))
        for flight, tick in around(problem, count)
        if tick.state is not None
    ]


def around(problem: Problem, count: int) -> list[tuple[Flight, Decision]]:
    """Return a flight around the swinging rope tick by tick, the approach skipped."""
    flight = departure(replace(retrieval(), max_ticks=APPROACH + count))
    controller, forecast, flown = Planner(problem), Hold(), []
    for _ in range(APPROACH + count):
        tick = planned(controller, flight, forecast)
        flown.append((flight, tick))
        flight = flight.after(tick.command.speed_fraction, tick.command.body_rate)
    return flown[APPROACH:]


def scattered(problem: Problem, count: int, distance: float) -> list[Instance]:
    """Return unrelated instances: random attitudes at full speed, goals at about a distance [m]."""
    return list(_scattered(problem, count, distance))


def _scattered(problem: Problem, count: int, distance: float) -> Iterator[Instance]:
    rng, n = np.random.default_rng(SEED), problem.dimension
    for _ in range(count):
        attitude = exp(rng.normal(size=1 if n == 2 else 3))
        way = rng.normal(size=n)
        goal = distance * way / np.linalg.norm(way)
        yield Instance(State.at(np.zeros(n), attitude), np.tile(goal, (problem.horizon, 1)))


def arrivals(problem: Problem, count: int, goal: Array, spread: float) -> list[Instance]:
    """Return departures from rest at the origin for a goal, the first exact, the others moved."""
    rng, n = np.random.default_rng(SEED), problem.dimension
    attitude = np.eye(2) if n == 2 else np.diag([-1.0, -1.0, 1.0])
    moved = spread * rng.normal(size=(count, n))
    moved[0] = 0.0
    start = State.at(np.zeros(n), attitude)
    return [Instance(start, np.tile(goal + m, (problem.horizon, 1))) for m in moved]


def boxes(count: int) -> tuple[Box, ...]:
    """Return boxes in the way from the origin to a goal ahead, the same ones for every count."""
    rng = np.random.default_rng(SEED)
    middles = np.column_stack([rng.uniform(1.5, 6.5, 16), rng.uniform(-0.6, 0.6, 16)])
    half = rng.uniform(0.15, 0.35, size=(16, 2))
    return tuple(Box(m - d, m + d) for m, d in zip(middles[:count], half[:count], strict=True))
