# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Seeded instances: states, goals and disturbances, drawn at random or from flights.

Vehicles in flight are controlled by this package's planner; some are in continuous time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import numpy as np
from flying import fly
from scenarios import retrieval

from orbimpc_ros.loop.compensation import Response
from orbimpc_ros.loop.goal.forecast import Hold
from orbimpc_ros.loop.planner import Decision, Planner, Snapshot
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import Box, Problem, State
from orbimpc_ros.sim.vehicle import Plant, Vehicle, launched, measured
from orbimpc_ros.sim.world import Flight, Rope

APPROACH = 20  # ticks from the start to the rope and a first turn around it
SEED = 1
GRAVITY = np.array([0.0, 0.0, -9.81])  # [m/s^2]
UP = exp(np.array([0.0, -0.5 * math.pi, 0.0]))  # the thrust axis points upwards
SHORT = 8  # horizon of the controller among boxes, for speed


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
    flown = islice(fly(Planner(problem), endless, Hold()), APPROACH, None)
    return [(flight, decision) for flight, decision, _ in flown]


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


Departure = Callable[[Problem, np.random.Generator], tuple[Plant, Vehicle, Rope]]


def in_flight(problem: Problem, count: int, departs: Departure, seconds: float) -> list[Instance]:
    """Return consecutive ticks of random flights, each of a number of seconds."""
    rng, found = np.random.default_rng(SEED), list[Instance]()
    while len(found) < count:
        flown = _flown(problem, *departs(problem, rng))
        found += islice(flown, min(count - len(found), round(seconds / problem.step)))
    return found


def _flown(problem: Problem, plant: Plant, vehicle: Vehicle, goal: Rope) -> Iterator[Instance]:
    """Yield tick after tick of a flight; the controller has a shorter horizon among boxes."""
    planned = replace(problem, horizon=SHORT) if problem.obstacles else problem
    controller = Planner(
        planned,
        gap_tolerance=1e-2,
        disturbance=plant.blown,
        velocity_source=plant.velocity_source,
        response=Response(plant.speed_lag, plant.rate_lag),
    )
    now = Command(vehicle.fraction, np.zeros(plant.rates), vehicle.attitude)
    controller.sent(now, vehicle.time)  # odometry does not contain the thrust
    ahead = problem.step * np.arange(1.0, problem.horizon + 1.0)
    while True:
        odometry = measured(vehicle, plant.velocity_source)
        led = odometry.time + controller.lead
        goals = np.array([goal.at(led + each) for each in ahead])
        decision = controller.step(Snapshot(odometry, goals[: planned.horizon]))
        if decision.state is not None:
            yield Instance(decision.state, goals)
        command = decision.command
        controller.sent(command, vehicle.time)
        flown = command.speed_fraction, command.body_rate, vehicle.time
        vehicle = plant.flown(vehicle, problem.step, *flown)[-1]


def wing(problem: Problem, rng: np.random.Generator) -> tuple[Plant, Vehicle, Rope]:
    """Return a wing in a known wind, its start, and a drifting, swinging goal 80 m away.

    The wing lags behind its commands, and its goal is slower than it can fly: it circles after
    the approach.
    """
    angles = rng.uniform(-math.pi, math.pi, size=3)
    blowing, bearing, course = np.column_stack([np.cos(angles), np.sin(angles)])
    plant = Plant(
        step=problem.step,
        forward=problem.forward,
        disturbance=tuple((rng.uniform(0.0, 5.0) * blowing).tolist()),
        velocity_source='air',
        speed_lag=0.8,
        rate_lag=0.3,
        max_rate=problem.max_rate,
    )
    start = launched(plant, np.zeros(2), np.eye(2), fraction=0.8)
    goal = Rope(
        80.0 * bearing,
        rng.uniform(0.0, 3.0, size=2),
        rng.uniform(0.02, 0.1),
        rng.uniform(0.0, 2.0 * math.pi, size=2),
        rng.uniform(0.0, 2.0) * course,
    )
    return plant, plant.begun(start), goal


def multirotor(problem: Problem, rng: np.random.Generator) -> tuple[Plant, Vehicle, Rope]:
    """Return a multirotor that hovers, and a goal behind the boxes."""
    plant = Plant(
        dimension=3,
        translation_order=2,
        step=problem.step,
        forward=problem.forward,
        disturbance=tuple(GRAVITY.tolist()),
        speed_lag=0.1,
        rate_lag=0.1,
    )
    aside, place = rng.uniform(-1.0, 1.0, size=(2, 3))
    hovering = -GRAVITY[2] / problem.forward
    start = launched(plant, np.append(0.0, aside[1:]), UP, fraction=hovering)
    return plant, start, Rope(np.append(10.0, place[1:]))
