"""The planner without a node: its own validators, forecasts, controller and messages."""

from __future__ import annotations

from typing import Any

import numpy as np

from orbimpc_ros.mpc.command import Command
from orbimpc_ros.mpc.controller import Controller
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.ros import messages, outputs
from orbimpc_ros.ros.inbox import Inbox
from orbimpc_ros.ros.messages import Stamp
from orbimpc_ros.ros.planner_parameters import PlannerSettings
from orbimpc_ros.ros.reports import SAFE, Report, report_of, safe_report
from orbimpc_ros.ros.safety import safe_command

Told = dict[str, Any]  # messages by topic


class Pilot:
    """Takes in messages and answers, when it is told to, with what the planner would publish.

    Args:
        settings: of the planner.
        node: its name.
    """

    def __init__(self, settings: PlannerSettings, node: str = '/planner') -> None:
        self._settings, self._node = settings, node
        self._inbox = Inbox(settings)
        self._controller = Controller(
            settings.problem,
            projection=settings.projection,
            shrinking=settings.shrinking,
            gap_tolerance=settings.gap_tolerance,
        )
        self._fraction = 0.0

    def hear(self, topic: str, message: Any, now: float) -> str:
        """Take in an input that came ``now`` [s]; return why it was refused, or an empty string."""
        take = {
            'odom': self._inbox.take_odometry,
            'goal': self._inbox.take_goal,
            'goal_path': self._inbox.take_path,
        }[topic]
        return take(message, now)

    def forget(self) -> None:
        """Start afresh."""
        self._inbox.forget()
        self._controller.reset()

    @property
    def stamp(self) -> int | None:
        """Return the stamp of the odometry that a plan would start from [ns]; None without."""
        odometry = self._inbox.odometry
        return None if self._inbox.missing or odometry is None else odometry.stamp.nanoseconds

    def plan(self, now: float, solve_time_ms: float) -> Told:
        """Answer the latest odometry ``now`` [s] with a plan, or with what stands in for one."""
        odometry = self._inbox.odometry
        assert odometry is not None
        targets = self._inbox.targets(self._controller.remaining, now)
        tick = self._controller.tick(odometry.value, targets)
        command = self._safe_command() if tick.fallback == SAFE else tick.command
        report = report_of(tick, solve_time_ms)
        return self._told(odometry.stamp, command, report, tick.plan)

    def be_safe(self, stamp: int, reason: str) -> Told:
        """Answer with the safe command, for a reason that is no solver's."""
        known = self._inbox.odometry
        frames = self._settings.frames if known is None else known.stamp.frames
        return self._told(Stamp(stamp, frames), self._safe_command(), safe_report(reason), None)

    def commanded(self, pushed: float | None) -> None:
        """Learn what was really commanded: a speed [m/s] or a force [N]; None if not known."""
        problem = self._settings.problem
        if pushed is not None:
            full = problem.forward * (
                1.0 if problem.translation_order == 1 else self._settings.mass
            )
            self._fraction = pushed / full
        self._controller.commanded(self._fraction)

    def _safe_command(self) -> Command:
        problem, known = self._settings.problem, self._inbox.odometry
        attitude = np.eye(problem.dimension) if known is None else known.value.attitude
        return safe_command(self._settings.safe_command, problem, attitude, self._fraction)

    def _told(self, stamp: Stamp, command: Command, report: Report, plan: Plan | None) -> Told:
        told = outputs.orders(self._settings, stamp, command)
        told |= outputs.reports(self._settings, stamp, report, plan, self._node)
        if self._inbox.odometry is not None:
            told['rotation'] = messages.rotation_message(stamp, command)
        return told
