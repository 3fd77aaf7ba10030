# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner without a node: its own ticker and messages, given inputs and asked for answers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from orbimpc_ros.loop.controller import Tick
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.ros.clock import RosTime
from orbimpc_ros.ros.messages import SECOND, Stamp
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.ros.planner.inbox import Inbox
from orbimpc_ros.ros.planner.lookout import PLAN, others
from orbimpc_ros.ros.planner.outlet import command_messages, report_messages
from orbimpc_ros.ros.planner.ticker import Ticker, prepared
from orbimpc_ros.ros.reports import Report, prices


def resolved(settings: PlannerSettings, namespace: str) -> tuple[str, ...]:
    """Return the full names of the topics of other vehicles' plans, as a node would make them."""

    def resolve(topic: str) -> str:
        return topic if topic.startswith('/') else f'{namespace}/{topic}'

    return others(settings.avoid, resolve(PLAN), resolve)


class OfflinePlanner:
    """Takes in messages and answers, when asked, with what the planner would publish.

    Args:
        settings: of the planner.
        node: its name.
        avoided: topics of other vehicles' plans, by their full names.
        clock: that deadlines are kept by [s]. By default a solve has none: what it finds must not
            depend on the machine.
    """

    def __init__(
        self,
        settings: PlannerSettings,
        node: str = '/planner',
        avoided: Sequence[str] = (),
        clock: Callable[[], float] | None = None,
    ) -> None:
        self._settings, self._node = settings, node
        deadline = math.inf if clock is None else settings.deadline
        self._inbox = Inbox(settings, others=tuple(avoided))
        # Simulated: what a tick takes is given, not measured.
        self._ticker = Ticker(
            *prepared(replace(settings, given_deadline=deadline)),
            simulated=True,
            clock=clock or time.perf_counter,
        )
        self._report: Report | None = None

    def hear(self, topic: str, message: Any, now: float, ros: RosTime) -> str:
        """Take in an input; return why it was refused, or an empty string.

        Args:
            topic: without its namespace.
            message: its content.
            now: when it came, on the steady clock [s].
            ros: on the ROS clock.
        """
        return self._inbox.take(topic, message, now, ros)

    def start_afresh(self, cause: Cause) -> None:
        """Forget plan and inputs, as the planner does for a cause."""
        if cause is Cause.RESET:
            self._ticker.forget()
        self._ticker.start_afresh()
        self._inbox.start_afresh()

    @property
    def stamp(self) -> int | None:
        """Return the stamp of the odometry that a plan would start from [ns]; None without."""
        known = None if self._inbox.missing else self._inbox.odometry
        return None if known is None else known.stamp.nanoseconds

    @property
    def tick(self) -> Tick | None:
        """Return the decision behind the last answer; None before the first."""
        return None if self._report is None else self._report.tick

    def plan(
        self, now: float, advanced: float, solve_time_ms: float | None = None
    ) -> dict[str, Any]:
        """Answer the latest odometry with a plan, or with what stands in for one.

        Args:
            now: on the steady clock [s].
            advanced: how far the measurement is advanced, to when the answer takes effect [s].
            solve_time_ms: to report; by default what was measured.
        """
        known = self._inbox.odometry
        assert known is not None
        at = RosTime(known.stamp.nanoseconds + round(advanced * SECOND))
        report = self._ticker.planned(self._inbox, now, at)
        if report.solve_time_ms and solve_time_ms is not None:
            report = replace(report, solve_time_ms=solve_time_ms)
        return self._messages(known.stamp, replace(report, binding=prices(report.tick)))

    def be_safe(self, stamp: int, reason: Reason) -> dict[str, Any]:
        """Answer with the safe command, for a reason that is no solver's."""
        known = self._inbox.odometry
        frames = self._settings.frames if known is None else known.stamp.frames
        return self._messages(Stamp(stamp, frames), self._ticker.safe(self._inbox, reason))

    def went_out(self, at: float, pushed: float | None = None, rate: Array | None = None) -> None:
        """Learn what was really commanded; by default the last answer.

        Args:
            at: when, on the ROS clock [s].
            pushed: speed [m/s] or, at translation order 2, force [N].
            rate: body rate, shape (3,) [rad/s].
        """
        assert self._report is not None
        problem, command = self._settings.problem, self._report.tick.command
        if pushed is not None:
            weight = 1.0 if problem.translation_order == 1 else self._settings.mass
            command = replace(command, speed_fraction=pushed / (weight * problem.forward))
        if rate is not None:
            command = replace(command, body_rate=rate[-len(command.body_rate) :].copy())
        self._ticker.went_out(command, at)

    def _messages(self, stamp: Stamp, report: Report) -> dict[str, Any]:
        self._report = report
        known = self._inbox.odometry is not None
        return {
            **command_messages(self._settings, stamp, report.tick.command),
            **report_messages(self._settings, stamp, report, self._node, oriented=known),
        }
