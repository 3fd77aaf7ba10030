# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Seeded instances: states, goals and disturbances, drawn at random or from flights.

Vehicles in flight are controlled by this package's planner; some are in continuous time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
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


Departure = Callable[[Problem, np.random.Generator], dict[str, Any]]


def in_flight(problem: Problem, count: int, departs: Departure, seconds: float) -> list[Instance]:
    """Return consecutive ticks of random flights, each of a number of seconds."""
    rng, found = np.random.default_rng(SEED), list[Instance]()
    while len(found) < count:
        flown = _flown(problem, departs(problem, rng))
        found += islice(flown, min(count - len(found), round(seconds / problem.step)))
    return found


def _flown(problem: Problem, values: dict[str, Any]) -> Iterator[Instance]:
    """Yield tick after tick of a flight; the controller has a shorter horizon among boxes."""
    # They need ROS, unlike instances that are drawn.
    from orbimpc_ros.ros.parameters.planner import PLANNER, planner_settings
    from orbimpc_ros.ros.parameters.spec import TINY, completed
    from orbimpc_ros.sim.parameters import SIM, sim_settings
    from orbimpc_ros.tool.offline import OfflinePlanner, closed_loop

    known = {name: getattr(problem, name) for name in SHARED} | values
    own = {'vehicle': 'continuous', 'goal_path_steps': problem.horizon + LONGER}
    world = sim_settings(completed(SIM, known | own | {'capture_radius': TINY, 'max_ticks': 1000}))
    settings = planner_settings(completed(PLANNER, known))
    controller = Planner(
        replace(problem, horizon=SHORT) if problem.obstacles else problem,
        gap_tolerance=1e-2,
        disturbance=settings.disturbance,
        velocity_source=settings.velocity_source,
        response=settings.response,
    )
    now = Command(world.start_fraction, np.zeros(world.model.rates), world.start.attitude)
    planner = OfflinePlanner(settings, planner=controller)
    controller.sent(now, planner.epoch / 1e9)  # odometry does not contain the thrust
    ahead = controller.lead + problem.step * np.arange(1.0, problem.horizon + 1.0)
    for flight, decision in closed_loop(planner, world):
        if decision is not None and decision.state is not None:
            goals = [world.rope.at(flight.vehicle.time + each) for each in ahead]
            yield Instance(decision.state, np.array(goals))


def wing(_problem: Problem, rng: np.random.Generator) -> dict[str, Any]:
    """Return the parameters of a wing in a known wind, and of a swinging goal 80 m away.

    The wing lags behind its commands, and its goal drifts, slower than it can fly: it circles after
    the approach.
    """
    angles = rng.uniform(-math.pi, math.pi, size=3)
    blowing, bearing, course = np.column_stack([np.cos(angles), np.sin(angles)])
    return {
        'wind': tuple(rng.uniform(0.0, 5.0) * blowing),
        'velocity_source': 'air',
        'response.speed': 0.8,
        'response.rate': 0.3,
        'start.speed_fraction': 0.8,
        'rope.center': tuple(80.0 * bearing),
        'rope.amplitude': tuple(rng.uniform(0.0, 3.0, size=2)),
        'rope.frequency': rng.uniform(0.02, 0.1),
        'rope.phase': tuple(rng.uniform(0.0, 2.0 * math.pi, size=2)),
        'rope.velocity': tuple(rng.uniform(0.0, 2.0) * course),
    }


def multirotor(problem: Problem, rng: np.random.Generator) -> dict[str, Any]:
    """Return the parameters of a multirotor that hovers, and of a goal behind the boxes."""
    aside, place = rng.uniform(-1.0, 1.0, size=(2, 3))
    return {
        'gravity': -GRAVITY[2],
        'thrust_axis': 'z',
        'response.speed': 0.1,
        'response.rate': 0.1,
        'start.position': (0.0, *aside[1:]),
        'start.speed_fraction': -GRAVITY[2] / problem.forward,
        'rope.center': (10.0, *place[1:]),
        'rope.frequency': 0.0,
        'rope.amplitude': (0.0, 0.0, 0.0),
    }
