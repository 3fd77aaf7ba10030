# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Seeded instances: states, goals and disturbances, drawn at random or from flights.

Vehicles in flight are controlled by this package's planner; some are in continuous time.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scenarios import retrieval, retrieved

from orbimpc_ros.loop.planner import Decision, Planner
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import Box, Problem, State

if TYPE_CHECKING:
    from orbimpc_ros.sim.world import Flight

APPROACH = 20  # ticks from the start to the rope and a first turn around it
SEED = 1
GRAVITY = np.array([0.0, 0.0, -9.81])  # [m/s^2]
UP = exp(np.array([0.0, -0.5 * math.pi, 0.0]))  # the thrust axis points upwards
SHORT = 8  # horizon of the controller among boxes, for speed
LONGER = 10  # steps of the goal's known path beyond the horizon, for vehicles that lag
SHARED = ('dimension', 'translation_order', 'step', 'forward', 'max_rate')  # with the problem


class Instance(NamedTuple):
    """The data of a solve: the start of the plan, and goals g_1..g_N, shape (N, n) [m]."""

    state: State
    goals: Array


def circling(problem: Problem, count: int) -> list[Instance]:
    """Return consecutive ticks of the closed loop around the swinging rope, without the approach.

    This is the hard regime: the goal is closer than the floor allows the vehicle to stay.
    """
    return [
        Instance(decision.state, np.tile(flight.goal, (problem.horizon, 1)))
        for flight, decision in around(problem, count)
        if decision.state is not None
    ]


def around(problem: Problem, count: int) -> list[tuple[Flight, Decision]]:
    """Return a flight around the swinging rope tick by tick, without the approach."""
    endless = replace(retrieval(), max_ticks=APPROACH + count, capture_radius=0.0)
    flown = islice(retrieved(problem, endless), APPROACH, APPROACH + count)
    return [(flight, decision) for flight, decision in flown if decision is not None]


def scattered(problem: Problem, count: int, distance: float) -> list[Instance]:
    """Return unrelated instances: random attitudes at full speed, goals at a distance [m]."""
    rng, n, found = np.random.default_rng(SEED), problem.dimension, []
    for _ in range(count):
        attitude = exp(rng.normal(size=1 if n == 2 else 3))
        way = rng.normal(size=n)
        goal = distance * way / np.linalg.norm(way)
        state = State.at(np.zeros(n), attitude)
        found.append(Instance(state, np.tile(goal, (problem.horizon, 1))))
    return found


def arrivals(problem: Problem, count: int, goal: Array, spread: float) -> list[Instance]:
    """Return departures from rest at the origin; all goals but the first are perturbed."""
    rng, n = np.random.default_rng(SEED), problem.dimension
    moved = spread * rng.normal(size=(count, n))
    moved[0] = 0.0
    start = State.at(np.zeros(n), np.eye(2) if n == 2 else np.diag([-1.0, -1.0, 1.0]))
    return [Instance(start, np.tile(goal + m, (problem.horizon, 1))) for m in moved]


def boxes(count: int, *, space: bool = False) -> tuple[Box, ...]:
    """Return the first of 16 boxes ahead of the origin: within 7 m in the plane, 8 m in space."""
    rng = np.random.default_rng(SEED)
    if space:
        middles = rng.uniform([1.5, -0.8, -1.6], [8.0, 0.8, 0.4], size=(16, 3))
        half = rng.uniform(0.4, 1.0, size=(16, 3))
    else:
        middles = np.column_stack([rng.uniform(1.5, 6.5, 16), rng.uniform(-0.6, 0.6, 16)])
        half = rng.uniform(0.15, 0.35, size=(16, 2))
    return tuple(Box(m - d, m + d) for m, d in zip(middles[:count], half[:count], strict=True))


def landings(problem: Problem, count: int) -> list[Instance]:
    """Return the first ticks of descents to the origin, from possible ends of an approach."""
    rng, found = np.random.default_rng(SEED), []
    for _ in range(count):
        position = np.array([0.0, 0.0, 60.0]) + rng.uniform(-10.0, 10.0, 3)
        velocity = np.array([0.0, 0.0, -5.0]) + rng.uniform(-2.0, 2.0, 3)
        attitude = UP @ exp(rng.uniform(-0.1, 0.1, 3))
        start = State.at(
            position, 0.5 * attitude, velocity=velocity, attitude=attitude, disturbance=GRAVITY
        )
        found.append(Instance(start, np.zeros((problem.horizon, 3))))
    return found


def in_flight(
    problem: Problem,
    count: int,
    study: str,
    seconds: float,
    changes: Sequence[str] = (),
    rules: Mapping[str, Any] = {},
) -> list[Instance]:
    """Return consecutive ticks of a study's flights, each of a number of seconds.

    ``changes`` are ``name=value``; more ``rules`` than the study's are for random parameters, too.
    """
    from orbimpc_ros.tool.study import draws_of  # needs ROS, unlike instances that are drawn

    draws, numbers, found = draws_of(study, changes), itertools.count(), list[Instance]()
    draws = replace(draws, rules={**draws.rules, **rules})
    while len(found) < count:
        flown = _flown(problem, draws.of(SEED, next(numbers)))
        found += islice(flown, min(count - len(found), round(seconds / problem.step)))
    return found


def _flown(problem: Problem, values: Mapping[str, Any]) -> Iterator[Instance]:
    """Yield tick after tick of a flight; the controller has a shorter horizon among boxes."""
    from orbimpc_ros.ros.parameters.planner import planner_settings
    from orbimpc_ros.sim.parameters import sim_settings
    from orbimpc_ros.tool.offline import OfflinePlanner, closed_loop
    from orbimpc_ros.tool.settings import of_sim

    known = {**values, **{name: getattr(problem, name) for name in SHARED}}
    own: dict[str, Any] = {'capture_radius': 1e-6, 'max_ticks': 1000}  # it flies on
    world = replace(sim_settings(of_sim(known)), goal_path_steps=problem.horizon + LONGER, **own)
    settings = planner_settings(known)
    controller = Planner(
        replace(problem, horizon=SHORT) if problem.obstacles else problem,
        gap_tolerance=1e-2,
        disturbance=settings.disturbance,
        estimated=settings.estimated,
        velocity_source=settings.velocity_source,
        response=settings.response,
    )
    now = Command(world.start_fraction, np.zeros(world.model.rates), world.start.attitude)
    planner = OfflinePlanner(settings, planner=controller)
    controller.sent(now, planner.epoch / 1e9)  # odometry does not contain the thrust
    ahead = controller.lead + problem.step * np.arange(1.0, problem.horizon + 1.0)
    for flight, decision in closed_loop(planner, world):
        if decision is not None and decision.state is not None:
            goals = [world.rope_at(flight.vehicle.time + each) for each in ahead]
            yield Instance(decision.state, np.array(goals))
