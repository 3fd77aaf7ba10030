"""The planner node: odometry and goal in, a checked command out, at each odometry or step."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from rclpy.clock import JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import ReliabilityPolicy
from std_srvs.srv import SetBool, Trigger

from orbimpc_ros.mpc.command import Command, flaw, stop
from orbimpc_ros.mpc.controller import Controller, Tick
from orbimpc_ros.mpc.delay import Leg, Sent, advanced
from orbimpc_ros.mpc.odometry import Odometry
from orbimpc_ros.ros import messages, outputs
from orbimpc_ros.ros.arrival import Arrival, RosTime
from orbimpc_ros.ros.health import Condition, Health
from orbimpc_ros.ros.inbox import Inbox
from orbimpc_ros.ros.messages import SECOND, Stamp
from orbimpc_ros.ros.outlet import Outlet
from orbimpc_ros.ros.parameters import PLANNER, Live, PlannerSettings, planner_settings
from orbimpc_ros.ros.process import Guarded, qos, run
from orbimpc_ros.ros.reports import ERROR, OK, SAFE, WARN, Report, prices, report_of, safe_report
from orbimpc_ros.ros.safety import safe_command
from orbimpc_ros.ros.timing import Timing
from orbimpc_ros.ros.watch import Watch

GOAL_PATIENCE = 0.1  # [s] to wait for the goal that belongs to an odometry message
WATCH = 0.05  # [s] how often the inputs' age is looked at, at least
REFUSED = 1.0  # [s] for which a refused message is a reason to warn
AFRESH = 'starting afresh'


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
        self._answered = -1  # stamp of the odometry that was answered last [ns]
        self._fraction = 0.0
        self._report: Report | None = None
        self._refusal, self._refused_at = '', -np.inf
        self._simulated = bool(self.get_parameter('use_sim_time').value)  # refused from then on
        live = Live(self, PLANNER, planner_settings, prepared)
        self._settings, self._controller = live.prepared
        self._inbox, self._sent, self._timing = Inbox(self._settings), Sent(), Timing()
        self._outlet = Outlet(self, self._settings.problem.translation_order == 2)
        self._health = Health(self, self._condition, self._counts)
        self._create_subscriptions()
        self._create_timers()
        live.keep(self._install)

    def _install(self, prepared: tuple[PlannerSettings, Controller]) -> None:
        settings, controller = prepared
        controller.continue_from(self._controller)
        self._settings, self._controller = settings, controller
        self._inbox.adopt(self._settings)

    # --- wiring

    def _create_subscriptions(self) -> None:
        odometry, _, _ = (
            self.create_subscription(
                kind,
                topic,
                self.guard(callback),
                qos(1, ReliabilityPolicy.BEST_EFFORT),
                event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            )
            for kind, topic, callback in (
                (OdometryMessage, 'odom', self._on_odometry),
                (PoseStamped, 'goal', self._on_goal),
                (Path, 'goal_path', self._on_path),
            )
        )
        self._surroundings = Watch(self, odometry, self._outlet.velocity)
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
        threshold = JumpThreshold(
            min_forward=Duration(seconds=step),  # how far lock-step moves it at once
            min_backward=Duration(nanoseconds=-1),
            on_clock_change=False,
        )
        self._jumps = self.get_clock().create_jump_callback(
            threshold, post_callback=self.guard(self._on_jump)
        )

    # --- time

    def _ros(self) -> RosTime:
        """Return the time of ROS; simulated time is zero until it starts."""
        now = self.get_clock().now().nanoseconds
        if not self._simulated:
            return RosTime(now)
        return RosTime(now or None, self._settings.problem.step)

    def _stamp_now(self) -> Stamp:
        """Return a stamp of now that is no answer to any odometry."""
        now = max(self.get_clock().now().nanoseconds, self._answered + 1)
        known = self._inbox.odometry
        return Stamp(now, self._settings.frames if known is None else known.stamp.frames)

    # --- inputs

    def _on_odometry(self, message: OdometryMessage) -> None:
        refusal = self._inbox.take_odometry(message, self.steady_now(), self._ros())
        if refusal:
            self._refuse(refusal)
            self._repeat_answer(message)
        elif self._settings.on_odometry:
            self._tick_or_wait()

    def _on_goal(self, message: PoseStamped) -> None:
        self._took_goal(self._inbox.take_goal(message, self.steady_now(), self._ros()))

    def _on_path(self, message: Path) -> None:
        self._took_goal(self._inbox.take_path(message, self.steady_now(), self._ros()))

    def _took_goal(self, refusal: str) -> None:
        if refusal:
            self._refuse(refusal)
        elif self._settings.on_odometry and self._unanswered and self._inbox.complete:
            self._plan_now()

    @property
    def _unanswered(self) -> bool:
        """Return whether an odometry message still waits for its goal."""
        odometry = self._inbox.odometry
        if odometry is None or self._inbox.stale_odometry(self.steady_now(), self._ros()):
            return False
        return odometry.stamp.nanoseconds != self._answered

    def _refuse(self, refusal: str) -> None:
        self.get_logger().warning(refusal, throttle_duration_sec=1.0)
        self._refusal, self._refused_at = refusal, self.steady_now()
        self._health.show_changes()

    def _repeat_answer(self, message: OdometryMessage) -> None:
        """Answer again who asks again: the first answer may have been lost in discovery."""
        stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
        if stamp == self._answered and not self._unsafe():
            self._outlet.repeat()

    def _tick_or_wait(self) -> None:
        """Plan, once the goal of the odometry's own stamp is there too.

        DDS does not order topics. A source that stamps both alike, such as the simulator in
        lock-step, means them to be used together; then runs repeat exactly.
        """
        if self._inbox.complete:
            self._plan_now()
        elif self._inbox.missing:
            self._health.show_changes()
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
        self._timing.began(self.get_clock().now().nanoseconds / SECOND, self._settings.problem.step)
        self._plan_now()

    # --- a tick

    def _plan_now(self) -> None:
        self._patience.cancel()
        odometry = self._inbox.odometry
        if odometry is None or self._inbox.missing:
            self._health.show_changes()
            return
        unsafe = self._unsafe()
        if unsafe:
            self._command_safe(unsafe, odometry.stamp)
        else:
            self._command_plan(odometry)
        self._answered = odometry.stamp.nanoseconds

    def _unsafe(self) -> str:
        """Return why no plan may be followed now; empty if one may."""
        if not self._enabled:
            return 'disabled'
        stale = self._inbox.stale_odometry(self.steady_now(), self._ros())
        return stale or self._surroundings.sources

    def _command_plan(self, arrival: Arrival[Odometry]) -> None:
        begun = time.perf_counter()
        odometry = advanced(self._settings.problem, arrival.value, self._legs(arrival))
        tick, solved = self._planned(odometry, begun + self._settings.deadline)
        took = time.perf_counter() - begun
        settings = self._settings
        on_time = not settings.on_odometry
        self._timing.took(took, settings.deadline, settings.problem.step, on_time)
        outdated = self._unsafe()  # by a tick that took too long
        if outdated:
            self._command_safe(outdated, arrival.stamp)
            return
        ahead = odometry.time - arrival.value.time
        report = replace(report_of(tick, 1e3 * took if solved else 0.0), advanced=ahead)
        command = self._safe_command() if tick.fallback == SAFE else tick.command
        self._publish(arrival.stamp, command, report, tick)

    def _planned(self, odometry: Odometry, end: float) -> tuple[Tick, bool]:
        """Return the controller's tick, and whether it had a goal to plan towards."""
        now, ros = self.steady_now(), self._ros()
        lost = self._inbox.stale_goal(now, ros)
        if lost:
            return self._controller.hold(odometry, lost), False
        targets = self._inbox.targets(self._controller.remaining, now, ros, odometry.time)
        return self._controller.tick(odometry, targets, lambda: time.perf_counter() > end), True

    def _legs(self, arrival: Arrival[Odometry]) -> list[Leg]:
        """Return what is in force from the measurement until the answer to it is there."""
        ros = self._ros()
        if not self._settings.delay_compensation or not arrival.timed or ros.nanoseconds is None:
            return []
        now = ros.nanoseconds / SECOND
        # Simulated time stands still while a tick is computed.
        taking = 0.0 if self._simulated else self._timing.expected
        return self._sent.legs(now - arrival.delay(ros), now + taking)

    def _command_safe(self, reason: str, stamp: Stamp) -> None:
        self._publish(stamp, self._safe_command(), safe_report(reason), None)

    def _safe_command(self) -> Command:
        settings = self._settings
        return safe_command(settings.safe_command, settings.problem, self._attitude, self._fraction)

    @property
    def _attitude(self) -> np.ndarray:
        known = self._inbox.odometry
        return np.eye(self._settings.problem.dimension) if known is None else known.value.attitude

    def _publish(self, stamp: Stamp, command: Command, report: Report, tick: Tick | None) -> None:
        wrong = flaw(self._settings.problem, command)
        if wrong:  # nothing that was checked before leads here
            command, report, tick = stop(self._attitude), safe_report(f'not sent: {wrong}'), None
        self._outlet.begin(outputs.orders(self._settings, stamp, command))
        self._sent.add(command, self.get_clock().now().nanoseconds / SECOND)
        self._fraction = command.speed_fraction
        self._controller.commanded(command.speed_fraction)
        if tick is not None:
            report = replace(report, binding=prices(tick))
        self._report = report
        self._tell(stamp, command, report, tick)

    def _tell(self, stamp: Stamp, command: Command, report: Report, tick: Tick | None) -> None:
        plan = None if tick is None else tick.plan
        told = outputs.reports(self._settings, stamp, report, plan, self.get_fully_qualified_name())
        if self._inbox.odometry is not None:
            told['rotation'] = messages.rotation_message(stamp, command)
        self._outlet.add(told)
        if report.reason and report.fallback:
            said = f'{report.fallback}: {report.reason}'
            self.get_logger().warning(said, throttle_duration_sec=1)
        self._health.show_changes()

    # --- watching

    def safe(self, reason: str) -> None:
        """Command what is safe, now."""
        self._command_safe(reason, self._stamp_now())

    def _watch(self) -> None:
        """Repeat the safe command every step while it is not safe to follow a plan."""
        self._surroundings.look()
        stood = self._look_at_clock()
        unsafe = self._unsafe() or (self._inbox.missing and f'waits for {self._inbox.missing}')
        if not unsafe and self._simulated and stood > self._settings.odom_timeout:
            unsafe = f'the clock has stood still for {stood:.2f} s'
        flying = self._outlet.used or not self._enabled
        due = self.steady_now() - self._outlet.at >= self._settings.problem.step
        if flying and due and unsafe:
            self.safe(unsafe)
        self._health.show_changes()

    def _look_at_clock(self) -> float:
        """Start afresh if the system's clock was set; return how long time has stood still [s]."""
        jump = self._surroundings.jump()
        if not self._simulated and abs(jump) > self._settings.future_tolerance:
            self._start_afresh(f'the clock was set by {jump:.3g} s')
        return self._surroundings.standstill()

    def _on_jump(self, jump: TimeJump) -> None:
        """Start afresh if simulated time goes back, or on by more than makes inputs stale.

        A smaller step forward makes what is known as much older, which their ages tell.
        """
        by = jump.delta.nanoseconds
        if self.get_clock().now().nanoseconds == by:
            return  # it starts
        settings = self._settings
        largest = max(settings.odom_timeout, settings.goal_timeout) + settings.problem.step
        if by < 0 or by > largest * SECOND:
            self._start_afresh(f'the clock jumped by {by / SECOND:.3g} s')

    def _start_afresh(self, why: str) -> None:
        self.get_logger().warning(f'{AFRESH}: {why}')
        self._patience.cancel()
        self._inbox.forget()
        self._sent.forget()
        self._controller.reset()
        self._answered = -1
        if self._outlet.used:
            self.safe(AFRESH)

    def _on_reset(self, _request: Any, response: Any) -> Any:
        self._start_afresh('asked to')
        response.success, response.message = True, 'inputs and plan forgotten'
        return response

    def _on_enable(self, request: Any, response: Any) -> Any:
        self._enabled = request.data
        if not self._enabled:
            self.safe('disabled')
        response.success = True
        response.message = 'enabled' if self._enabled else 'disabled: safe command'
        self._health.show_changes()
        return response

    # --- diagnostics

    def _counts(self) -> dict[str, object]:
        refused = self._inbox.refused.items()
        return {
            'waits_for': self._inbox.missing,
            'enabled': self._enabled,
            'deadline misses': self._timing.misses,
            'overruns': self._timing.overruns,
            'callbacks failed': self.failures,
            **{f'refused {what}': count for what, count in refused},
        }

    def _condition(self) -> Condition:
        wrong = '; '.join(filter(None, (self._surroundings.sources, self._surroundings.mismatches)))
        if wrong:
            return ERROR, wrong
        if not self._enabled:
            return WARN, 'disabled'
        if self._inbox.missing:
            return WARN, f'waits for {self._inbox.missing}'
        level, message = OK, 'ready'
        if self._report is not None:
            level, message = self._report.level, self._report.reason or 'planning'
        return (level, message) if level != OK else self._notices(message)

    def _notices(self, message: str) -> Condition:
        """Return what to warn of while all goes well, if anything."""
        refused = self.steady_now() - self._refused_at < REFUSED
        untimed = self._inbox.untimed
        notices = (
            self._surroundings.rivals,
            self._refusal if refused else '',
            f"stamps of {untimed} are not of this node's clock" if untimed else '',
        )
        return (WARN if any(notices) else OK), '; '.join(filter(None, (message, *notices)))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the planner; return the exit code."""
    return run(Planner, argv)


if __name__ == '__main__':
    sys.exit(main())
