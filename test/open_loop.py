# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Arrivals of a vehicle that flies one plan to its end, without planning again."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scenarios import model_of

from orbimpc_ros.loop.compensation import state_of
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.command import command_of
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.sim.vehicle import Vehicle, advance, measured
from orbimpc_ros.sim.world import Scenario


class Arrival(NamedTuple):
    """How a flight ended.

    Attributes:
        position: distance to the goal [m].
        velocity: speed [m/s].
        turned: largest angle between the thrust planned and the thrust flown [rad].
    """

    position: float
    velocity: float
    turned: float


class OpenLoop(NamedTuple):
    """A scenario planned once, at its start.

    Attributes:
        plan: from the start to the arrival.
        relaxed: how the plan itself arrives, its rotations anywhere in conv SO(n).
        flown: how a vehicle arrives that obeys its commands.
    """

    plan: Plan
    relaxed: Arrival
    flown: Arrival


def open_loop(problem: Problem, scenario: Scenario, projection: str) -> OpenLoop:
    """Return a scenario's plan and how it arrives, by itself and flown without planning again.

    Raises:
        Infeasible: no trajectory satisfies the constraints.
    """
    start, goal = scenario.start, scenario.rope.at(0.0)
    state = state_of(problem, measured(start), start.fraction, scenario.model.blown)
    solver = Solver(problem, projection=projection, coasting=True)
    plan = solver.solve(state, np.tile(goal, (problem.horizon, 1)))
    missed = float(np.linalg.norm(plan.positions[-1] - goal))
    relaxed = Arrival(missed, float(np.linalg.norm(plan.velocities[-1])), 0.0)
    return OpenLoop(plan, relaxed, flown_to_the_end(problem, state, plan, start, goal))


def flown_to_the_end(
    problem: Problem, state: State, plan: Plan, vehicle: Vehicle, goal: Array
) -> Arrival:
    """Return how a vehicle arrives that obeys the commands of one plan, step after step.

    Args:
        problem: what was solved.
        state: the state that the plan starts from.
        plan: with the projection that is to be judged.
        vehicle: what ``state`` was measured on.
        goal: shape (n,) [m].
    """
    blown = tuple(state.disturbance.tolist())
    model, turned = replace(model_of(problem), disturbance=blown), 0.0
    for step in range(plan.horizon):
        turned = max(turned, _angle(plan.rotations[step, :, 0], vehicle.attitude[:, 0]))
        command = command_of(problem, state, plan, step)
        vehicle = advance(model, vehicle, command.speed_fraction, command.body_rate)
    missed = float(np.linalg.norm(vehicle.position - goal))
    return Arrival(missed, float(np.linalg.norm(vehicle.velocity)), turned)


def _angle(planned: Array, flown: Array) -> float:
    size = float(np.linalg.norm(planned))
    if size < 1e-3:
        return 0.0  # no thrust, no direction to miss
    return float(np.arccos(np.clip(planned @ flown / size, -1.0, 1.0)))
