# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner's core with its clock given: messages in, and the messages that answer them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from orbimpc_ros.loop.planner import Decision
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.outcome import Reason
from orbimpc_ros.ros.clock import UNKNOWN, RosTime
from orbimpc_ros.ros.messages import SECOND, Stamp
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.ros.planner.core import Core, planner_of
from orbimpc_ros.ros.planner.inputs import PLAN, others
from orbimpc_ros.ros.planner.outputs import command_messages, report_messages
from orbimpc_ros.ros.reports import Report, prices


def resolved(settings: PlannerSettings, namespace: str) -> tuple[str, ...]:
    """Return the full names of the topics of other vehicles' plans, as a node would make them."""

    def resolve(topic: str) -> str:
        return topic if topic.startswith('/') else f'{namespace}/{topic}'

    return others(settings.avoid, resolve(PLAN), resolve)


class OfflinePlanner(Core):
    """Answers with what the planner would publish.

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
        super().__init__(*planner_of(settings), clock=clock, others=avoided)
        self._node = node
        self._report: Report | None = None

    @property
    def stamp(self) -> int | None:
        """Return the stamp of the odometry that a plan would start from [ns]; None without."""
        known = None if self.inputs.missing else self.inputs.odometry
        return None if known is None else known.stamp.nanoseconds

    @property
    def decision(self) -> Decision | None:
        """Return the decision behind the last answer; None before the first."""
        return None if self._report is None else self._report.decision

    def plan(
        self, now: float, advanced: float, solve_time_ms: float | None = None
    ) -> dict[str, Any]:
        """Answer the latest odometry with a plan, or with what stands in for one.

        Args:
            now: on the steady clock [s].
            advanced: how far the measurement is advanced, to when the answer takes effect [s].
            solve_time_ms: to report; by default what was measured.
        """
        known = self.inputs.odometry
        assert known is not None
        at = RosTime(known.stamp.nanoseconds + round(advanced * SECOND))
        report = self.decide(now, at, fresh=True)
        if report.solve_time_ms and solve_time_ms is not None:
            report = replace(report, solve_time_ms=solve_time_ms)
        return self._messages(known.stamp, replace(report, binding=prices(report.decision)))

    def be_safe(self, stamp: int, reason: Reason) -> dict[str, Any]:
        """Answer with the safe command, for a reason that is no solver's."""
        known = self.inputs.odometry
        frames = self.settings.frames if known is None else known.stamp.frames
        return self._messages(Stamp(stamp, frames), self.decide(0.0, UNKNOWN, reason))

    def went_out(self, at: float, pushed: float | None = None, rate: Array | None = None) -> None:
        """Learn what was really commanded; by default the last answer.

        Args:
            at: when, on the ROS clock [s].
            pushed: speed [m/s] or, at translation order 2, force [N].
            rate: body rate, shape (3,) [rad/s].
        """
        assert self._report is not None
        problem, command = self.settings.problem, self._report.decision.command
        if pushed is not None:
            weight = 1.0 if problem.translation_order == 1 else self.settings.mass
            command = replace(command, speed_fraction=pushed / (weight * problem.forward))
        if rate is not None:
            command = replace(command, body_rate=rate[-len(command.body_rate) :].copy())
        self.sent(command, at)

    def _messages(self, stamp: Stamp, report: Report) -> dict[str, Any]:
        self._report = report
        known = self.inputs.odometry is not None
        return {
            **command_messages(self.settings, stamp, report.decision.command),
            **report_messages(self.settings, stamp, report, self._node, oriented=known),
        }
