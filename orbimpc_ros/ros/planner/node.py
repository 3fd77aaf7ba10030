# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner node: passes messages to the core, publishes its decisions, and monitors both.

It also monitors the other ends of its topics.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import Any

from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.subscription import Subscription
from std_msgs.msg import Bool, Float64
from std_srvs.srv import SetBool, Trigger

from orbimpc_ros.loop.capture import Events, VelocityFrameCheck
from orbimpc_ros.loop.planner import Decision
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.entry import report_compilation, without_compiler
from orbimpc_ros.ros.messages import OK, POSE_TWIST, SECOND, Stamp
from orbimpc_ros.ros.parameters.planner import PLANNER, PlannerSettings, planner_settings
from orbimpc_ros.ros.planner import core, outputs
from orbimpc_ros.ros.planner.core import Core, planner_of
from orbimpc_ros.ros.planner.outputs import doubts, summary
from orbimpc_ros.ros.planner.wings import QUIET, WINGS, Wing, types_of
from orbimpc_ros.ros.process import LATCHED, LATEST, LIFE, Managed, NodeClock, full_name, qos, run
from orbimpc_ros.ros.topics import NUMBERS, message_of
from orbimpc_ros.ros.transforms import TF, TF_STATIC

INCOMPATIBLE = 'ERROR: '  # prefix of reasons for incompatibility in rclpy


class EndpointMonitor:
    """Monitors the other ends of a planner's topics.

    They are checked one topic at a time: each check is short, so that odometry is not delayed. DDS
    also reports mismatches as events. But event handlers lengthen every wait of the node, and no
    event reports the end of a mismatch.

    Attributes:
        sources: message if there are several publishers of odometry; otherwise empty.
        rivals: message if another node commands the vehicle as well; otherwise empty.
        mismatches: why ends are incompatible, by topic; empty where they match.
    """

    def __init__(self, node: Node, odometry: list[Subscription], velocity: list[Publisher]) -> None:
        self._node, self._odometry, self._velocity = node, odometry, velocity
        self._rota: list[Any] = []
        self.mismatches: dict[str, str] = {}
        self.sources = self.rivals = ''

    def look(self) -> None:
        """Check publishers of odometry and commands, and the ends of one more topic."""
        self.sources = self._several(self._odometry, ', of which only one can be right')
        self.rivals = self._several(self._velocity, ': the vehicle hears them all')
        self._rota = self._rota or [*self._node.publishers, *self._node.subscriptions]
        end = self._rota.pop()
        self.mismatches[end.topic_name] = self._mismatch(end)

    def _several(self, ends: Iterable[Publisher | Subscription], consequence: str) -> str:
        counts = {end.topic_name: self._node.count_publishers(end.topic_name) for end in ends}
        several = [f'{count} publishers on {name}' for name, count in counts.items() if count > 1]
        return f'{" and ".join(several)}{consequence}' if several else ''

    def _mismatch(self, end: Publisher | Subscription) -> str:
        """Return which other end is incompatible with ``end``, and why; empty if none is."""
        node, topic = self._node, end.topic_name
        ends = node.get_publishers_info_by_topic(topic), node.get_subscriptions_info_by_topic(topic)
        same, others = ends if isinstance(end, Publisher) else ends[::-1]
        # The own end comes from DDS, with the defaults of its profile filled in, like any other.
        own = [each for each in same if full_name(each) == node.get_fully_qualified_name()]
        for other in others if own else ():
            who, kind = f'{topic} of {full_name(other)}', own[0].topic_type
            if other.topic_type != kind:
                return f'{who} is a {other.topic_type}, not a {kind}'
            pair = (own[0].qos_profile, other.qos_profile)
            verdict, why = qos_check_compatible(*(pair if same is ends[0] else pair[::-1]))
            if verdict == QoSCompatibility.ERROR:
                errors = [each for each in why.split(';') if each.startswith(INCOMPATIBLE)]
                reasons = ', '.join(each.removeprefix(INCOMPATIBLE) for each in errors)
                return f'{who} does not match: {reasons}'
        return ''


EVENTS = ('arrived', 'caught')  # topics
INPUTS = ('goal', 'goal_path', 'wind', core.OBSTACLES)  # topics in addition to those of odometry
# Connections are polled instead: an event handler lengthens every wait of the node.
UNHEARD = SubscriptionEventCallbacks(use_default_callbacks=False)
UNSENT = PublisherEventCallbacks(use_default_callbacks=False)
GOAL_PATIENCE = 0.1  # [s] to wait for the goal that belongs to an odometry message
STANDING_PATIENCE = 1.0  # [s] the same while simulated time is stopped; a waiting simulator resends
FLEET_PATIENCE = 30.0  # [s] the same for plans of other vehicles
MARKERS = 10  # queued messages on obstacles, each of which may matter
TRANSFORMS = 100  # queued messages on /tf, each for other frames
REPEAT = 0.1  # [s] until a repeated request is answered again, unlike duplicate messages
WATCH = 0.05  # [s] longest period of checks of the age of inputs
HEALTH = 1.0  # [s] longest interval between messages on /diagnostics
REFUSED = 1.0  # [s] duration of the warning on a refused message
SILENCE = 1.5  # [s] without any /clock before a warning
LULL = 10.0  # [s] the same after the first one: lock-step waits for slow planners
FORGOTTEN = 'plan, estimates and inputs forgotten, but for goals by hand and bodies that last'
NUMBER = re.compile(r'(?<![\w/])[-+]?\d+(\.\d+)?(e[-+]?\d+)?')


class PlannerNode(Managed):
    """Connects messages to the core and its decisions to messages, and monitors its inputs."""

    kind, specs, settings_of = 'planner', PLANNER, staticmethod(planner_settings)
    settings: PlannerSettings

    def __init__(self) -> None:
        super().__init__()
        self._logged: dict[str, float] = {}  # time of the last log of each line [s]
        report_compilation(self.get_logger().info)
        if not COMPILED:
            self.get_logger().warning(without_compiler())
        self._time = NodeClock(self, self.settings.step, self.at_work(self._on_jump))

    def configure(self) -> None:
        """Compile a planner for the parameters, and connect inputs and outputs."""
        self._enabled = True
        self._wing: Wing | None = None
        self._refusal, self._refused_at = '', -math.inf
        self._watched = -math.inf  # time of the last checks [s]
        settings, simulated = self.settings, self._time.simulated
        self._gate = not settings.gated
        # Before compilation: cmd_vel shows a simulator that a planner is being configured.
        self._create_publishers(settings)
        if settings.autopilot:
            self._wing = WINGS[settings.autopilot](self, settings.frames, self._switched)
        self._frame_check = VelocityFrameCheck(settings.frames.velocity)
        self._core = Core(
            settings,
            planner_of(settings),
            simulated=simulated,
            counted=simulated,
            resolve=self.resolve_topic_name,
        )
        self._core.inputs.lag = settings.step if simulated else 0.0
        self._create_subscriptions(settings)
        if settings.trigger == 'timer':
            # In ROS time: simulated time sets the pace. All monitoring uses the steady clock.
            self.create_timer(settings.period, self.at_work(self._plan_if_nothing_is_missing))
        self._watch_period = min(WATCH, 0.5 * settings.period)
        self._watchman = self.every(self._watch_period, self._on_watch)
        # In all states: an inactive planner reports that it is inactive.
        self.create_timer(HEALTH, self.guard(self._show_health), clock=self.steady)
        self.get_logger().info(summary(settings, simulated))
        for doubt in doubts(settings, self.given):
            self.get_logger().warning(doubt)

    def activate(self) -> None:
        """Plan and command, based on messages from now on."""
        self._core.inputs.latest.clear()  # including a goal sent by hand
        self._core.start_afresh()
        self._begin_anew()

    def install(self) -> None:
        """Continue with changed settings, and a planner compiled for them."""
        if self.configured:
            self._core.install(self.settings, planner_of(self.settings))
        self.get_logger().info(f'from now on {summary(self.settings, self._time.simulated)}')

    # --- wiring

    def _create_publishers(self, settings: PlannerSettings) -> None:
        kinds = {topic: (message_of(topic), qos(lease=LIFE)) for topic in outputs.outputs(settings)}
        kinds |= dict.fromkeys(EVENTS, (Bool, LATCHED))
        kinds |= {f'~/{name}': (Float64, qos()) for name in NUMBERS}
        kinds['/diagnostics'] = message_of('/diagnostics'), qos()
        self._publishers_of: dict[str, Publisher] = {
            topic: self.create_publisher(kind, topic, profile, event_callbacks=UNSENT)
            for topic, (kind, profile) in kinds.items()
        }
        self._shown = dict[str, bool]()  # events as last published
        self._begin_anew()
        self._level, self._current = OK, dict[str, str]()  # as last published

    def _begin_anew(self) -> None:
        self._events = Events()
        self._publish_events()
        self._sent_at = -math.inf  # time of the last command, on the steady clock [s]
        self._stamp = Stamp(0)  # of the answered odometry
        self._answered = -1  # stamp of the last answered odometry [ns]
        self._decision: Decision | None = None  # the last one
        self._waits = 0  # checks until odometry waits no longer for its companions

    def _create_subscriptions(self, settings: PlannerSettings) -> None:
        odometry = POSE_TWIST if settings.odometry == 'pose_twist' else ('odom',)
        kinds, listening = {topic: message_of(topic) for topic in (*odometry, *INPUTS)}, {}
        kinds |= dict.fromkeys(self._core.inputs.others, message_of(core.PLAN))
        for topic, kind in kinds.items():
            full = self.resolve_topic_name(topic)
            ends: Any = (*self.publishers, *self.subscriptions)
            if any(each.topic_name == full and each.msg_type is not kind for each in ends):
                raise BadInput.stating(full, 'two types of message', 'check what is remapped to it')
            # Markers add to each other, so that none may be lost; other messages are complete.
            profile = qos(MARKERS) if topic == core.OBSTACLES else LATEST
            callback = self.at_work(self._hear, topic)
            listening[topic] = self.create_subscription(
                kind, topic, callback, profile, event_callbacks=UNHEARD
            )
        if settings.gated:
            # Even while inactive: a node must know on activation whether the vehicle is flown.
            self.create_subscription(Bool, 'engaged', self.guard(self._on_engaged), LATEST)
        if settings.tf:
            # Also while inactive. The library of tf2 would receive them in a separate thread.
            kind = types_of('tf2_msgs', 'tf', 'true').TFMessage
            lasting = qos(TRANSFORMS, durability=LATCHED.durability)
            for topic, profile in ((TF, qos(TRANSFORMS)), (TF_STATIC, lasting)):
                self.create_subscription(kind, topic, self.guard(self._hear, topic), profile)
        self._obstacles = listening[core.OBSTACLES]
        commands = [each for name, each in self._publishers_of.items() if name == 'cmd_vel']
        self._monitor = EndpointMonitor(self, [listening[name] for name in odometry], commands)
        self.create_service(Trigger, '~/reset', self.guard(self._on_reset))
        self.create_service(SetBool, '~/enable', self.guard(self._on_enable))

    def _now(self) -> tuple[float, int | None]:
        """Return the steady time [s] and that of ROS [ns], unknown until simulated time starts."""
        return self.steady_now(), self.get_clock().now().nanoseconds or None

    def _decide(self, reason: Reason | None = None) -> Decision:
        """Return the decision on the present inputs, or for a reason not to follow a plan."""
        return self._core.decide(*self._now(), reason or self._stop())

    # --- inputs

    def _hear(self, topic: str, message: Any) -> None:
        """Take in a message; answer odometry once all messages that belong to it are here.

        DDS does not order topics, but lock-step is to repeat exactly.
        """
        inputs, at = self._core.inputs, self._now()
        stop, before = self._stop(), inputs.odometry
        if refusal := inputs.update(topic, message, *at):
            self._refusal, self._refused_at = refusal, at[0]
            if topic == 'odom':
                self._repeat_answer(message)
            return
        if (aim := inputs.aim(topic)) is not None:
            self._events.send(aim, streams=inputs.latest[topic].streams)
            self._publish_events()
        odometry = inputs.odometry
        measured = odometry is not before
        # Transforms arrive even while it is inactive.
        if odometry is not None and self.active and self.settings.trigger == 'odom':
            waits = odometry.stamp.nanoseconds != self._answered
            if not inputs.complete:
                if measured:
                    self._wait()
            elif measured or (waits and not self._core.planner.unsafe(odometry.age(*at))):
                self._answer(self._core.decide(*at, stop))
        if odometry is not None and measured:  # no command waits for this
            self._frame_check.note(odometry.value)

    def _wait(self) -> None:
        """Let new odometry wait for a while for messages that belong to it."""
        inputs = self._core.inputs
        if inputs.missing or self._waits:
            return
        standing = FLEET_PATIENCE if inputs.due else STANDING_PATIENCE
        patience = standing if self._time.simulated else GOAL_PATIENCE
        # Counted in checks, at least two: after a stall, queued messages come first.
        self._waits = math.ceil(patience / self._watch_period)

    def _on_engaged(self, message: Bool) -> None:
        """Start to command, from a fresh state, or fall silent at once."""
        if message.data != self._gate:
            self._gate = message.data
            self._switched('engaged: commands' if message.data else 'not engaged: silent')

    def _switched(self, message: str) -> None:
        """Record that commands start, from a fresh state, or stop being sent."""
        if self._engaged:
            self._core.planner.start_afresh()
        self.get_logger().info(message)

    @property
    def _engaged(self) -> bool:
        """Return True if commands may be sent."""
        flown = self._gate and not self.settings.dry_run
        return flown and (self._wing is None or self._wing.engaged)

    def _repeat_answer(self, message: OdometryMessage) -> None:
        """Answer repeated odometry: its goal or first answer may have been lost in discovery."""
        stamp, now = messages.stamp_of(message), self.steady_now()
        if stamp != self._answered:
            awaited = self._time.simulated and self.settings.trigger == 'odom'
            if awaited and self._core.inputs.renew(stamp, now):
                self._answer(self._decide())
        elif now - self._sent_at > REPEAT and self._decision is not None and not self._unsafe():
            self._command(self._decision)
            self._report(self._decision)  # also for new subscribers

    # --- a decision

    def _plan_if_nothing_is_missing(self) -> None:
        if not self._core.inputs.missing:
            self._answer(self._decide())

    def _answer(self, decision: Decision) -> None:
        """Publish the decision on the latest odometry, and monitor while there is time."""
        self._waits = 0
        stamp = self._core.inputs.latest['odom'].stamp
        age = self._core.seen.odometry_age + 1e-3 * decision.solve_time_ms
        if decision.state is not None and age > self.settings.odom_timeout:  # meanwhile
            decision = self._decide()
        self._publish(stamp, decision)
        self._answered = stamp.nanoseconds
        apart = self._core.look_for(self._events)
        if apart is not None:
            self._publishers_of['~/distance'].publish(Float64(data=apart))
        self._publish_events()
        self._core.planner.prepare()
        # The next odometry must not wait and is farthest away now: monitor if that is due soon.
        if self.steady_now() - self._watched >= 0.5 * self._watch_period:
            self._watch()
            self._watchman.reset()

    def _stop(self) -> Reason | None:
        """Return why no plan may be followed, whatever the inputs; None if one may."""
        if not self._enabled:
            return core.DISABLED
        sources = self._monitor.sources
        return Reason(Cause.SOURCES, sources) if sources else None

    def _unsafe(self) -> Reason | None:
        """Return why no plan may be followed now; None if one may."""
        odometry = self._core.inputs.odometry
        age = None if odometry is None else odometry.age(*self._now())
        return self._core.planner.unsafe(age, self._stop())

    def safe(self, reason: Reason) -> None:
        """Send a safe command now, unless the planner has not commanded anything yet."""
        if self.active and self._sent_at > -math.inf:
            self._be_safe(reason)
            if self._wing is not None and self._engaged:
                self._wing.release()

    def _be_safe(self, reason: Reason) -> None:
        # Stamped now: it does not answer any odometry.
        now = max(self._time.nanoseconds, self._answered + 1)
        odometry = self._core.inputs.odometry
        frames = self.settings.frames if odometry is None else odometry.stamp.frames
        self._publish(Stamp(now, frames), self._decide(reason))

    # --- outputs

    def _publish(self, stamp: Stamp, decision: Decision) -> None:
        command, self._stamp = decision.command, stamp
        self._command(decision)
        if self._wing is not None and self._gate and not self.settings.dry_run:
            self._wing.send(self.settings, command, self._core.inputs.altitude)
        if self._engaged:
            sent = self._time.nanoseconds
            self._core.planner.sent(command, sent / SECOND)
            noted = {**decision.heard, 'sent': (sent - stamp.nanoseconds) / SECOND}
            decision = replace(decision, heard=noted)
        self._decision = self._core.proved(decision, catches=self._is_heard('certificate'))
        self._report(self._decision)
        self._show_changes()

    def _command(self, decision: Decision) -> None:
        """Send the command of a decision to the vehicle, if commands may be sent."""
        if self._engaged:
            context, oriented = (self.settings, self._stamp), 'odom' in self._core.inputs.latest
            self._send(messages.command_messages(*context, decision.command, oriented=oriented))
        self._sent_at = self.steady_now()

    def _is_heard(self, topic: str) -> bool:
        """Return True if a topic has subscribers."""
        publisher = self._publishers_of.get(topic)
        return publisher is not None and publisher.get_subscription_count() > 0

    def _report(self, decision: Decision) -> None:
        """Publish reports of a decision on topics that have subscribers."""
        head = self.settings, self._stamp, decision, self.get_fully_qualified_name()
        self._send(outputs.report_messages(*head, [*filter(self._is_heard, self._publishers_of)]))

    def _send(self, content: Iterable[tuple[str, Any]]) -> None:
        for topic, message in content:
            self._publishers_of[topic].publish(message)

    def _publish_events(self) -> None:
        """Publish events that have changed."""
        for name in EVENTS:
            holds = getattr(self._events, name)
            if holds != self._shown.get(name):
                self._publishers_of[name].publish(Bool(data=holds))
                self._shown[name] = holds

    # --- watching

    def _on_watch(self) -> None:
        """Let odometry wait no longer if its time is up, else monitor."""
        waited, self._waits = self._waits, max(0, self._waits - 1)
        if waited == 1:
            self._plan_if_nothing_is_missing()
        else:
            self._watch()

    def _watch(self) -> None:
        """Repeat the safe command every period while it is not safe to follow a plan."""
        self._watched = self.steady_now()
        self._monitor.look()
        self._time.look()
        if self._obstacles.get_publisher_count():  # obstacles may come: compilation takes a second
            self._core.planner.expect_hazards()
        flying = self._sent_at > -math.inf or not self._enabled
        due = self.steady_now() - self._sent_at >= self.settings.period
        unsafe = self._unsafe() or self._stuck() if flying and due else None
        if unsafe:
            self._be_safe(unsafe)
        self._show_changes()

    def _stuck(self) -> Reason | None:
        """Return why no tick will come, if none will."""
        if missing := self._core.inputs.missing:
            return Reason(Cause.WAITING, f'waits for {missing}')
        stood = self._time.standstill(self.settings.odom_timeout)
        return Reason(Cause.CLOCK, stood) if stood else None

    def _condition(self) -> tuple[bytes, list[str]]:
        """Return the level of diagnostics, and its reasons; empty strings are none."""
        inputs, waiting = self._core.inputs, ''
        if not (self.active and self._enabled):
            waiting = (core.DISABLED if self.active else self.INACTIVE).words
        elif inputs.missing:
            waiting = f'waits for {inputs.missing}'
        left_out = 0 if self._decision is None else self._decision.left_out
        notices = [
            self._monitor.rivals,
            self._time.standstill(LULL if self._time.nanoseconds else SILENCE),
            f"stamps of {inputs.untimed} are not on this node's clock" if inputs.untimed else '',
            self._frame_check.doubt,
            *inputs.silences(),
            f'too many obstacles within reach: {left_out} are ignored' if left_out else '',
            inputs.displaced,
            self._refusal if self.steady_now() - self._refused_at < REFUSED else '',
        ]
        wrong = [self._monitor.sources, *self._monitor.mismatches.values()]
        return outputs.condition(wrong, waiting, self._decision, notices)

    def _show_changes(self) -> None:
        """Log changes of the condition, and publish it if the level has changed.

        A line is not logged again soon, nor one that differs in numbers alone.
        """
        level, parts = self._condition()
        before, now = self._current, self.steady_now()
        self._current = current = {NUMBER.sub('#', part): part for part in parts}
        news = {kind: part for kind, part in current.items() if kind not in before}
        for kind, part in before.items():
            if kind not in current and part not in outputs.NORMAL:
                news[f'over: {kind}'] = f'over: {part}'
        recent = {kind: at for kind, at in self._logged.items() if now - at < QUIET}
        for kind, line in news.items():
            if kind in current and kind not in recent and line not in outputs.NORMAL:
                self.get_logger().warning(line)
            elif kind not in recent:
                self.get_logger().info(line)
        self._logged = dict.fromkeys(news, now) | recent
        if level != self._level:
            self._show_health()

    def _show_health(self) -> None:
        """Publish the condition."""
        self._level, parts = self._condition()
        inputs = self._core.inputs
        values = {
            'enabled': self._enabled,
            'engaged': self._engaged,
            **self._core.counts,
            'callbacks failed': self.failures,
            **{f'refused {cause}': count for cause, count in inputs.refused.items()},
        }
        head = self._time.nanoseconds, self.get_fully_qualified_name(), 'condition', self._level
        message = messages.health_message(*head, '; '.join(parts), values)
        self._publishers_of['/diagnostics'].publish(message)

    # --- fresh starts

    def _on_jump(self, by: float) -> None:
        """Start anew if the clock has jumped [s]: simulated time, so far that all is stale."""
        settings = self.settings
        stale = max(settings.odom_timeout, settings.goal_timeout) + settings.problem.step
        if not (self._time.simulated and 0.0 <= by <= stale):
            self._start_afresh(f'the clock jumped by {by:.3g} s')

    def _start_afresh(self, why: str, reason: Reason = core.AFRESH) -> None:
        self.get_logger().warning(f'{reason.words}: {why}')
        self._waits = 0
        self._core.start_afresh(wind=reason is core.RESET)
        self._answered = -1
        self._events.begin()
        self._publish_events()
        self.safe(reason)

    def _on_reset(self, _request: Any, _response: Any) -> Trigger.Response:
        self._start_afresh('requested', core.RESET)
        return Trigger.Response(success=True, message=FORGOTTEN)

    def _on_enable(self, request: Any, _response: Any) -> SetBool.Response:
        self._enabled = request.data
        if self.active and not self._enabled:
            self._be_safe(core.DISABLED)
        said = 'enabled' if self._enabled else 'disabled: safe command'
        return SetBool.Response(success=True, message=said)


main = partial(run, PlannerNode)
