# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The closed loop of planner and vehicle without ROS, with faults in between if wanted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.loop.goal.motion import Forecast, GoalObservation
from orbimpc_ros.loop.planner import Decision, Planner, Snapshot
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.command import Command
from orbimpc_ros.sim.faults import Delivery, View
from orbimpc_ros.sim.vehicle import measured
from orbimpc_ros.sim.world import Flight, Scenario, departure

HELD = 1.5  # steps that a command is in force, as in the simulator by default


@dataclass(frozen=True)
class Log:
    """What a whole flight came to.

    Attributes:
        flights: its states, one more than ticks.
        ticks: what the planner made of each but the last.
    """

    flights: tuple[Flight, ...]
    ticks: tuple[Decision, ...]

    @property
    def captured(self) -> bool:
        """Return whether the goal was caught."""
        return self.flights[-1].captured

    @property
    def misses(self) -> Array:
        """Return the least distance to the goal during each step, shape (ticks,) [m]."""
        return np.array([flight.miss for flight in self.flights[1:]])


Sensor = Callable[[Flight], tuple[GoalObservation, Odometry]]


def perfect_sensor(flight: Flight) -> tuple[GoalObservation, Odometry]:
    """Return what is seen of a flight without noise: its goal and its vehicle."""
    source = flight.scenario.model.velocity_source
    return GoalObservation(flight.vehicle.time, flight.goal), measured(flight.vehicle, source)


def fly(
    planner: Planner, scenario: Scenario, forecast: Forecast, sensor: Sensor = perfect_sensor
) -> Log:
    """Close the loop of planner and vehicle until the goal is caught or the steps run out.

    The simulator and the planner do the same over DDS; this is the loop without ROS.
    """
    flights, ticks = [departure(scenario)], []
    while not flights[-1].over:
        tick = planned(planner, flights[-1], forecast, sensor)
        command = tick.command
        ticks.append(tick)
        flights.append(flights[-1].after(command.speed_fraction, command.body_rate))
    return Log(tuple(flights), tuple(ticks))


def planned(
    planner: Planner, flight: Flight, forecast: Forecast, sensor: Sensor = perfect_sensor
) -> Decision:
    """Return a planner's tick on what is seen of a flight just now."""
    sighting, odometry = sensor(flight)
    forecast.observe(sighting)
    goals = forecast.at(planner.ends(odometry.time))
    decision = planner.step(Snapshot(odometry, goals))
    planner.sent(decision.command)
    return decision


class Intake:
    """What a planner takes in, as the node does: finite messages, their stamps increasing.

    Args:
        forecast: learns from the goal's sightings.
    """

    def __init__(self, forecast: Forecast) -> None:
        self._forecast = forecast
        self._last = {True: -np.inf, False: -np.inf}  # stamps, of odometry and of sightings
        self._knows_goal = False

    def hear(self, arrived: list[Delivery]) -> Odometry | None:
        """Take in messages and return the odometry to plan from, if there is any."""
        newest = None
        for sent in arrived:
            content = sent.content
            is_odometry = isinstance(content, Odometry)
            if not sent.finite or content.time <= self._last[is_odometry]:
                continue
            self._last[is_odometry] = content.time
            if isinstance(content, Odometry):
                newest = content
            else:
                self._forecast.observe(content)
                self._knows_goal = True
        return newest if self._knows_goal else None


def fly_disturbed(
    planner: Planner,
    scenario: Scenario,
    forecast: Forecast,
    view: View,
    *,
    compensated: bool = True,
) -> Flight:
    """Return the end of a flight whose planner sees it only through faults.

    A tick without odometry has no command; the last one is then in force for 1.5 steps from when
    it came, and after that the vehicle is safe, just as in the simulator.

    Args:
        planner: plans.
        scenario: what is flown.
        forecast: of the goal.
        view: with the faults.
        compensated: whether to plan from late odometry as it would be by now, as the planner does.
    """
    flight, intake = departure(scenario), Intake(forecast)
    command, heard = None, -np.inf
    while not flight.over:
        now = flight.vehicle.time
        odometry = intake.hear(view.of(flight))
        if odometry is not None:
            latency = now - odometry.time if compensated else 0.0
            answer = planner.step(Snapshot(odometry, forecast, latency=latency), now).command
            planner.sent(answer, now)
            if not view.command_lost(flight.ticks):
                command, heard = answer, now
        flight = _flown(flight, command, heard + HELD * scenario.model.step - now)
    return flight


def _flown(flight: Flight, command: Command | None, held: float) -> Flight:
    if command is None:
        return flight.after(0.0, np.zeros(flight.scenario.model.rates), 0.0)
    return flight.after(command.speed_fraction, command.body_rate, held)
