"""What the planner answers to an odometry message, and why; publishing it is not done here."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.command import Command, flaw
from orbimpc_ros.mpc.loop.controller import Controller, Tick
from orbimpc_ros.mpc.loop.delay import Leg, Sent, advanced
from orbimpc_ros.mpc.loop.odometry import Odometry
from orbimpc_ros.mpc.loop.safety import safe_command
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.ros.arrival import UNKNOWN, Arrival, RosTime
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.ros.planner.inbox import Inbox
from orbimpc_ros.ros.reports import Report, report_of, safe_report
from orbimpc_ros.ros.timing import Timing


def prepared(settings: PlannerSettings) -> tuple[PlannerSettings, Controller]:
    """Return the settings with a controller compiled for them."""
    controller = Controller(
        settings.problem,
        projection=settings.projection,
        shrinking=settings.shrinking,
        gap_tolerance=settings.gap_tolerance,
        safe=settings.safe_command,
    )
    return settings, controller


@dataclass(frozen=True)
class Answer:
    """What the vehicle is told.

    Attributes:
        command: what to do.
        report: what the tick came to.
        tick: behind the command; None if nothing was planned.
    """

    command: Command
    report: Report
    tick: Tick | None = None

    @property
    def plan(self) -> Plan | None:
        """Return the plan behind the command, if there is one."""
        return None if self.tick is None else self.tick.plan


class Ticker:
    """Makes answers of what the inbox knows, by a plan or by what is safe.

    Args:
        settings: of the planner.
        controller: compiled for them.
        simulated: whether time stands still while a tick is computed.
        names: of the inbox's topics as they are resolved; by default as they are.

    Attributes:
        inbox: what the planner has been told.
        timing: of its ticks.
        latest: the last answer that went out, if any.
    """

    def __init__(
        self,
        settings: PlannerSettings,
        controller: Controller,
        *,
        simulated: bool,
        names: Mapping[str, str] | None = None,
    ) -> None:
        self._settings, self._controller, self._simulated = settings, controller, simulated
        self._sent = Sent()
        self.inbox = Inbox(settings) if names is None else Inbox(settings, names)
        self.timing = Timing()
        self.latest: Answer | None = None

    def install(self, settings: PlannerSettings, controller: Controller) -> None:
        """Go on with other settings and the controller made for them."""
        controller.continue_from(self._controller)
        self._settings, self._controller = settings, controller
        self.inbox.adopt(settings)

    def forget(self) -> None:
        """Forget inputs, plan and what was commanded."""
        self.inbox.forget()
        self._sent.forget()
        self._controller.reset()

    def planned(self, now: float, ros: RosTime = UNKNOWN) -> Answer:
        """Return the answer by a plan, if there is one; nothing in the inbox may be missing."""
        begun = time.perf_counter()
        arrival, settings = self.inbox.odometry, self._settings
        assert arrival is not None
        odometry = advanced(settings.problem, arrival.value, self._legs(arrival, ros))
        lost = self.inbox.stale_goal(now, ros)
        if lost:
            tick = self._controller.hold(odometry, lost)
        else:
            targets = self.inbox.targets(self._controller.remaining, now, ros, odometry.time)
            end = begun + settings.deadline
            tick = self._controller.tick(odometry, targets, lambda: time.perf_counter() > end)
        took = time.perf_counter() - begun
        self.timing.took(took, settings.deadline, settings.problem.step)
        report = report_of(tick, 0.0 if lost else 1e3 * took)
        report = replace(
            report,
            advanced=odometry.time - arrival.value.time,
            goal_stamps=self.inbox.goal_stamps,
            goal_counts=dict(self.inbox.goal_counts),
        )
        return self._checked(Answer(tick.command, report, tick))

    def safe(self, reason: str) -> Answer:
        """Return the safe answer."""
        return self._checked(Answer(self._safe_command(), safe_report(reason)))

    def went_out(self, answer: Answer, at: float) -> None:
        """Learn that an answer was published at a time of the ROS clock [s]."""
        self.latest = answer
        self._sent.add(answer.command, at)
        self._controller.commanded(answer.command.speed_fraction)

    def _legs(self, arrival: Arrival[Odometry], ros: RosTime) -> list[Leg]:
        """Return what is in force from the measurement until the answer to it is there."""
        if not self._settings.delay_compensation or not arrival.timed or ros.nanoseconds is None:
            return []
        now = ros.nanoseconds / SECOND
        taking = 0.0 if self._simulated else self.timing.expected
        return self._sent.legs(now - arrival.delay(ros), now + taking)

    def _safe_command(self) -> Command:
        settings = self._settings
        fraction = 0.0 if self.latest is None else self.latest.command.speed_fraction
        return safe_command(settings.safe_command, settings.problem, self._attitude, fraction)

    @property
    def _attitude(self) -> Array:
        known = self.inbox.odometry
        return np.eye(self._settings.problem.dimension) if known is None else known.value.attitude

    def _checked(self, answer: Answer) -> Answer:
        """Return the answer, or the safe one if its command must not be sent, whatever led to it.

        Raises:
            RuntimeError: the safe command itself must not be sent, which its own law excludes.
        """
        safe = answer.plan is None
        stopping = safe and self._settings.stopping
        wrong = flaw(self._settings.problem, answer.command, stopping=stopping)
        if not wrong:
            return answer
        if safe:
            raise RuntimeError(f'the safe command is not sent: {wrong}')
        return self.safe(f'not sent: {wrong}')
