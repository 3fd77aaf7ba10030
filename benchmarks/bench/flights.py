# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Instances that arise in flight: states, goals and disturbances that a controller has met.

The vehicles are in continuous time; what they do is followed by this package's own controller.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from benchmarks.bench.instances import SEED, Instance
from orbimpc_ros.loop.compensation import Response
from orbimpc_ros.loop.planner import Planner, Snapshot
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.command import Command
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Box, Problem, State
from orbimpc_ros.sim.plant import Plant
from orbimpc_ros.sim.vehicle import Vehicle, launched, measured
from orbimpc_ros.sim.world import Rope

CIRCLING, CROSSING = 20.0, 4.0  # [s] of each flight
GRAVITY = np.array([0.0, 0.0, -9.81])  # [m/s^2]
UP = exp(np.array([0.0, -0.5 * math.pi, 0.0]))  # the thrust axis points upwards
SHORT = 8  # steps that a pilot looks ahead who is not to be slow


def winged(problem: Problem, count: int) -> list[Instance]:
    """Return consecutive ticks of a wing that follows drifting, swinging goals in winds it knows.

    It lags behind its commands, and its goals are slower than it can fly: after the approach it
    circles. Every flight has a wind and a goal of its own.
    """
    return _of_flights(problem, count, _wing, CIRCLING)


def rotored(problem: Problem, count: int) -> list[Instance]:
    """Return consecutive ticks of multirotors that fly among boxes to places behind them."""
    return _of_flights(problem, count, _multirotor, CROSSING)


def landings(problem: Problem, count: int) -> list[Instance]:
    """Return the first ticks of descents to the origin, from where an approach may have ended."""
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


def spread(count: int) -> tuple[Box, ...]:
    """Return boxes in space, in the way of whoever flies 10 m along x, the same for every count."""
    rng = np.random.default_rng(SEED)
    middles = rng.uniform([1.5, -0.8, -1.6], [8.0, 0.8, 0.4], size=(16, 3))
    half = rng.uniform(0.4, 1.0, size=(16, 3))
    return tuple(Box(m - d, m + d) for m, d in zip(middles[:count], half[:count], strict=True))


def _of_flights(
    problem: Problem,
    count: int,
    departure: Callable[[Problem, np.random.Generator], tuple[Plant, Vehicle, Rope]],
    seconds: float,
) -> list[Instance]:
    rng, found = np.random.default_rng(SEED), list[Instance]()
    while len(found) < count:
        flown = _flown(problem, *departure(problem, rng))
        found += islice(flown, min(count - len(found), round(seconds / problem.step)))
    return found


def _flown(problem: Problem, plant: Plant, vehicle: Vehicle, goal: Rope) -> Iterator[Instance]:
    """Yield tick after tick of a flight; its pilot has the horizon, or a short one among boxes."""
    pilot = replace(problem, horizon=SHORT) if problem.obstacles else problem
    controller = Planner(
        pilot,
        gap_tolerance=1e-2,
        disturbance=plant.blown,
        velocity_source=plant.velocity_source,
        response=Response(plant.speed_lag, plant.rate_lag),
    )
    now = Command(vehicle.fraction, np.zeros(plant.rates), vehicle.attitude)
    controller.sent(now, vehicle.time)  # odometry does not show a thrust
    ahead = problem.step * np.arange(1.0, problem.horizon + 1.0)
    while True:
        odometry = measured(vehicle, plant.velocity_source)
        led = controller.lead
        goals = np.array([goal.at(odometry.time + led + each) for each in ahead])
        decision = controller.step(Snapshot(odometry, goals[: pilot.horizon]))
        if decision.state is not None:
            yield Instance(decision.state, goals)
        command = decision.command
        controller.sent(command, vehicle.time)
        flown = command.speed_fraction, command.body_rate, vehicle.time
        vehicle = plant.flown(vehicle, problem.step, *flown)[-1]


def _wing(problem: Problem, rng: np.random.Generator) -> tuple[Plant, Vehicle, Rope]:
    """Return a wing, its start, and a goal 80 m away."""
    blowing, bearing, course = map(_towards, rng.uniform(-math.pi, math.pi, size=3))
    plant = Plant(
        step=problem.step,
        forward=problem.forward,
        disturbance=tuple((rng.uniform(0.0, 5.0) * blowing).tolist()),
        source='air',
        speed_lag=0.8,
        rate_lag=0.3,
        max_rate=problem.max_rate,
    )
    start = launched(plant, np.zeros(2), np.eye(2), fraction=0.8)
    swing = rng.uniform(0.0, 3.0, size=2)
    goal = Rope(
        80.0 * bearing,
        swing,
        rng.uniform(0.02, 0.1),
        rng.uniform(0.0, 2.0 * math.pi, size=2),
        rng.uniform(0.0, 2.0) * course,
    )
    return plant, plant.begun(start), goal


def _multirotor(problem: Problem, rng: np.random.Generator) -> tuple[Plant, Vehicle, Rope]:
    """Return a multirotor that hovers, and a place behind the boxes."""
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
    still = np.zeros(3)
    return plant, start, Rope(np.append(10.0, place[1:]), still, 0.0, still)


def _towards(angle: float) -> Array:
    return np.array([math.cos(angle), math.sin(angle)])
