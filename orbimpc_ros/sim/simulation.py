# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A simulated flight over DDS: it goes on step by step, and is shown on topics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TransformStamped, Vector3
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from rclpy.qos import DurabilityPolicy
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from visualization_msgs.msg import MarkerArray

from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.lifecycle import Managed
from orbimpc_ros.ros.messages import (
    ERROR,
    OK,
    SECOND,
    WARN,
    Stamp,
    diagnostics,
    health_message,
)
from orbimpc_ros.ros.process import DONE, FAILED, qos
from orbimpc_ros.sim.commands import Order, Orders
from orbimpc_ros.sim.engines import EngineFailure
from orbimpc_ros.sim.faults import Delivery, View
from orbimpc_ros.sim.markers import traffic_markers, world_markers
from orbimpc_ros.sim.parameters import SimSettings
from orbimpc_ros.sim.vehicle import Continuous, measured
from orbimpc_ros.sim.waiting import Waiting
from orbimpc_ros.sim.world import Airspeeds, Flight, departure

try:
    from tf2_ros import TransformBroadcaster
except ImportError:  # the PyPI wheels of ROS have no tf2
    TransformBroadcaster = None

DEPTH = 10  # in lock-step no message may push another out


class FlightSimulation:
    """A flight, shown on topics, that goes on a step at a time.

    Attributes:
        flight: now.
        view: the messages of it that reach a planner.
        orders: the commands that have come.
        refused: commands refused so far, by topic and field.
        waiting: for planner and readers before it begins.
        finished: whether the flight has ended.
        airspeeds: of the flight so far, if its vehicle is one in continuous time.
    """

    def __init__(self, node: Managed, settings: SimSettings, commands: Subscription) -> None:
        body = own_frame(settings.child_frame_id, node.get_namespace())
        settings = replace(settings, child_frame_id=body)
        self.node, self.settings = node, settings
        self.orders = Orders(settings.scenario.model, settings.frames)
        self.refused: Counter[str] = Counter()
        self._create_publishers()
        self.waiting = Waiting(
            node,
            self._odometry,
            settings.wait_subscribers,
            settings.wait_for,
            self._goal,
            commands,
        )
        self._begin(settings.begin)

    def _begin(self, time: float) -> None:
        settings = self.settings
        self.flight = departure(settings.scenario, time)
        self.view = View(settings.faults, settings.seed, settings.scenario.model.step)
        self.finished = False
        model = settings.scenario.model
        self.airspeeds: Airspeeds | None = None
        if isinstance(model, Continuous):
            self.airspeeds = Airspeeds(model.stall_speed).seeing([self.flight.vehicle])

    def _create_publishers(self) -> None:
        create = self.node.create_publisher
        kept = qos(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._captured = create(Bool, 'captured', kept)
        self._odometry = create(OdometryMessage, 'odom', qos(DEPTH))
        self._goal = create(PoseStamped, 'goal', qos(DEPTH))
        self._markers = create(MarkerArray, 'world_markers', qos())
        self._health = create(DiagnosticArray, '/diagnostics', qos(DEPTH))
        if self.settings.scenario.traffic:
            self._obstacles = create(MarkerArray, 'obstacles', qos(DEPTH))
        if self.settings.goal_path_steps:
            self._goal_path = create(Path, 'goal_path', qos(DEPTH))
        if self._has_own_clock:
            self._time = create(Clock, '/clock', qos(DEPTH))
        if isinstance(self.settings.scenario.model, Continuous):
            self._truth = create(DiagnosticArray, 'truth', qos(DEPTH))
        if TransformBroadcaster is not None:
            self._transforms = TransformBroadcaster(self.node)

    @property
    def _has_own_clock(self) -> bool:
        return self.settings.lockstep and not self.settings.shared_clock

    @property
    def jump(self) -> float:
        """Return how far off stamps are now, by the faults [s]."""
        return self.settings.faults.jumped(self.flight.ticks)

    def stamp_of(self, sent: Delivery, now: int) -> int:
        """Return the stamp of a message that arrives ``now`` [ns], the present tick's stamp."""
        scenario, ticks = self.settings.scenario, self.flight.ticks
        jump = self.jump - self.settings.faults.jumped(sent.ticks)
        age = sent.age + (ticks - sent.ticks) * scenario.model.step
        return now - round((age + jump) * SECOND)

    def show(self, at: int, seen: Sequence[Delivery]) -> None:
        """Publish the flight at ``at`` [ns]: clock, markers, goals, odometry."""
        now = Stamp(at, self.settings.frames)
        if self._has_own_clock:
            self._time.publish(Clock(clock=messages.time_message(at)))
        if self.settings.scenario.traffic:
            self._obstacles.publish(traffic_markers(now, self.flight))
        if self.settings.goal_path_steps:
            self._goal_path.publish(self._future(now))
        self._markers.publish(world_markers(now, self.flight))
        if self.airspeeds is not None:
            name = f'{self.node.get_fully_qualified_name()}: truth'
            self._truth.publish(truth_message(at, name, self.flight, self.airspeeds))
        if TransformBroadcaster is not None:
            shown = messages.odometry_message(now, measured(self.flight.vehicle))
            self._transforms.sendTransform(_transform(shown))
        self.deliver(at, seen)

    def deliver(self, at: int, seen: Sequence[Delivery]) -> None:
        """Publish goals and odometry that arrive at ``at`` [ns]."""
        for sent in seen:
            stamp = Stamp(self.stamp_of(sent, at), self.settings.frames)
            if isinstance(sent.content, Odometry):
                self._odometry.publish(messages.odometry_message(stamp, sent.content))
            else:
                self._goal.publish(messages.goal_message(stamp, sent.content.position))

    def _future(self, stamp: Stamp) -> Path:
        step, rope = self.settings.scenario.model.step, self.settings.scenario.rope
        times = self.flight.elapsed + step * np.arange(self.settings.goal_path_steps + 1)
        return messages.goal_path_message(stamp, step, [rope.at(time) for time in times])

    def fly(self, order: Order | None, held: float) -> None:
        """Fly a step on an order that is in force for ``held`` [s] of it; without one, stand.

        An engine that fails ends the flight, and this node.
        """
        still = 0.0, np.zeros(self.settings.scenario.model.rates), 0.0
        command = still if order is None else (order.fraction, order.body_rate, held)
        try:
            self.flight = self.flight.after(*command)
        except EngineFailure as error:
            self.finished, self.node.exit_code = True, FAILED
            self.node.get_logger().fatal(f'the engine has failed: {error}')
            return
        if self.airspeeds is not None:
            self.airspeeds = self.airspeeds.seeing(self.flight.trail)

    def warn(self, at: int, text: str) -> None:
        """Report what is wrong, stamped ``at`` [ns]."""
        self.node.get_logger().warning(text, throttle_duration_sec=1.0)
        self._diagnose(at, ERROR, text, dict(self.refused))

    def finish(self, at: int) -> None:
        """Report how the flight ended, stamped ``at`` [ns]; then exit, or wait for a restart."""
        flight = self.flight
        self.finished = True
        self._captured.publish(Bool(data=flight.captured))
        ending = f'{outcome(flight)}, after {flight.ticks} ticks'
        numbers = {'distance': flight.distance, 'speed': flight.speed, 'ticks': flight.ticks}
        if self.airspeeds is not None:
            numbers |= {'least_airspeed': self.airspeeds.least, 'stalls': self.airspeeds.stalls}
        self._diagnose(at, OK if flight.captured else WARN, ending, numbers)
        self.node.get_logger().info(ending)
        if self.settings.exit_when_done:
            self.node.exit_code = DONE if flight.captured else FAILED

    def _diagnose(self, at: int, level: bytes, text: str, values: Mapping[str, object]) -> None:
        name = self.node.get_fully_qualified_name()
        self._health.publish(health_message(at, name, 'flight', level, text, values))

    def restart(self) -> None:
        """Begin again; time goes on, for stamps never go back."""
        self._begin(self.flight.vehicle.time + self.settings.scenario.model.step)
        self._captured.publish(Bool(data=False))


def own_frame(body: str, namespace: str) -> str:
    """Return a body's frame: vehicles share a world and /tf, where each body has its own name."""
    prefix = namespace.strip('/')
    return body if not prefix or body.startswith(f'{prefix}/') else f'{prefix}/{body}'


def truth_message(at: int, name: str, flight: Flight, airspeeds: Airspeeds) -> DiagnosticArray:
    """Return the true state of a simulated vehicle at a time [ns], as a status of a name."""
    vehicle, now = flight.vehicle, flight.vehicle.airspeed
    values = {
        'airspeed': now,
        'least_airspeed': airspeeds.least,
        'stalls': airspeeds.stalls,
        'wind': vehicle.wind.tolist(),
        'position': vehicle.position.tolist(),
        'velocity': vehicle.velocity.tolist(),
        'body_rate': vehicle.body_rate.tolist(),
        'speed_fraction': vehicle.fraction,
        'touched': sorted(flight.touched),
        **vehicle.facts,
    }
    if airspeeds.stalled:
        slow = f'stalled: {now:.3g} m/s, below {airspeeds.stall_speed:g} m/s'
        return diagnostics(at, name, WARN, slow, values)
    return diagnostics(at, name, OK, 'flies', values)


def touched_in_words(numbers: Collection[int], boxes: int) -> str:
    """Return the names of touched boxes and balls, counted from 1, of which so many are boxes."""
    named = {'box': [k + 1 for k in sorted(numbers) if k < boxes]}
    named['ball'] = [k + 1 - boxes for k in sorted(numbers) if k >= boxes]
    plural = {'box': 'boxes', 'ball': 'balls'}
    return ' and '.join(
        f'{name if len(counted) == 1 else plural[name]} {", ".join(map(str, counted))}'
        for name, counted in named.items()
        if counted
    )


def outcome(flight: Flight) -> str:
    """Return in words how a flight has ended."""
    done = '' if flight.captured else 'not '
    if flight.touched:
        return f'touched {touched_in_words(flight.touched, len(flight.scenario.obstacles))}'
    if flight.scenario.finish == 'arrival':
        where = f'{flight.distance:.2e} m from the goal at {flight.speed:.2e} m/s'
        return f'{done}arrived: {where}'
    if not flight.captured and flight.near:
        return f'not captured: {flight.miss:.3f} m from the goal, outside the cone of approach'
    if flight.vehicle.lost:
        return 'not captured: something else of the vehicle touched the goal first'
    if not flight.captured:
        return 'not captured'
    when = flight.missed_at - flight.scenario.start.time
    return f'captured at t = {when:.2f} s, {flight.miss:.3f} m from the goal'


def _transform(odometry: OdometryMessage) -> TransformStamped:
    message = TransformStamped(header=odometry.header, child_frame_id=odometry.child_frame_id)
    place = odometry.pose.pose.position
    message.transform.translation = Vector3(x=place.x, y=place.y, z=place.z)
    message.transform.rotation = odometry.pose.pose.orientation
    return message
