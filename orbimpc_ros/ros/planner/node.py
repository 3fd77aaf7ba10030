# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner node: odometry and goal in, a checked command out, at each odometry or step."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import replace
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from orbimpc_ros.loop.controller import Controller
from orbimpc_ros.loop.frames import Witness
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.ros.clock import NodeClock
from orbimpc_ros.ros.halves import HALVES, Halves, Joined
from orbimpc_ros.ros.lifecycle import Managed
from orbimpc_ros.ros.messages import SECOND, Stamp
from orbimpc_ros.ros.parameters import PLANNER, PlannerSettings, planner_settings
from orbimpc_ros.ros.parameters.dynamic import DynamicParameters
from orbimpc_ros.ros.parameters.sections import warn_of_unused
from orbimpc_ros.ros.planner.announcer import Announcer
from orbimpc_ros.ros.planner.compiling import leaving_at_signals, report_compilation
from orbimpc_ros.ros.planner.events import Events
from orbimpc_ros.ros.planner.frames import listen_to_transforms
from orbimpc_ros.ros.planner.health import Condition, Health, condition
from orbimpc_ros.ros.planner.inbox import NAMED, STREAM, Inbox
from orbimpc_ros.ros.planner.lookout import OBSTACLES, PLAN, others
from orbimpc_ros.ros.planner.mode import ModeChanges
from orbimpc_ros.ros.planner.neighbours import Neighbours
from orbimpc_ros.ros.planner.outlet import (
    CLAIMS,
    Outlet,
    command_messages,
    outputs,
    refutation_messages,
    report_messages,
)
from orbimpc_ros.ros.planner.summary import doubts, summary
from orbimpc_ros.ros.planner.ticker import Ticker, prepared
from orbimpc_ros.ros.process import qos, run
from orbimpc_ros.ros.reports import AFRESH, DISABLED, INACTIVE, RESET, Report, prices

EVENTS = ('arrived', 'caught')  # topics
# Who is connected is looked at instead: an event handler makes every wait of the node longer.
NO_EVENTS = SubscriptionEventCallbacks(use_default_callbacks=False)
GOAL_PATIENCE = 0.1  # [s] to wait for the goal that belongs to an odometry message
STANDING_PATIENCE = 1.0  # [s] the same while simulated time stands: who waits sends it again
LEADERS_PATIENCE = 10.0  # [s] the same for plans of other vehicles
MARKERS = 10  # messages on obstacles that may wait, for each may matter
REPEAT = 0.1  # [s] until who asks again is answered again: not for messages that come twice
WATCH = 0.05  # [s] how often the inputs' age is looked at, at least
CLOCK_SET = 0.1  # [s] by which the system's clock may be set without a fresh start
REFUSED = 1.0  # [s] for which a refused message is a reason to warn
SILENCE = 1.5  # [s] without any /clock, after which that is a reason to warn
LULL = 10.0  # [s] the same, once it has come: lock-step waits for slow planners


class PlannerNode(Managed):
    """Messages to the inbox, the inbox to the ticker, ticks to messages; and a watch on all."""

    def __init__(self) -> None:
        super().__init__('planner')
        self._console = Announcer(self.get_logger(), self.steady_now)
        report_compilation(self._console.warn)
        self._live = DynamicParameters(self, PLANNER, planner_settings, prepared)
        step = self.get_parameter('step').value
        self._time = NodeClock(self, step, self.at_work(self._on_jump))
        warn_of_unused(self)

    def configure(self) -> None:
        """Compile a controller for the parameters, and connect inputs and outputs."""
        self._enabled = True
        self._answered = -1  # stamp of the odometry that was answered last [ns]
        self._refusal, self._refused_at = '', -np.inf
        self._watched = -np.inf  # when it was last looked around [s]
        # Before anything is compiled: a simulator sees by cmd_vel that a planner is on its way.
        self._outlet = Outlet(self, outputs(self._live.settings()))
        with leaving_at_signals():
            self._settings, controller = self._live.prepared()
        names = {topic: self.resolve_topic_name(topic) for topic in NAMED}
        avoided = others(self._settings.avoid, names[PLAN], self.resolve_topic_name)
        self._halves, self._witness = Halves(), Witness(self._settings.frames.velocity)
        if self._settings.halves:
            names['odom'] = ' and '.join(map(self.resolve_topic_name, HALVES))
        self._inbox = Inbox(self._settings, names, avoided)
        simulated = self._time.simulated
        self._ticker = Ticker(self._settings, controller, simulated=simulated, counted=simulated)
        self._stamp = Stamp(0)  # of the last tick
        self._report: Report | None = None  # on it
        self._outlet.engaged = not self._settings.gated
        self._mode_changes = ModeChanges()
        self._create_events()
        self._health = Health(self, self._condition, self._counts)
        self._create_subscriptions()
        self._create_timers()
        self._live.keep(self._install)
        self._introduce()

    def activate(self) -> None:
        """Plan and command, of what comes from now on."""
        self._forget_plan()
        self._inbox.forget()
        self._outlet.forget()
        self._report = None

    def deactivate(self) -> None:
        """Command what is safe for the last time."""
        self.safe(INACTIVE)

    def clean_up(self) -> None:
        """Let changed parameters wait for the next time."""
        self._live.release()

    def _introduce(self) -> None:
        """Say once, before anything flies, what vehicle the parameters describe."""
        self._console.introduce(summary(self._settings, self._time.simulated))
        given = {name: each.value for name, each in self._parameter_overrides.items()}
        for doubt in doubts(self._settings, given):
            self.get_logger().warning(doubt)

    def _install(self, prepared: tuple[PlannerSettings, Controller]) -> None:
        self._settings, controller = prepared
        self._ticker.install(self._settings, controller)
        self._inbox.adopt(self._settings)
        self._console.introduce(summary(self._settings, self._time.simulated))

    # --- wiring

    def _create_subscriptions(self) -> None:
        if self._settings.halves:
            odometry = self._listen(PoseStamped, 'pose', self.at_work(self._on_pose))
            self._listen(TwistStamped, 'twist', self.at_work(self._on_twist))
        else:
            odometry = self._listen(OdometryMessage, 'odom', self.at_work(self._on_odometry))
        self._listen(PoseStamped, 'goal', self.at_work(self._on_goal))
        self._listen(Path, 'goal_path', self.at_work(self._on_path))
        if self._settings.gated:
            # Even while inactive: whoever is activated has to know whether the vehicle is flown.
            self._listen(Bool, 'engaged', self.guard(self._on_engaged))
        self._create_lookout()
        if self._settings.tree.heard:
            listen_to_transforms(self, self._take)
        self._neighbours = Neighbours(self, odometry, self._outlet.velocity)
        self.create_service(Trigger, '~/reset', self.guard(self._on_reset))
        self.create_service(SetBool, '~/enable', self.guard(self._on_enable))

    def _listen(self, kind: type, topic: str, callback: Callable[[Any], None]) -> Subscription:
        latest = qos(1, ReliabilityPolicy.BEST_EFFORT)
        return self.create_subscription(kind, topic, callback, latest, event_callbacks=NO_EVENTS)

    def _create_lookout(self) -> None:
        """Subscribe to what moves around the vehicle.

        Markers add up: one that is lost leaves a body out, or leaves one where none is. So these
        are to be reliable; who offers less is told of as a mismatch. Plans are whole each time.
        """
        seen = self.at_work(self._on_obstacles)
        self._obstacles = self.create_subscription(
            MarkerArray, OBSTACLES, seen, qos(MARKERS), event_callbacks=NO_EVENTS
        )
        for topic in self._inbox.others:
            self._listen(Path, topic, self.at_work(self._hearing(topic)))

    def _create_events(self) -> None:
        self._events, self._shown, self._goals_noted = Events(), dict[str, bool](), 0
        kept = qos(durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._tellers = {name: self.create_publisher(Bool, name, kept) for name in EVENTS}
        self._tell_events()

    def _create_timers(self) -> None:
        period = self._settings.period
        if not self._settings.on_odometry:
            # In ROS time: simulated time sets the pace. Everything that watches is steady.
            self.create_timer(period, self.at_work(self._on_timer))
        self._patience = self.every(0.5 * GOAL_PATIENCE, self._on_patience)
        self._patience.cancel()
        self._watch_period = min(WATCH, 0.5 * period)
        self._watchman = self.every(self._watch_period, self._watch)

    # --- inputs

    def _on_pose(self, message: PoseStamped) -> None:
        self._take_half('pose', self._halves.pose, message)

    def _on_twist(self, message: TwistStamped) -> None:
        self._take_half('twist', self._halves.twist, message)

    def _take_half(self, topic: str, take: Callable[[Any], Joined | None], message: Any) -> None:
        try:
            joined = take(message)
        except BadInput as error:
            self._inbox.refused[f'{topic}: {error.culprit}'] += 1
            self._refuse(f'{self.resolve_topic_name(topic)} refused: {error}')
            return
        if joined is not None:
            self._on_odometry(joined)

    def _on_engaged(self, message: Bool) -> None:
        """Begin to command, from a fresh start, or fall silent at once."""
        if message.data == self._outlet.engaged:
            return
        if message.data:
            self._ticker.start_afresh()
        self._outlet.engaged = message.data
        self._mode_changes.note(self.steady_now())
        self._console.say('engaged: commands' if message.data else 'not engaged: silent')
        self._health.show_changes()

    def _on_odometry(self, message: OdometryMessage | Joined) -> None:
        refusal = self._inbox.take('odom', message, self.steady_now(), self._time.now)
        if refusal:
            self._refuse(refusal)
            self._repeat_answer(message)
            return
        if self._settings.on_odometry:
            self._tick_or_wait()
        self._witness.note(self._inbox.latest['odom'].value)  # no command waits for it

    def _on_goal(self, message: PoseStamped) -> None:
        self._take('goal', message)
        self._note_goal()
        self._tell_events()

    def _note_goal(self) -> None:
        """Let the events know of a goal that has come since the last one they know of."""
        goal, count = self._inbox.latest.get('goal'), self._inbox.goal_counts['goal']
        if goal is not None and count != self._goals_noted:
            self._goals_noted = count
            self._events.send(goal.value.position, streams=goal.run >= STREAM)

    def _look_for_events(self) -> None:
        """Look whether the latest odometry shows a goal caught or reached."""
        self._note_goal()  # the tick may be for one that has just come
        settings, known, now = self._settings, self._inbox.odometry, self.steady_now()
        if known is None or self._inbox.missing or self._inbox.stale_goal(now, self._time.now):
            return
        goal = self._inbox.targets(np.array([known.value.time]), now, self._time.now)[0]
        approach, wanted = settings.approach, self._inbox.wanted(now, self._time.now)
        if approach.is_the_goals and wanted is not None:
            approach = replace(approach, direction=tuple(wanted[:, 0].tolist()))
        found = settings.goal_radius, settings.odom_timeout, approach
        self._events.note(known.value, goal, *found)
        self._tell_events()

    def _tell_events(self) -> None:
        """Publish what has happened, or no longer holds, where that is news."""
        for name, teller in self._tellers.items():
            holds = getattr(self._events, name)
            if holds != self._shown.get(name):
                teller.publish(Bool(data=holds))
                self._shown[name] = holds

    def _on_path(self, message: Path) -> None:
        self._take('goal_path', message)

    def _on_obstacles(self, message: MarkerArray) -> None:
        self._ticker.expect_hazards()  # its publisher may not have been noticed yet
        self._take(OBSTACLES, message)

    def _hearing(self, topic: str) -> Callable[[Path], None]:
        def on_plan(message: Path) -> None:
            self._take(topic, message)

        return on_plan

    def _take(self, topic: str, message: Any) -> None:
        """Take in what accompanies odometry; plan if that has waited for it."""
        refusal = self._inbox.take(topic, message, self.steady_now(), self._time.now)
        if refusal:
            self._refuse(refusal)
        elif self._settings.on_odometry and self._unanswered and self._inbox.complete:
            self._plan_now()

    @property
    def _unanswered(self) -> bool:
        """Return whether an odometry message still waits for its goal."""
        odometry = self._inbox.odometry
        if odometry is None or not self.active:  # transforms come in while it is inactive, too
            return False
        if odometry.stamp.nanoseconds == self._answered:
            return False
        return not self._inbox.stale_odometry(self.steady_now(), self._time.now)

    def _refuse(self, refusal: str) -> None:
        self._console.warn(refusal)
        self._refusal, self._refused_at = refusal, self.steady_now()
        self._health.show_changes()

    def _repeat_answer(self, message: OdometryMessage | Joined) -> None:
        """Answer again who asks again: the first answer may have been lost in discovery."""
        stamp = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
        waited = self.steady_now() - self._outlet.at > REPEAT
        if stamp != self._answered or not waited or self._unsafe():
            return
        self._outlet.repeat()
        if self._report is not None:
            self._tell(self._outlet.heard)  # also readers who were not there yet

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
            self._waits = self._patience_left
            self._patience.reset()

    @property
    def _patience_left(self) -> int:
        """Return how many calls an odometry message waits for what belongs to it."""
        leaders = set(self._inbox.lookout.leaders).intersection(self._inbox.companions)
        standing = LEADERS_PATIENCE if leaders else STANDING_PATIENCE
        patience = standing if self._time.simulated else GOAL_PATIENCE
        return round(patience / (0.5 * GOAL_PATIENCE))

    def _on_patience(self) -> None:
        # On the second call at the soonest: after a stall, what lies waiting gets its turn first.
        self._waits -= 1
        if self._waits == 0:
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
        self._look_for_events()
        self._watch_now()

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
        command = report.tick.command
        self._outlet.begin(command_messages(self._settings, stamp, command))
        if self._outlet.engaged and not self._settings.dry_run:
            self._ticker.went_out(command, self._time.seconds)
        self._stamp, self._report = stamp, report
        heard = self._outlet.heard
        self._tell(heard - CLAIMS)  # the vehicle did not wait for it
        self._report = self._ticker.proved(report, catches='certificate' in heard)
        self._tell(heard & CLAIMS)
        self._console.note(self._report.tick)
        self._health.show_changes()

    def _tell(self, topics: Set[str]) -> None:
        """Report on the last tick, on topics that somebody listens to."""
        report, known = self._report, self._inbox.odometry is not None
        assert report is not None
        name = self.get_fully_qualified_name()
        if 'tick' in topics:
            report = replace(report, binding=prices(report.tick))
        told = self._settings, self._stamp, report, name
        self._outlet.add(report_messages(*told, oriented=known, heard=topics))
        if 'certificate' in topics:
            self._outlet.add(refutation_messages(report))

    # --- watching

    def _watch_now(self) -> None:
        """Watch if that will be due soon: the next odometry, which must not wait, is farthest."""
        if self.steady_now() - self._watched >= 0.5 * self._watch_period:
            self._watch()
            self._watchman.reset()

    def safe(self, reason: Reason) -> None:
        """Command what is safe, now; a planner that has commanded nothing yet goes on so."""
        if self.active and self._outlet.used:
            self._be_safe(reason)

    def _be_safe(self, reason: Reason) -> None:
        # Stamped now: it is no answer to any odometry.
        now, known = max(self._time.nanoseconds, self._answered + 1), self._inbox.odometry
        frames = self._settings.frames if known is None else known.stamp.frames
        self._publish(Stamp(now, frames), self._ticker.safe(self._inbox, reason))

    def _watch(self) -> None:
        """Repeat the safe command every period while it is not safe to follow a plan."""
        self._watched = self.steady_now()
        self._neighbours.look()
        self._time.look()
        if self._obstacles.get_publisher_count():  # somebody may tell of some: ready in a second
            self._ticker.expect_hazards()
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
        odd = [self._witness.doubt, self._mode_changes.restless(self.steady_now())]
        displaced = self._inbox.displaced
        return [self._neighbours.rivals, still, other, *odd, displaced, *self._traffic_notices]

    @property
    def _traffic_notices(self) -> list[str]:
        """Return what of the traffic around is not planned with, in words."""
        odometry, report = self._inbox.odometry, self._report
        found = []
        if odometry is not None and self._inbox.others:
            found = self._inbox.lookout.troubles(odometry.value.time)
        if report is not None and report.left_out:
            found.append(f'{report.left_out} obstacles within reach are left out: too many')
        return found

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

    def _start_afresh(self, why: str, reason: Reason = AFRESH) -> None:
        self.get_logger().warning(f'{reason.words}: {why}')
        self._forget_plan()
        self._inbox.start_afresh()
        self._events.begin()
        self._tell_events()
        self.safe(reason)

    def _forget_plan(self) -> None:
        self._patience.cancel()
        self._ticker.start_afresh()
        self._halves = Halves()
        self._answered = -1

    def _on_reset(self, _request: Any, response: Any) -> Any:
        self._ticker.forget()
        self._start_afresh('asked to', RESET)
        response.success = True
        response.message = 'plan, estimates and inputs forgotten, but for a goal sent by hand'
        return response

    def _on_enable(self, request: Any, response: Any) -> Any:
        self._enabled = request.data
        if self.active and not self._enabled:
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
            'engaged': self._outlet.engaged,
            'changes of mode': self._mode_changes.count,
            'deadline misses': timing.misses,
            'overruns': timing.overruns,
            'late ticks': timing.late,
            'callbacks failed': self.failures,
            'bodies known': len(self._inbox.lookout.bodies),
            **{f'refused {what}': count for what, count in refused},
        }

    def _condition(self) -> Condition:
        refused = self.steady_now() - self._refused_at < REFUSED
        rivals, *rest = self._notices
        notices = [rivals, self._refusal if refused else '', *rest]
        waiting = self._waiting if self._enabled else DISABLED.words
        if not self.active:
            waiting = INACTIVE.words
        return condition(self._wrong, waiting, self._report, notices)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the planner; return the exit code."""
    return run(PlannerNode, argv)
