"""The planner's path from messages to commands, with its clock in the test's hands."""

from __future__ import annotations

from typing import Any

import numpy as np

from orbimpc_ros.mpc.loop.odometry import Odometry
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.clock import RosTime
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.parameters.planner import PLANNER, planner_settings
from orbimpc_ros.ros.planner.inbox import Inbox
from orbimpc_ros.ros.planner.ticker import Ticker, prepared
from orbimpc_ros.ros.reports import Report

EPOCH = 1_700_000_000 * SECOND


class Planner:
    """A planner without its node.

    Args:
        parameters: of the planner, by name.
    """

    def __init__(self, parameters: dict[str, Any]) -> None:
        settings = planner_settings({row.name: row.default for row in PLANNER} | parameters)
        self._inbox = Inbox(settings)
        self._frames = settings.frames
        self._ticker = Ticker(*prepared(settings), simulated=True)

    def goal(self, now: float, place: np.ndarray) -> None:
        """Hear where the goal is at a time [s]."""
        self._take('goal', messages.goal_message(self._stamp(now), place), now)

    def goals(self, now: float, step: float, places: list[np.ndarray]) -> None:
        """Hear where the goal will be, every ``step`` [s] from a time on [s]."""
        self._take('goal_path', messages.goal_path_message(self._stamp(now), step, places), now)

    def odometry(self, now: float, measured: Odometry) -> None:
        """Hear where the vehicle is at a time [s]."""
        self._take('odom', messages.measurement_message(self._stamp(now), measured), now)

    def report(self, now: float) -> tuple[str, Report]:
        """Plan at a time [s]; return the road that the command came, and the tick."""
        ticker, inbox, ros = self._ticker, self._inbox, self._ros(now)
        lost = inbox.stale_odometry(now, ros)
        if lost:
            report = ticker.safe(inbox, Reason(Cause.ODOMETRY, lost))
        else:
            report = ticker.planned(inbox, now, ros)
        ticker.went_out(report.tick.command, ros.nanoseconds / SECOND)
        return 'odometry lost' if lost else report.tick.fallback or 'plan', report

    def _take(self, topic: str, message: Any, now: float) -> None:
        self._inbox.take(topic, message, now, self._ros(now))

    def _stamp(self, now: float) -> messages.Stamp:
        return messages.Stamp(self._ros(now).nanoseconds, self._frames)

    @staticmethod
    def _ros(now: float) -> RosTime:
        return RosTime(EPOCH + round(now * SECOND))
