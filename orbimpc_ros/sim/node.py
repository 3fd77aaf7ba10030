# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The node of the simulator: a flight in lock-step with its planner or in real time; its reset."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND, Stamp, read_command
from orbimpc_ros.ros.process import DONE, FAILED, LATCHED, LIFE, Managed, full_name, qos, run
from orbimpc_ros.ros.topics import message_of
from orbimpc_ros.sim import outputs
from orbimpc_ros.sim.engines import EngineFailure
from orbimpc_ros.sim.outputs import Seen, View
from orbimpc_ros.sim.parameters import SIM, Faults, SimSettings, sim_settings
from orbimpc_ros.sim.world import departure, outcome

DEPTH = 10  # queue depth: in lock-step no message may be dropped
LOOK = 0.02  # [s] between checks for planner and readers, and of the command in force
SILENT = 2.0  # [s] of waiting before it is logged
MEETING = 1.5  # [s] for DDS to match planner and readers, which this node cannot observe
TRANSITIONS = 'transition_event'  # a topic of every managed node
UNKNOWN = '_NODE_NAME_UNKNOWN_'  # of a reader that is discovered before its node
SETTLED = 0.1  # [s] lock-step: time for a planner to take in a goal without odometry to answer
APART = 0.01  # [s] lock-step with faults: between goals and odometry, for DDS to keep their order
RESEND = 0.5  # [s] lock-step: resend without an answer; first messages may be lost
PATIENCE = 20.0  # [s] lock-step: give up without an answer
SHARE = 0.75  # of command_timeout for the liveliness lease; the rest is time to report its loss
SLACK = 1e-3  # relative tolerance of shares and rates for rounding, negligible in control
AHEAD = 1.0  # [s] that a command's stamp may be ahead of this clock
NO_ANSWER = (
    'an answer to the odometry on cmd_vel: it needs a planner with trigger: odom (with timer, '
    'planner and simulator wait for each other); see its /diagnostics'
)


class SimNode(Managed):
    """A node that simulates the flight described by its parameters.

    A flight is a course that waits at each ``yield`` until time has passed or a command has come.
    """

    kind, specs, settings_of = 'sim', SIM, staticmethod(sim_settings)
    # It publishes /clock: under simulated time it would wait for itself.
    forced = (Parameter('use_sim_time', value=False),)
    settings: SimSettings

    def configure(self) -> None:
        """Set up the flight described by the parameters."""
        prefix, body = self.get_namespace().strip('/'), self.settings.child_frame_id
        if prefix and not body.startswith(f'{prefix}/'):  # unique among vehicles that share /tf
            body = f'{prefix}/{body}'
        self._scenario = scenario = replace(self.settings, child_frame_id=body)
        self._wall, self._name = scenario.clock == 'wall', self.get_fully_qualified_name()
        self._patience = math.inf if self._wall else scenario.wait_timeout or math.inf  # [s]
        self._orders = Orders(scenario)
        self._refused: Counter[str] = Counter()  # number of refused commands, by topic and field
        self._shared = math.inf  # time of the shared clock; infinite without one [ns]
        self._course: Course | None = None
        self._begin(scenario.begin)
        deep = qos(DEPTH)
        self._commands, _ = (
            self.create_subscription(message_of(name), name, self.at_work(self._take, name), deep)
            for name in ('cmd_vel', 'cmd_thrust')
        )
        states = [topic for topic, _ in outputs.shown(Stamp(0), self._name, self._flight)]
        self._out = {
            name: self.create_publisher(message_of(name), name, deep)
            for name in ('odom', 'goal', '/diagnostics', *states)
        }
        self._out['captured'] = self.create_publisher(Bool, 'captured', LATCHED)
        self.create_service(Trigger, '~/reset', self.guard(self._on_reset))
        self._rate = 1.0 if self._wall else scenario.rate  # as a multiple of real time; 0: no limit
        if self._rate:
            self.every(scenario.model.step / self._rate, self._on_rate)
        self.every(LOOK, self._go_on)
        if scenario.clock == 'shared':
            self._shared = -math.inf
            self.create_subscription(Clock, '/clock', self.at_work(self._on_clock), deep)
        if self._wall:  # publishers without a liveliness lease do not match, which is no fault
            lease, kind = max(LIFE, SHARE * scenario.given_command_timeout), message_of('cmd_vel')
            events = SubscriptionEventCallbacks(
                liveliness=self.at_work(self._on_life), incompatible_qos=lambda _event: None
            )
            lasting: Any = {'qos_profile': qos(lease=lease), 'event_callbacks': events}
            self.create_subscription(kind, 'cmd_vel', lambda _message: None, **lasting)

    def activate(self) -> None:
        """Start a flight; after an earlier one, at a later time: stamps must not go back."""
        if self._course is not None:
            self._begin(self._begun + self._flight.vehicle.time + self._scenario.model.step)
            self._out['captured'].publish(Bool(data=False))
        self._course = self._in_real_time() if self._wall else self._in_lock_step()
        next(self._course)

    def _begin(self, at: float) -> None:
        self._begun = at  # simulated time at the start of the flight [s]
        self._flight, self._view = departure(self._scenario), View(self._scenario)
        self._finished = False  # whether the flight has ended
        self._due = True  # whether the next step may begin by its rate
        self._order = Order(0, 0.0, np.zeros(self._scenario.model.rates))  # the last command
        self._expires = -math.inf  # real time: when it expires, on the steady clock [s]
        self._stopped = math.inf  # since when the vehicle is stopped; infinite while it is not [s]

    @property
    def _now(self) -> int:
        """Return the ROS time, or in lock-step the simulated time, with jumps by faults [ns]."""
        jump = self._scenario.faults.jumped(self._flight.ticks)
        if self._wall:
            return int(self.get_clock().now().nanoseconds) + round(jump * SECOND)
        return round((self._begun + self._flight.vehicle.time + jump) * SECOND)

    # --- events

    def _go_on(self, order: Order | None = None) -> None:
        """Continue the course of a flight, with a complete command if one has come."""
        if self._course is not None and not self._finished:
            self._course.send(order)

    def _on_rate(self) -> None:
        self._due = True
        self._go_on()

    def _on_clock(self, message: Clock) -> None:
        self._shared = message.clock.sec * SECOND + message.clock.nanosec
        self._go_on()

    def _on_reset(self, _request: Any, response: Any) -> Any:
        if self.active:
            self.activate()
        response.success, response.message = True, 'back at the start'
        return response

    def _take(self, topic: str, message: Any) -> None:
        """Take in a command message; a complete command continues the course."""
        try:
            order = self._orders.take(topic, message, self._now)
        except BadInput as error:
            self._refused[f'refused {topic}: {error.culprit}'] += 1
            self._warn(f'{topic} refused: {error}')
            return
        if order is not None:
            self._go_on(order)

    def _on_life(self, event: Any) -> None:
        """Stop when the planner loses liveliness; resume when it regains it."""
        if event.alive_count == 0 and event.alive_count_change < 0:
            self._stop('the planner gives no sign of life')
            return
        # The lost planner is back; a new one would not reduce the number of lost ones.
        back = event.alive_count_change > 0 > event.not_alive_count_change
        if back and self._stopped < math.inf and self.steady_now() < self._expires:
            self._stopped = math.inf
            self.get_logger().info('the planner lives: its command is in force again')

    # --- waiting for planner and readers

    def _meeting(self) -> Course:
        """Wait until all readers are there and, in lock-step, a planner.

        Patience counts from the begin, or from the last sight of a planner that is being
        configured. Only managed planners count as such: others may read goals through another node.
        Changes of what is missing are logged.
        """
        wanted, fewest, announced = self._scenario.wait_for, self._scenario.wait_subscribers, ''
        begun = counted_from = met_after = self.steady_now()
        while True:
            now = self.steady_now()
            publishers = self.get_publishers_info_by_topic(self._commands.topic_name)
            planners, goal = {*map(full_name, publishers)}, self._out['goal'].topic_name
            silent = () if self._wall else planners.difference(self._readers(goal))
            coming = [name for name in silent if self.count_publishers(f'{name}/{TRANSITIONS}')]
            others = {self._name, *planners}
            missing = [
                f'{count} of {topic} (there are {there})'
                for topic, count in wanted.items()
                if (there := sum(n not in others for n in self._readers(topic))) < count
            ]
            heard = self._out['odom'].get_subscription_count()
            if missing:
                met_after = now
            if coming:  # its first start compiles machine code, without a time limit
                counted_from = now
                awaited = f'{min(coming)} to be configured: it may be compiling machine code'
            elif heard < fewest:
                awaited = f'subscribers of odom: {fewest} (there are {heard})'
            elif missing:
                awaited = f'readers: {", ".join(missing)}'
            elif wanted and now - met_after < MEETING:
                awaited = 'the planner to discover its subscribers'
            elif self._wall or not (awaited := self._planner_lacking):
                return
            if awaited != announced and now - begun > SILENT:
                announced = awaited
                self.get_logger().info(f'waits for {awaited}')
            self._give_up(awaited, counted_from, self._patience)
            yield from self._heeding()

    @property
    def _planner_lacking(self) -> str:
        """Describe what is missing of a planner; empty if it is ready."""
        if not self._out['goal'].get_subscription_count():
            return 'a subscriber of goal'
        return '' if self._commands.get_publisher_count() else 'a planner on cmd_vel'

    def _readers(self, topic: str) -> list[str]:
        """Return the full names of a topic's readers: of nodes, once for each subscription."""
        endpoints = self.get_subscriptions_info_by_topic(topic)
        return [full_name(each) for each in endpoints if each.node_name != UNKNOWN]

    def _give_up(self, awaited: str, since: float, patience: float) -> None:
        """End this process if something has been awaited for too long [s]."""
        waited = self.steady_now() - since
        if waited > patience:
            self.get_logger().fatal(f'waited {waited:.0f} s in vain for {awaited}: giving up')
            self.exit_code = FAILED

    # --- in lock-step

    def _in_lock_step(self) -> Course:
        """Fly a step as soon as the command with the stamp of the newest odometry arrives.

        The last odometry is answered too, so that every run has the same messages. If faults leave
        no odometry to answer, or lose the answer, the step is flown on the last command while that
        is in force. With faults, odometry is sent some time after clock and goals, because stamps
        no longer show which messages belong together, and DDS does not preserve order across
        topics. With a ``rate`` or a shared clock, the next step is not published before its time.
        """
        yield from self._meeting()
        half = 0.5 * self._scenario.model.step * SECOND  # far above rounding errors
        newest, goal_sent = -np.inf, False  # true time of the newest odometry sent [s]
        heard = -np.inf  # simulated arrival time of the last command [s]
        while not self._finished:
            while not self._due or self._now > self._shared + half:
                yield
            self._due = not self._rate
            sent, answered = self._view.of(self._flight), None
            valid = [each for each in sent if np.isfinite(each.position).all()]
            goal_sent |= not all(isinstance(each, Odometry) for each in valid)
            for seen in valid:  # the planner will answer the newest odometry
                if isinstance(seen, Odometry) and seen.time > newest:
                    newest = seen.time
                    answered = self._stamp_of(seen, self._now) if goal_sent else None
            order = yield from self._answer(sent, answered)
            if order is not None and not self._view.command_lost(self._flight.ticks):
                self._order, heard = order, self._flight.vehicle.time
            if self._flight.over:
                self._finish()
            else:
                self._fly(heard + self._scenario.command_timeout - self._flight.vehicle.time)
        yield

    def _answer(self, sent: list[Seen], answered: int | None) -> Answer:
        """Publish the flight until odometry of a stamp [ns] is answered; return any answer."""
        begun, shared = self.steady_now(), self._scenario.clock == 'shared'
        while True:
            shown_at, waited = self.steady_now(), 0.0
            self._show(sent, APART if self._scenario.faults != Faults() else 0.0)
            while waited <= (SETTLED if answered is None else RESEND):
                order = yield
                if order is not None and order.stamp == answered:
                    return order
                waited = self.steady_now() - shown_at
            if answered is None:
                return None
            # Vehicles with a shared clock wait for each other, too.
            patience = self._patience if shared else min(PATIENCE, self._patience)
            self._give_up(self._planner_lacking or NO_ANSWER, begun, patience)

    # --- in real time

    def _in_real_time(self) -> Course:
        """Fly each step when its time is over, on the command in force, once there has been one.

        The vehicle is stopped when no command has come for ``command_timeout``, or as soon as DDS
        reports that the last planner with a liveliness lease has lost it, long before a command is
        due. Planners on a busy machine lose it too: once regained, the last command is in force
        again.
        """
        yield from self._meeting()
        while not self._finished:
            begun = self.steady_now()
            self._show(self._view.of(self._flight))
            if self._flight.over:
                self._finish()
            self._due = False
            while not self._due:
                yield from self._heeding()
            if self._expires > -math.inf:
                self._fly(min(self._expires, self._stopped) - begun)
        yield

    def _heeding(self) -> Course:
        """Wait; in real time put a command that comes in force, and stop when it has expired."""
        order = yield
        if self._wall and order is not None and not self._view.command_lost(self._flight.ticks):
            self._order, self._stopped = order, math.inf
            self._expires = self.steady_now() + self._scenario.command_timeout
        elif self._stopped == math.inf and self.steady_now() >= self._expires:
            self._stop(f'no command for {self._scenario.command_timeout:g} s')

    def _stop(self, reason: str) -> None:
        """Stop the vehicle and report why, even if it has already stopped for another reason."""
        if self._expires == -math.inf or self._finished:  # no command so far
            return
        self._stopped = min(self._stopped, self._expires, self.steady_now())
        share, turn = self._scenario.failsafe_fraction, self._scenario.failsafe_rate
        kept = f'failsafe at {share:g} of full speed or thrust, {turn:g} rad/s'
        self._warn(f'{reason}: {kept if share or turn else "stopped"}')

    # --- flying and publishing

    def _stamp_of(self, seen: Seen, now: int) -> int:
        """Return the stamp of a message that arrives ``now`` [ns], the stamp of this tick."""
        return now - round((self._flight.vehicle.time - seen.time) * SECOND)

    def _show(self, seen: Sequence[Seen], apart: float = 0.0) -> None:
        """Publish the present state of the flight, then goals, then odometry ``apart`` [s]."""
        stamp = Stamp(self._now, self._scenario.frames)
        for topic, message in outputs.shown(stamp, self._name, self._flight):
            self._out[topic].publish(message)
        for each in sorted(seen, key=lambda each: isinstance(each, Odometry)):
            if isinstance(each, Odometry):
                time.sleep(apart)
            at = replace(stamp, nanoseconds=self._stamp_of(each, stamp.nanoseconds))
            topic, message = outputs.sensed(at, each)
            self._out[topic].publish(message)

    def _fly(self, held: float) -> None:
        """Fly a step on the last command, which is in force for its first ``held`` [s].

        A failure of the engine ends the flight and this node.
        """
        try:
            self._flight = self._flight.after(self._order.fraction, self._order.body_rate, held)
        except EngineFailure as error:
            self._finished, self.exit_code = True, FAILED
            self.get_logger().fatal(f'the engine has failed: {error}')

    def _finish(self) -> None:
        """Report how the flight ended; then exit, or wait for a restart."""
        flight = self._flight
        self._finished = True
        self._out['captured'].publish(Bool(data=flight.captured))
        ending = f'{outcome(flight)}, after {flight.ticks} ticks'
        numbers = {'distance': flight.distance, 'speed': flight.speed, 'ticks': flight.ticks}
        if 'truth' in self._out:
            numbers |= {'least_airspeed': flight.least_airspeed, 'stalls': flight.stalls}
        self._diagnose(messages.OK if flight.captured else messages.WARN, ending, numbers)
        self.get_logger().info(ending)
        if self._scenario.exit_when_done:
            self.exit_code = DONE if flight.captured else FAILED

    def _warn(self, text: str) -> None:
        """Report a problem."""
        self.get_logger().warning(text, throttle_duration_sec=1.0)
        self._diagnose(messages.ERROR, text, dict(self._refused))

    def _diagnose(self, level: bytes, text: str, values: Mapping[str, object]) -> None:
        health = messages.health_message(self._now, self._name, 'flight', level, text, values)
        self._out['/diagnostics'].publish(health)


# --- commands: a twist, and a thrust at translation order 2


class Order(NamedTuple):
    """A complete command."""

    stamp: int  # of the odometry that it answers [ns]
    fraction: float  # share of full speed or thrust
    body_rate: Array  # shape (1,) or (3,) [rad/s]


Course = Generator[None, Order | None, None]
Answer = Generator[None, Order | None, Order | None]


class Orders:
    """Assembles commands; one of translation order 2 is two messages with the same stamp."""

    def __init__(self, settings: SimSettings) -> None:
        self._settings = settings
        self._latest: dict[str, Order] = {}  # what each topic said last

    def take(self, topic: str, message: Any, now: int) -> Order | None:
        """Take in ``cmd_vel`` or ``cmd_thrust``, and return the command that it completes, if any.

        Args:
            topic: of the message.
            message: a TwistStamped or a WrenchStamped.
            now: time [ns].

        Raises:
            BadInput: the stamp, a number or a range is not acceptable.
        """
        settings, frames = self._settings, self._settings.frames
        pushing, full, culprit, unit = 'cmd_vel', settings.forward, 'twist.linear', 'm/s'
        if settings.translation_order == 2:
            pushing, full, culprit, unit = 'cmd_thrust', settings.mass * full, 'wrench.force', 'N'
        stamp, push, turn = read_command(message, frames)
        if stamp > now + AHEAD * SECOND:
            ahead = (stamp - now) / SECOND
            raise BadInput('header.stamp', f'{ahead:g} s in the future', f'at most {AHEAD:g} s')
        body_rate = turn[-settings.model.rates :]
        if topic == 'cmd_vel':
            fastest = math.pi / settings.model.step  # a faster one would look slower in steps
            if float(np.linalg.norm(body_rate)) > fastest * (1.0 + SLACK):
                allowed = f'at most pi / step = {fastest:.6g} rad/s'
                raise BadInput('twist.angular', body_rate.tolist(), allowed)
        if topic == pushing and not -SLACK <= push / full <= 1.0 + SLACK:
            allowed = f'0 to full speed or thrust, {full:g} {unit}'
            raise BadInput(f'{culprit}.{frames.thrust_axis}', push, allowed)
        self._latest[topic] = Order(stamp, push / full, body_rate)
        turned, pushed = (self._latest.get(each) for each in ('cmd_vel', pushing))
        stray = topic not in ('cmd_vel', pushing)  # a thrust at translation order 1
        if stray or turned is None or pushed is None or turned.stamp != pushed.stamp:
            return None
        return turned._replace(fraction=pushed.fraction)


main = partial(run, SimNode)
