# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner's core aboard a flight in this process, with its clock given."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from orbimpc_ros.loop.planner import Planner
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.clock import RosTime
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.parameters.planner import PLANNER, PlannerSettings, planner_settings
from orbimpc_ros.ros.parameters.spec import completed
from orbimpc_ros.ros.planner.core import Core, planner_of
from orbimpc_ros.ros.reports import Report
from orbimpc_ros.sim.markers import traffic_markers
from orbimpc_ros.sim.vehicle import measured
from orbimpc_ros.sim.world import Flight

PATIENCE = 60.0  # [s]
EPOCH = 1_700_000_000 * SECOND


class Onboard:
    """The planner's core aboard a flight in this process.

    Args:
        parameters: of the planner, by name.
        patient: whether a solve may take a minute.
        pilot: makes what decides, by default the planner of the package.
        clock: that deadlines are kept by [s].

    Attributes:
        period: how often to plan [s].
    """

    def __init__(
        self,
        parameters: dict[str, Any],
        *,
        patient: bool = False,
        pilot: Callable[[PlannerSettings], Planner] | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        settings = planner_settings(completed(PLANNER, parameters))
        if patient:
            settings = replace(settings, given_deadline=PATIENCE)
        planner = planner_of(settings)[1] if pilot is None else pilot(settings)
        self._core, self.period = Core(settings, planner, clock=clock), settings.period

    def goal(self, now: float, place: np.ndarray) -> None:
        """Hear where the goal is at a time [s]."""
        self._take('goal', messages.goal_message(self._stamp(now), place), now)

    def goals(self, now: float, step: float, places: list[np.ndarray]) -> None:
        """Hear where the goal will be, every ``step`` [s] from a time on [s]."""
        self._take('goal_path', messages.goal_path_message(self._stamp(now), step, places), now)

    def odometry(self, now: float, measured: Odometry) -> None:
        """Hear where the vehicle is at a time [s]."""
        self._take('odom', messages.odometry_message(self._stamp(now), measured), now)

    def traffic(self, now: float, flight: Flight, margin: float) -> None:
        """Hear where the traffic around a flight is, each ball larger by a margin [m]."""
        self._core.planner.expect_hazards()
        message = traffic_markers(self._stamp(now), flight)
        for marker in message.markers:
            for axis in 'xyz'[: flight.scenario.model.dimension]:
                setattr(marker.scale, axis, getattr(marker.scale, axis) + 2.0 * margin)
        self._take('obstacles', message, now)

    def report(self, now: float) -> Report:
        """Plan at a time [s]; return what was decided."""
        report = self._core.decide(now, self._ros(now))
        self._core.sent(report.decision.command, _nanoseconds(now) / SECOND)
        return report

    def _take(self, topic: str, message: Any, now: float) -> None:
        self._core.inputs.update(topic, message, now, self._ros(now))

    def _stamp(self, now: float) -> messages.Stamp:
        return messages.Stamp(_nanoseconds(now), self._core.settings.frames)

    @staticmethod
    def _ros(now: float) -> RosTime:
        return RosTime(_nanoseconds(now))


def _nanoseconds(now: float) -> int:
    return EPOCH + round(now * SECOND)


def tell(planner: Onboard, flight: Flight, ahead: int, margin: float = 0.0) -> None:
    """Send a planner what it hears of a flight.

    Args:
        planner: that hears it.
        flight: as it is now.
        ahead: steps of the goal's future.
        margin: by which the balls in the traffic are told to be larger than they are [m].
    """
    now, step, rope = flight.vehicle.time, flight.scenario.model.step, flight.scenario.rope
    if flight.scenario.traffic:
        planner.traffic(now, flight, margin)
    if ahead:
        planner.goals(now, step, [rope.at(flight.elapsed + k * step) for k in range(ahead + 1)])
    planner.goal(now, flight.goal)
    planner.odometry(now, measured(flight.vehicle, flight.scenario.model.velocity_source))
