# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The closed loop of planner and simulated vehicle without ROS."""

from __future__ import annotations

from collections.abc import Iterator

from orbimpc_ros.loop.goal.motion import Forecast, GoalObservation
from orbimpc_ros.loop.planner import Decision, Planner, Snapshot
from orbimpc_ros.sim.vehicle import measured
from orbimpc_ros.sim.world import Flight, Scenario, departure


def fly(
    planner: Planner, scenario: Scenario, forecast: Forecast
) -> Iterator[tuple[Flight, Decision, Flight]]:
    """Yield the flight before each tick, the decision (noiseless odometry) and the flight after."""
    flight = departure(scenario)
    while not flight.over:
        odometry = measured(flight.vehicle, scenario.model.velocity_source)
        forecast.observe(GoalObservation(odometry.time, flight.goal))
        decision = planner.step(Snapshot(odometry, forecast.at(planner.ends(odometry.time))))
        before, command = flight, decision.command
        planner.sent(command)
        flight = before.after(command.speed_fraction, command.body_rate)
        yield before, decision, flight
