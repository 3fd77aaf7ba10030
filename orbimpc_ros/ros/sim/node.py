"""The simulator node: flies a scenario on the commands it gets, in lock-step or in real time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TransformStamped, TwistStamped, Vector3, WrenchStamped
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.loop.odometry import Odometry
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.markers import world_markers
from orbimpc_ros.ros.messages import SECOND, Stamp
from orbimpc_ros.ros.parameters import SIM, Live, sim_settings
from orbimpc_ros.ros.parameters.sections import unused_sections
from orbimpc_ros.ros.process import DONE, FAILED, Guarded, qos, run
from orbimpc_ros.ros.reports import ERROR, OK, WARN, diagnostics
from orbimpc_ros.ros.sim.commands import Order, Orders
from orbimpc_ros.ros.sim.readers import Readers
from orbimpc_ros.ros.sim.stepping import LockStep, RealTime
from orbimpc_ros.world.faults import Sent, View
from orbimpc_ros.world.flight import Flight, departure

try:
    from tf2_ros import TransformBroadcaster
except ImportError:  # the PyPI wheels of ROS have no tf2
    TransformBroadcaster = None

REFUSALS_TOLD = 1.0  # [s] between diagnostics that tell of refused commands
DEPTH = 10  # in lock-step no message may push another out


class Sim(Guarded):
    """A flight over DDS: shows what is seen of it and flies steps, at one of two paces."""

    def __init__(self) -> None:
        # It makes the time: under simulated time it would wait for itself.
        super().__init__('sim', [Parameter('use_sim_time', value=False)])
        self.refused: Counter[str] = Counter()
        live = Live(self, SIM, sim_settings, lambda settings: settings)
        self.settings = live.prepared
        self._create_publishers()
        self._told = -np.inf  # when a refusal was, on the steady clock [s]
        self.flight = departure(self.settings.scenario, self.settings.begin)
        self.view = self._new_view()
        self.orders = Orders(self.settings.scenario.model)
        self.finished = False
        self._readers = Readers(self, self.settings.wait_for, 'cmd_vel')
        self._pace = LockStep(self) if self.settings.lockstep else RealTime(self)
        self._create_subscriptions()
        live.keep(lambda _unchanged: None)  # nothing is live, yet use_sim_time must be refused
        for section in unused_sections(self):
            name = self.get_fully_qualified_name()
            self.get_logger().warning(f'section {section} is not for {name}: not used')

    def _new_view(self) -> View:
        settings = self.settings
        return View(settings.faults, settings.seed, settings.scenario.model.step)

    def _create_publishers(self) -> None:
        kept = qos(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._captured = self.create_publisher(Bool, 'captured', kept)
        self._odometry = self.create_publisher(OdometryMessage, 'odom', qos(DEPTH))
        self._goal = self.create_publisher(PoseStamped, 'goal', qos(DEPTH))
        self._markers = self.create_publisher(MarkerArray, 'world_markers', qos())
        self._health = self.create_publisher(DiagnosticArray, '/diagnostics', qos(DEPTH))
        if self.settings.goal_path_steps:
            self._goal_path = self.create_publisher(Path, 'goal_path', qos(DEPTH))
        if self.settings.lockstep:
            self._time = self.create_publisher(Clock, '/clock', qos(DEPTH))
        if TransformBroadcaster is not None:
            self._transforms = TransformBroadcaster(self)

    def _create_subscriptions(self) -> None:
        self._commands = [
            self.create_subscription(kind, topic, self.guard(self._taker(topic, take)), qos(DEPTH))
            for kind, topic, take in (
                (TwistStamped, 'cmd_vel', self.orders.take_twist),
                (WrenchStamped, 'cmd_thrust', self.orders.take_force),
            )
        ]
        self.create_service(Trigger, '~/reset', self.guard(self._on_reset))

    def _taker(self, topic: str, take: Callable[[Any, int], bool]) -> Callable[[Any], None]:
        def on_command(message: Any) -> None:
            try:
                complete = take(message, self._pace.now)
            except BadInput as error:
                self._refuse(topic, error)
                return
            if complete:
                self._pace.on_order()

        return on_command

    def _refuse(self, topic: str, error: BadInput) -> None:
        self.refused[f'refused {topic}: {error.culprit}'] += 1
        self.get_logger().warning(f'{topic} refused: {error}', throttle_duration_sec=1.0)
        if self.steady_now() - self._told > REFUSALS_TOLD:
            self._told = self.steady_now()
            self.warn(self._pace.now, f'{topic} refused: {error}')

    # --- what the paces do with it

    @property
    def audience_lacks(self) -> str:
        """Return which readers of the flight are not there yet, in words; empty if all are."""
        count, wanted = self._odometry.get_subscription_count(), self.settings.wait_subscribers
        if count < wanted:
            return f'subscribers of odom: {wanted} (there are {count})'
        return self._readers.lacking(self.steady_now())

    @property
    def planner_lacks(self) -> str:
        """Return what of a planner is not there yet, in words; empty if all of it is."""
        if not self._goal.get_subscription_count():
            return 'a subscriber of goal'
        return '' if self._commands[0].get_publisher_count() else 'a planner on cmd_vel'

    def watch_life(self, heard: Callable[[Any], None]) -> None:
        """Call back when DDS hears, or misses, signs of life from who promises them on cmd_vel."""
        promised = qos(lease=self.settings.lease)
        # Who promises nothing does not match, which is no fault.
        events = SubscriptionEventCallbacks(
            liveliness=self.guard(heard), incompatible_qos=lambda _event: None
        )
        self.create_subscription(
            TwistStamped, 'cmd_vel', lambda _message: None, promised, event_callbacks=events
        )

    def stamp_of(self, sent: Sent, now: int) -> int:
        """Return the stamp of a message that arrives ``now`` [ns], the present tick's stamp."""
        scenario, faults, ticks = self.settings.scenario, self.settings.faults, self.flight.ticks
        jump = faults.jumped(ticks) - faults.jumped(sent.ticks)
        age = sent.age + (ticks - sent.ticks) * scenario.model.step
        return now - round((age + jump) * SECOND)

    def show(self, at: int, seen: Sequence[Sent]) -> None:
        """Publish what is seen of the flight at ``at`` [ns]: clock, goals, odometry."""
        now = Stamp(at, self.settings.frames)
        if self.settings.lockstep:
            self._time.publish(Clock(clock=messages.time_message(at)))
        if self.settings.goal_path_steps:
            self._goal_path.publish(self._future(now))
        self._markers.publish(world_markers(now, self.flight))
        if TransformBroadcaster is not None:
            truth = messages.odometry_message(now, self.flight.vehicle)
            self._transforms.sendTransform(_transform(truth))
        self.say(at, seen)

    def say(self, at: int, seen: Sequence[Sent]) -> None:
        """Publish goals and odometry that arrive at ``at`` [ns]."""
        for sent in seen:
            stamp = Stamp(self.stamp_of(sent, at), self.settings.frames)
            if isinstance(sent.content, Odometry):
                self._odometry.publish(messages.measurement_message(stamp, sent.content))
            else:
                self._goal.publish(messages.goal_message(stamp, sent.content.position))

    def _future(self, stamp: Stamp) -> Path:
        step, rope = self.settings.scenario.model.step, self.settings.scenario.rope
        times = self.flight.elapsed + step * np.arange(self.settings.goal_path_steps + 1)
        return messages.goal_path_message(stamp, step, [rope.at(time) for time in times])

    def fly(self, order: Order | None, held: float) -> None:
        """Fly a step on an order that is in force for ``held`` [s] of it; on none, stand."""
        if order is None:
            self.flight = self.flight.after(0.0, np.zeros(self.settings.scenario.model.rates), 0.0)
        else:
            self.flight = self.flight.after(order.fraction, order.body_rate, held)

    def warn(self, at: int, what: str) -> None:
        """Tell, stamped ``at`` [ns], what is wrong."""
        self.get_logger().warning(what, throttle_duration_sec=1.0)
        name = self.get_fully_qualified_name()
        self._health.publish(diagnostics(at, name, ERROR, what, dict(self.refused)))

    def finish(self, at: int) -> None:
        """Tell, stamped ``at`` [ns], how the flight ended; leave, or hold until ``~/reset``."""
        flight = self.flight
        self.finished = True
        self._captured.publish(Bool(data=flight.captured))
        ending = f'{told(flight)}, after {flight.ticks} ticks'
        self._tell(at, flight, ending)
        self.get_logger().info(ending)
        if self.settings.exit_when_done:
            self.exit_code = DONE if flight.captured else FAILED

    def _tell(self, at: int, flight: Flight, ending: str) -> None:
        """Publish how the flight ended, and how far from the goal and how fast."""
        name = self.get_fully_qualified_name()
        numbers = {'distance': flight.distance, 'speed': flight.speed, 'ticks': flight.ticks}
        level = OK if flight.captured else WARN
        self._health.publish(diagnostics(at, name, level, ending, numbers))

    def _on_reset(self, _request: Any, response: Any) -> Any:
        # Time goes on: stamps never go back.
        later = self.flight.vehicle.time + self.settings.scenario.model.step
        self.flight = departure(self.settings.scenario, later)
        self.view = self._new_view()
        self.finished = False
        self._captured.publish(Bool(data=False))
        self._pace.restart()
        response.success, response.message = True, 'back at the start'
        return response


def told(flight: Flight) -> str:
    """Return in words how a flight has ended."""
    done = '' if flight.captured else 'not '
    if flight.scenario.finish == 'arrival':
        where = f'{flight.distance:.2e} m from the goal at {flight.speed:.2e} m/s'
        return f'{done}arrived: {where}'
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


def main(argv: Sequence[str] | None = None) -> int:
    """Run the simulator; return the exit code."""
    return run(Sim, argv)
