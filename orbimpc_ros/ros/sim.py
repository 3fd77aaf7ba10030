"""The simulator node: flies a scenario on the commands it gets, in lock-step or in real time."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TransformStamped, TwistStamped, Vector3, WrenchStamped
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.markers import world_markers
from orbimpc_ros.ros.messages import SECOND, Stamp
from orbimpc_ros.ros.orders import Order, Orders
from orbimpc_ros.ros.parameters import SIM, Live, sim_settings
from orbimpc_ros.ros.process import DONE, FAILED, Guarded, qos, run
from orbimpc_ros.ros.reports import OK, WARN, diagnostics
from orbimpc_ros.world.flight import Flight, departure

try:
    from tf2_ros import TransformBroadcaster
except ImportError:  # the PyPI wheels of ROS have no tf2
    TransformBroadcaster = None

LOOK = 0.02  # [s] lock-step: how often to look whether anybody is there, or has gone
RESEND = 0.5  # [s] lock-step: ask again without an answer; first messages may be lost
PATIENCE = 20.0  # [s] lock-step: give up without an answer
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
        self.flight = departure(self.settings.scenario)
        self.orders = Orders(self.settings.scenario.model)
        self.finished = False
        self._pace = LockStep(self) if self.settings.lockstep else RealTime(self)
        self._create_subscriptions()
        live.keep(lambda _unchanged: None)  # nothing is live, yet use_sim_time must be refused

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

    def _taker(self, topic: str, take: Callable[[Any], None]) -> Callable[[Any], None]:
        def on_command(message: Any) -> None:
            try:
                take(message)
            except BadInput as error:
                self.refused[f'{topic}: {error.culprit}'] += 1
                self.get_logger().warning(f'{topic} refused: {error}', throttle_duration_sec=1.0)
                return
            self._pace.on_order()

        return on_command

    # --- what the paces do with it

    @property
    def listeners(self) -> int:
        """Return how many subscribers of odom are connected, if the goal has one as well."""
        if not self._goal.get_subscription_count():
            return 0
        return self._odometry.get_subscription_count()

    @property
    def commanded(self) -> bool:
        """Return whether a planner is connected."""
        return self._commands[0].get_publisher_count() > 0

    def show(self, at: int) -> None:
        """Publish what is seen of the flight, stamped ``at`` [ns]: clock, goal, odometry."""
        stamp = Stamp(at, self.settings.frames)
        if self.settings.lockstep:
            self._time.publish(Clock(clock=messages.time_message(at)))
        if self.settings.goal_path_steps:
            self._goal_path.publish(self._future(stamp))
        self._goal.publish(messages.goal_message(stamp, self.flight.goal))
        self._markers.publish(world_markers(stamp, self.flight))
        odometry = messages.odometry_message(stamp, self.flight.vehicle)
        if TransformBroadcaster is not None:
            self._transforms.sendTransform(_transform(odometry))
        self._odometry.publish(odometry)

    def _future(self, stamp: Stamp) -> Path:
        step, rope = self.settings.scenario.model.step, self.settings.scenario.rope
        times = self.flight.elapsed + step * np.arange(self.settings.goal_path_steps + 1)
        return messages.goal_path_message(stamp, step, [rope.at(time) for time in times])

    def fly(self, fraction: float, body_rate: np.ndarray) -> None:
        """Fly a step."""
        self.flight = self.flight.after(fraction, body_rate)

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


class LockStep:
    """Flies a step as soon as the command for the odometry's own stamp is there.

    The last odometry is answered too, though that command is not flown: so every run has the
    same messages.
    """

    def __init__(self, sim: Sim) -> None:
        self._sim = sim
        self.restart()
        sim.every(LOOK, self.look)

    def restart(self) -> None:
        """Ask anew as soon as everybody is there."""
        self._awaited: int | None = None  # stamp of the odometry to be answered [ns]
        self._progress = self._sent = self._sim.steady_now()

    def look(self) -> None:
        """Start when everybody is there; ask again or give up when no answer comes."""
        if self._sim.finished:
            return
        now = self._sim.steady_now()
        absent = self._absent()
        if self._awaited is None and not absent:
            self._ask()
        elif now - self._progress > PATIENCE:
            self._give_up(absent or 'an answer to the odometry on cmd_vel')
        elif self._awaited is not None and now - self._sent > RESEND:
            self._send()

    def _absent(self) -> str:
        listeners, wanted = self._sim.listeners, self._sim.settings.wait_subscribers
        if listeners < wanted:
            return f'{wanted} subscribers on odom and goal (there are {listeners})'
        return '' if self._sim.commanded else 'a planner on cmd_vel'

    def _give_up(self, awaited: str) -> None:
        self._sim.get_logger().fatal(f'waited {PATIENCE:g} s in vain for {awaited}: giving up')
        self._sim.exit_code = FAILED

    def _ask(self) -> None:
        self._awaited = round(self._sim.flight.vehicle.time * SECOND)
        self._progress = self._sim.steady_now()
        self._send()

    def _send(self) -> None:
        assert self._awaited is not None
        self._sent = self._sim.steady_now()
        self._sim.show(self._awaited)

    def on_order(self) -> None:
        """Fly a step if this is the answer awaited."""
        order = self._sim.orders.latest
        if self._sim.finished or order is None or order.stamp != self._awaited:
            return
        if self._sim.flight.over:
            self._sim.finish(order.stamp)
            return
        self._sim.fly(order.fraction, order.body_rate)
        self._ask()


class RealTime:
    """Flies a step when its time is over, on the command in force; waits for the first command.

    Without a fresh command the vehicle stops: a vehicle whose planner is gone must be safe.
    """

    def __init__(self, sim: Sim) -> None:
        self._sim = sim
        self.restart()
        sim.every(sim.settings.scenario.model.step, self.on_time)

    def restart(self) -> None:
        """Wait for a first command."""
        self._order: Order | None = None
        self._heard = -np.inf

    def on_order(self) -> None:
        """Put a command in force."""
        self._order, self._heard = self._sim.orders.latest, self._sim.steady_now()

    def on_time(self) -> None:
        """Fly a step, unless nobody has commanded yet, and show where it led."""
        if self._sim.finished:
            return
        if self._order is not None:
            self._sim.fly(*self._in_force(self._order))
        now = self._sim.get_clock().now().nanoseconds
        self._sim.show(now)
        if self._sim.flight.over:
            self._sim.finish(now)

    def _in_force(self, order: Order) -> tuple[float, np.ndarray]:
        silent = self._sim.steady_now() - self._heard
        if silent <= self._sim.settings.command_timeout:
            return order.fraction, order.body_rate
        self._sim.get_logger().warning(
            f'no command for {silent:.2f} s: stopped', throttle_duration_sec=1.0
        )
        return 0.0, np.zeros_like(order.body_rate)


def _transform(odometry: OdometryMessage) -> TransformStamped:
    message = TransformStamped(header=odometry.header, child_frame_id=odometry.child_frame_id)
    place = odometry.pose.pose.position
    message.transform.translation = Vector3(x=place.x, y=place.y, z=place.z)
    message.transform.rotation = odometry.pose.pose.orientation
    return message


def main(argv: Sequence[str] | None = None) -> int:
    """Run the simulator; return the exit code."""
    return run(Sim, argv)


if __name__ == '__main__':
    sys.exit(main())
