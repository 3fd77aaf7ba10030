"""The planner's answers made anew: the node's own validators, forecasts and controller.

What was planned is solved again; when it was planned is timing, and taken from the recording. So
is which tick was not planned at all (an input was stale, the planner was disabled) and what was
really commanded on the tick before: one difference does not cause all that follow.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
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
from orbimpc_ros.tool.regression.recording import Input, Recorded, Recording
from orbimpc_ros.tool.stamps import SECOND

NODE = 'planner'
AFRESH = 'starting afresh'  # why the planner commands what is safe when it has forgotten all


@dataclass(frozen=True)
class Replayed:
    """An answer made anew.

    Attributes:
        recorded: what was answered then.
        messages: what is answered now, by topic.
        refusals: what the validators said of the inputs since the answer before.
    """

    recorded: Recorded
    messages: dict[str, Any]
    refusals: tuple[str, ...]


class Replay:
    """Answers a recording's inputs, one tick after the other.

    Args:
        recording: the inputs, and when they were answered.
        settings: of the planner.
    """

    def __init__(self, recording: Recording, settings: PlannerSettings) -> None:
        self._settings, self._answers = settings, recording.answers
        self._inputs = deque(recording.inputs)
        self._odometry = {each.stamp for each in recording.inputs if each.topic == 'odom'}
        self._node = f'{recording.namespace}/{NODE}'
        self._inbox = Inbox(settings)
        self._controller = Controller(
            settings.problem,
            projection=settings.projection,
            shrinking=settings.shrinking,
            gap_tolerance=settings.gap_tolerance,
        )
        self._fraction = 0.0

    def answers(self) -> Iterator[Replayed]:
        """Yield an answer for each that was recorded."""
        for recorded in self._answers:
            refusals = tuple(self._hear(recorded))
            if recorded.answer.reason == AFRESH:
                self._inbox.forget()
                self._controller.reset()
            told = self._planned(recorded) or self._safe(recorded)
            self._fraction = self._flown(recorded)
            self._controller.commanded(self._fraction)
            yield Replayed(recorded, told, refusals)

    def _hear(self, recorded: Recorded) -> Iterator[str]:
        """Take in what had come by then: at least the odometry that is answered."""
        awaited = recorded.stamp in self._odometry
        known = recorded.sent - round(1e6 * _solve_time_ms(recorded))
        while self._inputs:
            each = self._inputs[0]
            if not awaited and (each.sent > known or each.topic == 'odom'):
                return
            refusal = self._take(self._inputs.popleft())
            if refusal:
                yield refusal
            if each.topic == 'odom' and each.stamp == recorded.stamp:
                awaited = False
                # At once by a clock of stamps: what carries the same stamp came before the answer.
                known = max(known, each.sent)

    def _take(self, told: Input) -> str:
        take = {
            'odom': self._inbox.take_odometry,
            'goal': self._inbox.take_goal,
            'goal_path': self._inbox.take_path,
        }[told.topic]
        return take(told.message, told.sent / SECOND)

    def _planned(self, recorded: Recorded) -> dict[str, Any] | None:
        odometry = self._inbox.odometry
        if not recorded.answer.solved or self._inbox.missing or odometry is None:
            return None
        if odometry.stamp.nanoseconds != recorded.stamp:
            return None
        targets = self._inbox.targets(self._controller.remaining, recorded.sent / SECOND)
        tick = self._controller.tick(odometry.value, targets)
        report = report_of(tick, _solve_time_ms(recorded))
        command = self._safe_command() if tick.fallback == SAFE else tick.command
        return self._told(odometry.stamp, command, report, tick.plan)

    def _safe(self, recorded: Recorded) -> dict[str, Any]:
        known = self._inbox.odometry
        frames = self._settings.frames if known is None else known.stamp.frames
        reason = 'not answered' if recorded.answer.solved else recorded.answer.reason or ''
        stamp = Stamp(recorded.stamp, frames)
        return self._told(stamp, self._safe_command(), safe_report(reason), None)

    def _safe_command(self) -> Command:
        problem, known = self._settings.problem, self._inbox.odometry
        attitude = np.eye(problem.dimension) if known is None else known.value.attitude
        return safe_command(self._settings.safe_command, problem, attitude, self._fraction)

    def _told(
        self, stamp: Stamp, command: Command, report: Report, plan: Plan | None
    ) -> dict[str, Any]:
        told = outputs.orders(self._settings, stamp, command)
        told |= outputs.reports(self._settings, stamp, report, plan, self._node)
        if self._inbox.odometry is not None:
            told['rotation'] = messages.rotation_message(stamp, command)
        return told

    def _flown(self, recorded: Recorded) -> float:
        """Return the share of full speed or thrust that was really commanded."""
        problem, answer = self._settings.problem, recorded.answer
        if problem.translation_order == 1:
            pushed = answer.speed
        else:
            pushed = None if answer.force is None else answer.force / self._settings.mass
        return self._fraction if pushed is None else pushed / problem.forward


def _solve_time_ms(recorded: Recorded) -> float:
    return recorded.answer.solve_time_ms or 0.0


def before(recording: Recording, tick: int) -> Recording:
    """Return the recording up to and including a tick."""
    return replace(recording, answers=recording.answers[: tick + 1])
