# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The closed loop of planner and vehicle with faults in between, without ROS."""

import numpy as np

from orbimpc_ros.loop.planner import Snapshot
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.sim.flight import departure

HELD = 1.5  # steps that a command is in force, as in the simulator by default


class Intake:
    """What a planner takes in, as the node does: finite messages, their stamps increasing."""

    def __init__(self, forecast):
        self._forecast = forecast
        self._last = {True: -np.inf, False: -np.inf}  # stamps, of odometry and of sightings
        self._knows_goal = False

    def hear(self, arrived):
        """Take in messages and return the odometry to plan from, if there is any."""
        newest = None
        for sent in arrived:
            content = sent.content
            is_odometry = isinstance(content, Odometry)
            if not sent.finite or content.time <= self._last[is_odometry]:
                continue
            self._last[is_odometry] = content.time
            if is_odometry:
                newest = content
            else:
                self._forecast.observe(content)
                self._knows_goal = True
        return newest if self._knows_goal else None


def fly_disturbed(planner, scenario, forecast, view, *, compensated=True):
    """Return the end of a flight whose planner sees it only through faults.

    A tick without odometry has no command; the last one is then in force for 1.5 steps from when
    it came, and after that the vehicle is safe, just as in the simulator.
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


def _flown(flight, command, held):
    if command is None:
        return flight.after(0.0, np.zeros(flight.scenario.model.rates), 0.0)
    return flight.after(command.speed_fraction, command.body_rate, held)
