# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The closed loop of controller and vehicle with faults in between, without ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from orbimpc_ros.loop.compensation import CommandHistory, advanced
from orbimpc_ros.loop.goal.motion import Forecast
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.command import Command
from orbimpc_ros.sim.faults import Delivery, View
from orbimpc_ros.sim.flight import Flight, departure
from orbimpc_ros.sim.scenario import Scenario

if TYPE_CHECKING:
    from orbimpc_ros.loop.planner import Planner

HELD = 1.5  # steps that a command is in force, as in the simulator by default


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
    controller: Planner,
    scenario: Scenario,
    forecast: Forecast,
    view: View,
    *,
    compensated: bool = True,
) -> Flight:
    """Return the end of a flight whose controller sees it only through faults.

    A tick without odometry has no command; the last one is then in force for 1.5 steps from when
    it came, and after that the vehicle is safe, just as in the simulator.

    Args:
        controller: plans.
        scenario: what is flown.
        forecast: of the goal.
        view: with the faults.
        compensated: whether to plan from late odometry as it would be by now, as the planner does.
    """
    flight, intake, sent = departure(scenario), Intake(forecast), CommandHistory()
    command, heard = None, -np.inf
    while not flight.over:
        now = flight.vehicle.time
        odometry = intake.hear(view.of(flight))
        if odometry is not None:
            if compensated:
                legs = sent.intervals(odometry.time, now)
                odometry = advanced(controller.problem, odometry, legs)
            answer = _answer(controller, odometry, forecast)
            sent.add(answer, now)
            if not view.command_lost(flight.ticks):
                command, heard = answer, now
        flight = _flown(flight, command, heard + HELD * scenario.model.step - now)
    return flight


def _answer(controller: Planner, odometry: Odometry, forecast: Forecast) -> Command:
    ahead = controller.problem.step * np.arange(1, controller.remaining + 1)
    return controller.tick(odometry, forecast.at(odometry.time + ahead)).command


def _flown(flight: Flight, command: Command | None, held: float) -> Flight:
    if command is None:
        return flight.after(0.0, np.zeros(flight.scenario.model.rates), 0.0)
    return flight.after(command.speed_fraction, command.body_rate, held)
