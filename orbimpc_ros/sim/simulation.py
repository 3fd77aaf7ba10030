# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A flight on topics: waiting for nodes, taking commands, flying a step, publishing its state."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from std_msgs.msg import Bool

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND, Stamp, read_command
from orbimpc_ros.ros.process import DONE, FAILED, LATCHED, Managed, full_name, qos
from orbimpc_ros.ros.topics import message_of
from orbimpc_ros.sim import outputs
from orbimpc_ros.sim.engines import EngineFailure
from orbimpc_ros.sim.outputs import Seen, View
from orbimpc_ros.sim.parameters import SimSettings
from orbimpc_ros.sim.world import departure, outcome

DEPTH = 10  # queue depth: in lock-step no message may be dropped
SILENT = 2.0  # [s] of waiting before it is logged
MEETING = 1.5  # [s] for DDS to match planner and readers, which this node cannot observe
TRANSITIONS = 'transition_event'  # a topic of every managed node
SLACK = 1e-3  # relative tolerance of shares and rates for rounding, negligible in control
AHEAD = 1.0  # [s] that a command's stamp may be ahead of this clock
UNKNOWN = '_NODE_NAME_UNKNOWN_'  # of a reader that is discovered before its node


class FlightSimulation(ABC):
    """A flight on topics that advances step by step; subclasses set its pace.

    Attributes:
        begun: simulated time at its start [s].
        flight: its present state.
        view: the messages of it that reach a planner.
        finished: whether the flight has ended.
        order: the last command.
    """

    def __init__(self, node: Managed, settings: SimSettings) -> None:
        prefix, body = node.get_namespace().strip('/'), settings.child_frame_id
        if prefix and not body.startswith(f'{prefix}/'):  # unique among vehicles that share /tf
            body = f'{prefix}/{body}'
        self.node, self.settings = node, replace(settings, child_frame_id=body)
        self._orders = Orders(self.settings)
        self._refused: Counter[str] = Counter()  # number of refused commands, by topic and field
        deep, self._name = qos(DEPTH), node.get_fully_qualified_name()
        self._commands, _ = (
            node.create_subscription(message_of(name), name, node.at_work(self._take, name), deep)
            for name in ('cmd_vel', 'cmd_thrust')
        )
        self._begin(settings.begin)
        states = [topic for topic, _ in outputs.shown(Stamp(0), self._name, self.flight)]
        self._out = {
            name: node.create_publisher(message_of(name), name, deep)
            for name in ('odom', 'goal', '/diagnostics', *states)
        }
        self._out['captured'] = node.create_publisher(Bool, 'captured', LATCHED)

    def _begin(self, at: float) -> None:
        self.begun, self.flight = at, departure(self.settings)
        self.view = View(self.settings)
        self.finished = False
        self.order = Order(0, 0.0, np.zeros(self.settings.model.rates))

    # --- pace

    @property
    @abstractmethod
    def now(self) -> int:
        """Return the time for stamps [ns], including jumps by faults."""

    @abstractmethod
    def course(self) -> Course:
        """Wait for planner and readers, then fly to the end, waiting at each ``yield``."""

    def start(self) -> None:
        """Begin the course of the flight."""
        self._course = self.course()
        next(self._course)

    def resume(self) -> None:
        """Continue the course because time has passed."""
        if not self.finished:
            next(self._course)

    def on_order(self, order: Order) -> None:
        """Continue the course with a complete command."""
        if not self.finished:
            self._course.send(order)

    def restart(self) -> None:
        """Begin a new flight; time continues, because stamps must not go back."""
        self._begin(self.begun + self.flight.vehicle.time + self.settings.model.step)
        self._out['captured'].publish(Bool(data=False))
        self.start()

    # --- waiting for planner and readers

    def waiting(self, *, planner: bool) -> Iterator[tuple[str, float]]:
        """Yield what is awaited, readers and, if ``planner``, a planner, until all are there.

        It comes with the time from which patience counts [s]: the begin, or the last sight of a
        planner that is being configured. Only managed planners count as such: others may read goals
        through another node. Changes of what is missing are logged.
        """
        node, announced = self.node, ''
        wanted, fewest = self.settings.wait_for, self.settings.wait_subscribers
        begun = counted_from = met_after = node.steady_now()
        while True:
            now = node.steady_now()
            found = node.get_publishers_info_by_topic(self._commands.topic_name)
            planners, goal = {*map(full_name, found)}, self._out['goal'].topic_name
            silent = planners.difference(self._readers(goal)) if planner else ()
            coming = [name for name in silent if node.count_publishers(f'{name}/{TRANSITIONS}')]
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
            elif not (awaited := self.planner_lacking if planner else ''):
                return
            if awaited != announced and now - begun > SILENT:
                announced = awaited
                node.get_logger().info(f'waits for {awaited}')
            yield awaited, counted_from

    @property
    def planner_lacking(self) -> str:
        """Describe what is missing of a planner; empty if it is ready."""
        if not self._out['goal'].get_subscription_count():
            return 'a subscriber of goal'
        return '' if self._commands.get_publisher_count() else 'a planner on cmd_vel'

    def _readers(self, topic: str) -> list[str]:
        """Return the full names of a topic's readers: of nodes, once for each subscription."""
        found = self.node.get_subscriptions_info_by_topic(topic)
        return [full_name(each) for each in found if each.node_name != UNKNOWN]

    # --- commands

    def _take(self, topic: str, message: Any) -> None:
        """Take in a command message; a complete command goes to :meth:`on_order`."""
        try:
            order = self._orders.take(topic, message, self.now)
        except BadInput as error:
            self._refused[f'refused {topic}: {error.culprit}'] += 1
            self.warn(f'{topic} refused: {error}')
            return
        if order is not None:
            self.on_order(order)

    # --- flying and publishing

    @property
    def jump(self) -> float:
        """Return the present error of stamps by faults [s]."""
        return self.settings.faults.jumped(self.flight.ticks)

    def stamp_of(self, seen: Seen, now: int) -> int:
        """Return the stamp of a message that arrives ``now`` [ns], the stamp of this tick."""
        return now - round((self.flight.vehicle.time - seen.time) * SECOND)

    def show(self, seen: Sequence[Seen], apart: float = 0.0) -> None:
        """Publish the present state of the flight, then goals, then odometry ``apart`` [s]."""
        stamp = Stamp(self.now, self.settings.frames)
        for topic, message in outputs.shown(stamp, self._name, self.flight):
            self._out[topic].publish(message)
        for each in sorted(seen, key=lambda each: isinstance(each, Odometry)):
            if isinstance(each, Odometry):
                time.sleep(apart)
            at = replace(stamp, nanoseconds=self.stamp_of(each, stamp.nanoseconds))
            topic, message = outputs.sensed(at, each)
            self._out[topic].publish(message)

    def fly(self, held: float) -> None:
        """Fly a step on the last command, which is in force for its first ``held`` [s].

        A failure of the engine ends the flight and this node.
        """
        try:
            self.flight = self.flight.after(self.order.fraction, self.order.body_rate, held)
        except EngineFailure as error:
            self.finished, self.node.exit_code = True, FAILED
            self.node.get_logger().fatal(f'the engine has failed: {error}')

    def warn(self, text: str) -> None:
        """Report a problem."""
        self.node.get_logger().warning(text, throttle_duration_sec=1.0)
        self._diagnose(messages.ERROR, text, dict(self._refused))

    def finish(self) -> None:
        """Report how the flight ended; then exit, or wait for a restart."""
        flight = self.flight
        self.finished = True
        self._out['captured'].publish(Bool(data=flight.captured))
        ending = f'{outcome(flight)}, after {flight.ticks} ticks'
        numbers = {'distance': flight.distance, 'speed': flight.speed, 'ticks': flight.ticks}
        if 'truth' in self._out:
            numbers |= {'least_airspeed': flight.least_airspeed, 'stalls': flight.stalls}
        self._diagnose(messages.OK if flight.captured else messages.WARN, ending, numbers)
        self.node.get_logger().info(ending)
        if self.settings.exit_when_done:
            self.node.exit_code = DONE if flight.captured else FAILED

    def _diagnose(self, level: bytes, text: str, values: Mapping[str, object]) -> None:
        health = messages.health_message(self.now, self._name, 'flight', level, text, values)
        self._out['/diagnostics'].publish(health)


# --- commands: a twist, and a thrust at translation order 2


@dataclass(frozen=True)
class Order:
    """A complete command."""

    stamp: int  # of the odometry that it answers [ns]
    fraction: float  # share of full speed or thrust
    body_rate: Array  # shape (1,) or (3,) [rad/s]


Course = Generator[None, Order | None, None]


class Orders:
    """Assembles commands; one of translation order 2 is two messages with the same stamp."""

    def __init__(self, settings: SimSettings) -> None:
        self._settings = settings
        zero: Array = np.zeros(settings.model.rates)
        self._turn = -1, zero  # a stamp [ns], and a body rate [rad/s]
        self._push = -2, 0.0  # a stamp [ns], and a share of full speed or thrust

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
        thrusts, full, culprit, unit = False, settings.forward, 'twist.linear', 'm/s'
        if settings.translation_order == 2:
            thrusts, full, culprit, unit = True, settings.mass * full, 'wrench.force', 'N'
        stamp, push, turn = read_command(message, frames)
        if stamp > now + AHEAD * SECOND:
            ahead = (stamp - now) / SECOND
            raise BadInput('header.stamp', f'{ahead:g} s in the future', f'at most {AHEAD:g} s')
        if topic == 'cmd_vel':
            body_rate = turn[-settings.model.rates :]
            fastest = math.pi / settings.model.step  # a faster one would look slower in steps
            if float(np.linalg.norm(body_rate)) > fastest * (1.0 + SLACK):
                allowed = f'at most pi / step = {fastest:.6g} rad/s'
                raise BadInput('twist.angular', body_rate.tolist(), allowed)
            self._turn = stamp, body_rate
        if (topic == 'cmd_thrust') == thrusts:
            if not -SLACK <= push / full <= 1.0 + SLACK:
                allowed = f'0 to full speed or thrust, {full:g} {unit}'
                raise BadInput(f'{culprit}.{frames.thrust_axis}', push, allowed)
            self._push = stamp, push / full
        (turned, rate), (pushed, share) = self._turn, self._push
        return Order(turned, share, rate) if turned == pushed else None
