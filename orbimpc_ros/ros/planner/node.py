"""The planner node: odometry and goal in, a checked command out, at each odometry or step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import ReliabilityPolicy
from std_srvs.srv import SetBool, Trigger

from orbimpc_ros.mpc.loop.controller import Controller
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.ros.clock import NodeClock
from orbimpc_ros.ros.messages import SECOND, Stamp
from orbimpc_ros.ros.parameters import PLANNER, Live, PlannerSettings, planner_settings
from orbimpc_ros.ros.parameters.sections import warn_of_unused
from orbimpc_ros.ros.planner.announcer import Announcer
from orbimpc_ros.ros.planner.compiling import leaving_at_signals, report_compilation
from orbimpc_ros.ros.planner.health import Condition, Health, condition
from orbimpc_ros.ros.planner.inbox import READ, Inbox
from orbimpc_ros.ros.planner.neighbours import Neighbours
from orbimpc_ros.ros.planner.outlet import Outlet, command_messages, report_messages
from orbimpc_ros.ros.planner.summary import doubts, summary
from orbimpc_ros.ros.planner.ticker import Ticker, prepared
from orbimpc_ros.ros.process import Guarded, qos, run
from orbimpc_ros.ros.reports import AFRESH, DISABLED, Report, prices

GOAL_PATIENCE = 0.1  # [s] to wait for the goal that belongs to an odometry message
REPEAT = 0.1  # [s] until who asks again is answered again: not for messages that come twice
WATCH = 0.05  # [s] how often the inputs' age is looked at, at least
CLOCK_SET = 0.1  # [s] by which the system's clock may be set without a fresh start
REFUSED = 1.0  # [s] for which a refused message is a reason to warn
SILENCE = 1.5  # [s] without any /clock, after which that is a reason to warn
LULL = 10.0  # [s] the same, once it has come: lock-step waits for slow planners


class PlannerNode(Guarded):
    """Messages to the inbox, the inbox to the ticker, ticks to messages; and a watch on all."""

    def __init__(self) -> None:
        super().__init__('planner')
        self._enabled = True
        self._answered = -1  # stamp of the odometry that was answered last [ns]
        self._refusal, self._refused_at = '', -np.inf
        self._console = Announcer(self.get_logger(), self.steady_now)
        report_compilation(self._console.warn)
        with leaving_at_signals():
            live = Live(self, PLANNER, planner_settings, prepared)
        self._settings, controller = live.prepared
        self._time = NodeClock(self, self._settings.problem.step, self._on_jump)
        names = {topic: self.resolve_topic_name(topic) for topic in READ}
        self._inbox = Inbox(self._settings, names)
        self._ticker = Ticker(self._settings, controller, simulated=self._time.simulated)
        self._report: Report | None = None  # on the last tick
        inertial, dry = self._settings.problem.inertial, self._settings.dry_run
        self._outlet = Outlet(self, thrust=inertial, dry=dry)
        self._health = Health(self, self._condition, self._counts)
        self._create_subscriptions()
        self._create_timers()
        live.keep(self._install)
        self._introduce()

    def _introduce(self) -> None:
        """Say once, before anything flies, what vehicle the parameters describe."""
        self._console.introduce(summary(self._settings, self._time.simulated))
        given = {name: each.value for name, each in self._parameter_overrides.items()}
        warn_of_unused(self)
        for doubt in doubts(self._settings, given):
            self.get_logger().warning(doubt)

    def _install(self, prepared: tuple[PlannerSettings, Controller]) -> None:
        self._settings, controller = prepared
        self._ticker.install(self._settings, controller)
        self._inbox.adopt(self._settings)
        self._console.introduce(summary(self._settings, self._time.simulated))

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
        self._neighbours = Neighbours(self, odometry, self._outlet.velocity)
        self.create_service(Trigger, '~/reset', self.guard(self._on_reset))
        self.create_service(SetBool, '~/enable', self.guard(self._on_enable))

    def _create_timers(self) -> None:
        period = self._settings.period
        if not self._settings.on_odometry:
            # In ROS time: simulated time sets the pace. Everything that watches is steady.
            self.create_timer(period, self.guard(self._on_timer))
        self._patience = self.every(0.5 * GOAL_PATIENCE, self._on_patience)
        self._patience.cancel()
        self.every(min(WATCH, 0.5 * period), self._watch)

    # --- inputs

    def _on_odometry(self, message: OdometryMessage) -> None:
        refusal = self._inbox.take('odom', message, self.steady_now(), self._time.now)
        if refusal:
            self._refuse(refusal)
            self._repeat_answer(message)
        elif self._settings.on_odometry:
            self._tick_or_wait()

    def _on_goal(self, message: PoseStamped) -> None:
        self._take_goal('goal', message)

    def _on_path(self, message: Path) -> None:
        self._take_goal('goal_path', message)

    def _take_goal(self, topic: str, message: PoseStamped | Path) -> None:
        refusal = self._inbox.take(topic, message, self.steady_now(), self._time.now)
        if refusal:
            self._refuse(refusal)
        elif self._settings.on_odometry and self._unanswered and self._inbox.complete:
            self._plan_now()

    @property
    def _unanswered(self) -> bool:
        """Return whether an odometry message still waits for its goal."""
        odometry = self._inbox.odometry
        if odometry is None or self._inbox.stale_odometry(self.steady_now(), self._time.now):
            return False
        return odometry.stamp.nanoseconds != self._answered

    def _refuse(self, refusal: str) -> None:
        self._console.warn(refusal)
        self._refusal, self._refused_at = refusal, self.steady_now()
        self._health.show_changes()

    def _repeat_answer(self, message: OdometryMessage) -> None:
        """Answer again who asks again: the first answer may have been lost in discovery."""
        stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
        waited = self.steady_now() - self._outlet.at > REPEAT
        if stamp == self._answered and waited and not self._unsafe():
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
            self._plan_now()

    def _on_timer(self) -> None:
        self._ticker.timing.began(self._time.seconds, self._settings.period)
        self._plan_now()

    # --- a tick

    def _plan_now(self) -> None:
        self._patience.cancel()
        odometry = self._inbox.odometry
        if odometry is None or self._inbox.missing:
            self._health.show_changes()
            return
        unsafe = self._unsafe()
        if unsafe is None:
            report = self._ticker.planned(self._inbox, self.steady_now(), self._time.now)
            unsafe = self._unsafe()  # a tick that takes too long outdates what it started from
        if unsafe is not None:
            report = self._ticker.safe(self._inbox, unsafe)
        self._publish(odometry.stamp, report)
        self._answered = odometry.stamp.nanoseconds

    def _unsafe(self) -> Reason | None:
        """Return why no plan may be followed now, if none may."""
        if not self._enabled:
            return DISABLED
        stale = self._inbox.stale_odometry(self.steady_now(), self._time.now)
        if stale:
            return Reason(Cause.ODOMETRY, stale)
        sources = self._neighbours.sources
        return Reason(Cause.SOURCES, sources) if sources else None

    def _publish(self, stamp: Stamp, report: Report) -> None:
        command, name = report.tick.command, self.get_fully_qualified_name()
        self._outlet.begin(command_messages(self._settings, stamp, command))
        if not self._settings.dry_run:
            self._ticker.went_out(command, self._time.seconds)
        report = replace(report, binding=prices(report.tick))  # the vehicle did not wait for it
        known = self._inbox.odometry is not None
        self._outlet.add(report_messages(self._settings, stamp, report, name, oriented=known))
        self._report = report
        self._console.note(report.tick)
        self._health.show_changes()

    # --- watching

    def safe(self, reason: Reason) -> None:
        """Command what is safe, now; a planner that has commanded nothing yet goes on so."""
        if self._outlet.used:
            self._be_safe(reason)

    def _be_safe(self, reason: Reason) -> None:
        # Stamped now: it is no answer to any odometry.
        now, known = max(self._time.nanoseconds, self._answered + 1), self._inbox.odometry
        frames = self._settings.frames if known is None else known.stamp.frames
        self._publish(Stamp(now, frames), self._ticker.safe(self._inbox, reason))

    def _watch(self) -> None:
        """Repeat the safe command every period while it is not safe to follow a plan."""
        self._neighbours.look()
        self._time.look()
        flying = self._outlet.used or not self._enabled
        due = self.steady_now() - self._outlet.at >= self._settings.period
        unsafe = self._unsafe() or self._stuck
        if flying and due and unsafe:
            self._be_safe(unsafe)
        self._console.follow([*self._wrong, *self._notices])
        if self._waiting:
            self._console.say(self._waiting)
        self._health.show_changes()

    @property
    def _waiting(self) -> str:
        """Return what is waited for, in words; empty if nothing is."""
        return f'waits for {self._inbox.missing}' if self._inbox.missing else ''

    @property
    def _wrong(self) -> list[str]:
        """Return what is wrong around the planner, in words; empty ones do not count."""
        return [self._neighbours.sources, *self._neighbours.mismatches]

    @property
    def _notices(self) -> list[str]:
        """Return what to warn of even if all goes well, in words; empty ones do not count."""
        still = self._time.standstill(LULL if self._time.nanoseconds else SILENCE)
        untimed = self._inbox.untimed
        other = f"stamps of {untimed} are not of this node's clock" if untimed else ''
        return [self._neighbours.rivals, still, other]

    @property
    def _stuck(self) -> Reason | None:
        """Return why no tick will come, if none will."""
        if self._waiting:
            return Reason(Cause.WAITING, self._waiting)
        stood = self._time.standstill(self._settings.odom_timeout)
        return Reason(Cause.CLOCK, stood) if stood else None

    def _on_jump(self, by: float) -> None:
        """Start afresh if the clock has jumped [s].

        Simulated time moves in steps. A step forward makes what is known as much older, which its
        age shows; a jump is what makes all of it stale.
        """
        settings, back, forth = self._settings, CLOCK_SET, CLOCK_SET
        if self._time.simulated:
            back = 0.0
            forth = max(settings.odom_timeout, settings.goal_timeout) + settings.problem.step
        if not -back <= by <= forth:
            self._start_afresh(f'the clock jumped by {by:.3g} s')

    def _start_afresh(self, why: str) -> None:
        self.get_logger().warning(f'{AFRESH.words}: {why}')
        self._patience.cancel()
        self._ticker.start_afresh()
        self._inbox.forget()
        self._answered = -1
        self.safe(AFRESH)

    def _on_reset(self, _request: Any, response: Any) -> Any:
        self._start_afresh('asked to')
        response.success, response.message = True, 'inputs and plan forgotten'
        return response

    def _on_enable(self, request: Any, response: Any) -> Any:
        self._enabled = request.data
        if not self._enabled:
            self._be_safe(DISABLED)
        response.success = True
        response.message = 'enabled' if self._enabled else 'disabled: safe command'
        self._health.show_changes()
        return response

    # --- diagnostics

    def _counts(self) -> dict[str, object]:
        timing, refused = self._ticker.timing, self._inbox.refused.items()
        return {
            'waits_for': self._inbox.missing,
            'waits with odometry for': ', '.join(self._inbox.companions),
            'enabled': self._enabled,
            'deadline misses': timing.misses,
            'overruns': timing.overruns,
            'late ticks': timing.late,
            'callbacks failed': self.failures,
            **{f'refused {what}': count for what, count in refused},
        }

    def _condition(self) -> Condition:
        refused = self.steady_now() - self._refused_at < REFUSED
        rivals, *others = self._notices
        notices = [rivals, self._refusal if refused else '', *others]
        waiting = self._waiting if self._enabled else DISABLED.words
        return condition(self._wrong, waiting, self._report, notices)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the planner; return the exit code."""
    return run(PlannerNode, argv)
