"""The planner node: odometry and goal in, a checked command out, at each odometry or step."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, QuaternionStamped, TwistStamped, WrenchStamped
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.qos import ReliabilityPolicy
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from orbimpc_ros.mpc.command import Command
from orbimpc_ros.mpc.controller import Controller, Tick
from orbimpc_ros.mpc.odometry import Odometry
from orbimpc_ros.ros import messages, outputs
from orbimpc_ros.ros.inbox import Inbox
from orbimpc_ros.ros.messages import Stamp
from orbimpc_ros.ros.parameters import PLANNER, Live, PlannerSettings, planner_settings
from orbimpc_ros.ros.process import LIFE, Guarded, qos, run
from orbimpc_ros.ros.reports import (
    OK,
    SAFE,
    WARN,
    Report,
    diagnostics,
    prices,
    report_of,
    safe_report,
)
from orbimpc_ros.ros.safety import safe_command

GOAL_PATIENCE = 0.1  # [s] to wait for the goal that belongs to an odometry message
WATCH = 0.05  # [s] how often the inputs' age is looked at, at least
HEALTH = 1.0  # [s] how often diagnostics are published, at least


def prepared(settings: PlannerSettings) -> tuple[PlannerSettings, Controller]:
    """Return the settings with a controller compiled for them."""
    controller = Controller(
        settings.problem,
        projection=settings.projection,
        shrinking=settings.shrinking,
        gap_tolerance=settings.gap_tolerance,
    )
    return settings, controller


class Planner(Guarded):
    """Messages to types, types to the controller, its ticks to messages; and a watch on all."""

    def __init__(self) -> None:
        super().__init__('planner')
        self._enabled = True
        self._commanded = -np.inf  # when a command went out last, on the steady clock [s]
        self._answered = -1  # stamp of the odometry that was answered last [ns]
        self._answer: dict[str, Any] = {}
        self._fraction = 0.0
        self._report: Report | None = None
        self._shown: tuple[bytes, str] = (OK, '')
        live = Live(self, PLANNER, planner_settings, prepared)
        self._settings, self._controller = live.prepared
        self._inbox = Inbox(self._settings)
        self._create_publishers()
        self._create_subscriptions()
        self._create_timers()
        live.keep(self._install)

    def _install(self, prepared: tuple[PlannerSettings, Controller]) -> None:
        settings, controller = prepared
        controller.continue_from(self._controller)
        self._settings, self._controller = settings, controller
        self._inbox.adopt(self._settings)

    # --- wiring

    def _create_publishers(self) -> None:
        kinds = {
            'cmd_vel': TwistStamped,
            'rotation': QuaternionStamped,
            'plan': Path,
            'plan_markers': MarkerArray,
            'tick': DiagnosticArray,
        }
        if self._settings.problem.translation_order == 2:
            kinds['cmd_thrust'] = WrenchStamped
        self._outputs = {
            topic: self.create_publisher(kind, topic, qos(lease=LIFE))
            for topic, kind in kinds.items()
        }
        self._health = self.create_publisher(DiagnosticArray, '/diagnostics', qos())

    def _create_subscriptions(self) -> None:
        latest = qos(1, ReliabilityPolicy.BEST_EFFORT)
        for kind, topic, callback in (
            (OdometryMessage, 'odom', self._on_odometry),
            (PoseStamped, 'goal', self._on_goal),
            (Path, 'goal_path', self._on_path),
        ):
            self.create_subscription(kind, topic, self.guard(callback), latest)
        self.create_service(Trigger, '~/reset', self.guard(self._on_reset))
        self.create_service(SetBool, '~/enable', self.guard(self._on_enable))

    def _create_timers(self) -> None:
        step = self._settings.problem.step
        if not self._settings.on_odometry:
            # In ROS time: simulated time sets the pace. Everything that watches is steady.
            self.create_timer(step, self.guard(self._on_timer))
        self._patience = self.every(0.5 * GOAL_PATIENCE, self._on_patience)
        self._patience.cancel()
        self.every(min(WATCH, 0.5 * step), self._watch)
        self.every(HEALTH, self._show_health)
        backwards = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
        )
        self._jumps = self.get_clock().create_jump_callback(
            backwards, post_callback=self.guard(self._on_clock_went_back)
        )

    # --- inputs

    def _on_odometry(self, message: OdometryMessage) -> None:
        refusal = self._inbox.take_odometry(message, self.steady_now())
        if refusal:
            self._refuse(refusal)
            self._repeat_answer(message)
        elif self._settings.on_odometry:
            self._tick_or_wait()

    def _on_goal(self, message: PoseStamped) -> None:
        self._took_goal(self._inbox.take_goal(message, self.steady_now()))

    def _on_path(self, message: Path) -> None:
        self._took_goal(self._inbox.take_path(message, self.steady_now()))

    def _took_goal(self, refusal: str) -> None:
        if refusal:
            self._refuse(refusal)
        elif self._settings.on_odometry and self._unanswered and self._inbox.complete:
            self._plan_now()

    @property
    def _unanswered(self) -> bool:
        """Return whether an odometry message still waits for its goal."""
        odometry = self._inbox.odometry
        if odometry is None or self._inbox.stale(self.steady_now()):
            return False
        return odometry.stamp.nanoseconds != self._answered

    def _refuse(self, refusal: str) -> None:
        self.get_logger().warning(refusal, throttle_duration_sec=1.0)
        self._show_health()

    def _repeat_answer(self, message: OdometryMessage) -> None:
        """Answer again who asks again: the first answer may have been lost in discovery."""
        stamp = message.header.stamp.sec * messages.SECOND + message.header.stamp.nanosec
        if stamp == self._answered and not self._unsafe():
            self._send(self._answer)

    def _tick_or_wait(self) -> None:
        """Plan, once the goal of the odometry's own stamp is there too.

        DDS does not order topics. A source that stamps both alike, such as the simulator in
        lock-step, means them to be used together; then runs repeat exactly.
        """
        if self._inbox.complete:
            self._plan_now()
        elif self._inbox.missing:
            self._show_health(changed_only=True)
        elif self._patience.is_canceled():
            self._waits = 0
            self._patience.reset()

    def _on_patience(self) -> None:
        # On the second call only: after a stall, a goal that lies waiting gets its turn first.
        self._waits += 1
        if self._waits == 2:
            self._inbox.synchronised.clear()
            self._plan_now()

    def _on_timer(self) -> None:
        self._plan_now()

    # --- a tick

    def _plan_now(self) -> None:
        self._patience.cancel()
        if self._inbox.missing:
            self._show_health()
            return
        unsafe = self._unsafe()
        odometry = self._inbox.odometry
        assert odometry is not None
        if unsafe:
            self._command_safe(unsafe, odometry.stamp)
        else:
            self._command_plan(odometry.stamp, odometry.value)
        self._answered = odometry.stamp.nanoseconds

    def _unsafe(self) -> str:
        """Return why no plan may be followed now; empty if one may."""
        return self._inbox.stale(self.steady_now()) if self._enabled else 'disabled'

    def _command_plan(self, stamp: Stamp, odometry: Odometry) -> None:
        begun = time.perf_counter()
        end = begun + self._settings.deadline
        targets = self._inbox.targets(self._controller.remaining, self.steady_now())
        tick = self._controller.tick(odometry, targets, lambda: time.perf_counter() > end)
        report = report_of(tick, 1e3 * (time.perf_counter() - begun))
        command = self._safe_command() if tick.fallback == SAFE else tick.command
        self._publish(stamp, command, report, tick)

    def _command_safe(self, reason: str, stamp: Stamp) -> None:
        self._publish(stamp, self._safe_command(), safe_report(reason), None)

    def _safe_command(self) -> Command:
        problem = self._settings.problem
        known = self._inbox.odometry
        attitude = np.eye(problem.dimension) if known is None else known.value.attitude
        return safe_command(self._settings.safe_command, problem, attitude, self._fraction)

    def _publish(self, stamp: Stamp, command: Command, report: Report, tick: Tick | None) -> None:
        orders = outputs.orders(self._settings, stamp, command)
        self._send(orders)  # the vehicle first; who only watches can wait for the rest
        plan = None if tick is None else tick.plan
        if tick is not None:
            report = replace(report, binding=prices(tick))
        told = outputs.reports(self._settings, stamp, report, plan, self.get_fully_qualified_name())
        if self._inbox.odometry is not None:
            told['rotation'] = messages.rotation_message(stamp, command)
        self._send(told)
        self._answer = orders | told
        self._fraction = command.speed_fraction
        self._controller.commanded(command.speed_fraction)
        self._report = report
        if report.reason and report.fallback:
            self.get_logger().warning(
                f'{report.fallback}: {report.reason}', throttle_duration_sec=1
            )
        self._show_health(changed_only=True)

    def _send(self, told: dict[str, Any]) -> None:
        for topic, message in told.items():
            self._outputs[topic].publish(message)
        self._commanded = self.steady_now()

    # --- watching

    def safe(self, reason: str) -> None:
        """Command what is safe, now."""
        self._command_safe(reason, self._stamp_now())

    def _stamp_now(self) -> Stamp:
        """Return a stamp of now that is no answer to any odometry."""
        now = max(self.get_clock().now().nanoseconds, self._answered + 1)
        known = self._inbox.odometry
        return Stamp(now, self._settings.frames if known is None else known.stamp.frames)

    def _watch(self) -> None:
        """Repeat the safe command every step while it is not safe to follow a plan."""
        flying = np.isfinite(self._commanded) or not self._enabled
        due = self.steady_now() - self._commanded >= self._settings.problem.step
        unsafe = self._unsafe() or (self._inbox.missing and f'waits for {self._inbox.missing}')
        if flying and due and unsafe:
            self.safe(unsafe)

    def _on_clock_went_back(self, _jump: Any) -> None:
        self.get_logger().warning('the clock went back: starting afresh')
        self._start_afresh()

    def _start_afresh(self) -> None:
        self._patience.cancel()
        self._inbox.forget()
        self._controller.reset()
        self._answered = -1
        if np.isfinite(self._commanded):
            self.safe('starting afresh')

    def _on_reset(self, _request: Any, response: Any) -> Any:
        self._start_afresh()
        response.success, response.message = True, 'inputs and plan forgotten'
        return response

    def _on_enable(self, request: Any, response: Any) -> Any:
        self._enabled = request.data
        if not self._enabled:
            self.safe('disabled')
        response.success = True
        response.message = 'enabled' if self._enabled else 'disabled: safe command'
        self._show_health(changed_only=True)
        return response

    # --- diagnostics

    def _show_health(self, changed_only: bool = False) -> None:
        level, message = self._condition()
        if message != self._shown[1] and message.startswith('waits'):
            self.get_logger().info(message)
        if changed_only and level == self._shown[0]:
            return
        self._shown = level, message
        values = {
            'waits_for': self._inbox.missing,
            'enabled': self._enabled,
            **{f'refused {what}': count for what, count in self._inbox.refused.items()},
        }
        now, name = self.get_clock().now().nanoseconds, self.get_fully_qualified_name()
        self._health.publish(diagnostics(now, name, level, message, values))

    def _condition(self) -> tuple[bytes, str]:
        if not self._enabled:
            return WARN, 'disabled'
        if self._inbox.missing:
            return WARN, f'waits for {self._inbox.missing}'
        if self._report is None:
            return OK, 'ready'
        return self._report.level, self._report.reason or 'planning'


def main(argv: Sequence[str] | None = None) -> int:
    """Run the planner; return the exit code."""
    return run(Planner, argv)


if __name__ == '__main__':
    sys.exit(main())
