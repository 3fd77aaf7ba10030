# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The closed loop of planner and vehicle without ROS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbimpc_ros.loop.goal.motion import Forecast, GoalObservation
from orbimpc_ros.loop.planner import Decision, Planner, Snapshot
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.sim.vehicle import measured
from orbimpc_ros.sim.world import Flight, Scenario, departure


@dataclass(frozen=True)
class Log:
    """What a whole flight came to."""

    flights: tuple[Flight, ...]  # its states, one more than ticks
    ticks: tuple[Decision, ...]  # what the planner made of each but the last

    @property
    def captured(self) -> bool:
        """Return whether the goal was caught."""
        return self.flights[-1].captured

    @property
    def misses(self) -> Array:
        """Return the least distance to the goal during each step, shape (ticks,) [m]."""
        return np.array([flight.miss for flight in self.flights[1:]])


def fly(planner: Planner, scenario: Scenario, forecast: Forecast) -> Log:
    """Close the loop of planner and vehicle until the goal is caught or the steps run out.

    The simulator and the planner do the same over DDS; this is the loop without ROS.
    """
    flights, ticks = [departure(scenario)], []
    while not flights[-1].over:
        tick = planned(planner, flights[-1], forecast)
        command = tick.command
        ticks.append(tick)
        flights.append(flights[-1].after(command.speed_fraction, command.body_rate))
    return Log(tuple(flights), tuple(ticks))


def planned(planner: Planner, flight: Flight, forecast: Forecast) -> Decision:
    """Return a planner's tick on what is seen of a flight just now, without noise."""
    odometry = measured(flight.vehicle, flight.scenario.model.velocity_source)
    forecast.observe(GoalObservation(flight.vehicle.time, flight.goal))
    goals = forecast.at(planner.ends(odometry.time))
    decision = planner.step(Snapshot(odometry, goals))
    planner.sent(decision.command)
    return decision
