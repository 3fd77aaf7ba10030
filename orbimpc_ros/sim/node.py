# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The node of the simulator: a flight in lock-step with its planner or in real time; its reset."""

from __future__ import annotations

import math
from collections.abc import Generator
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.process import FAILED, LIFE, Managed, qos, run
from orbimpc_ros.sim.outputs import Seen
from orbimpc_ros.sim.parameters import SIM, Faults, SimSettings, sim_settings
from orbimpc_ros.sim.simulation import DEPTH, Course, FlightSimulation, Order

LOOK = 0.02  # [s] between checks for planner and readers
SETTLED = 0.1  # [s] lock-step: time for a planner to take in a goal without odometry to answer
APART = 0.01  # [s] lock-step with faults: between goals and odometry, for DDS to keep their order
RESEND = 0.5  # [s] lock-step: resend without an answer; first messages may be lost
PATIENCE = 20.0  # [s] lock-step: give up without an answer
SHARE = 0.75  # of command_timeout for the liveliness lease; the rest is time to report its loss
Answer = Generator[None, Order | None, Order | None]
NO_ANSWER = (
    'an answer to the odometry on cmd_vel: it needs a planner with trigger: odom (with timer, '
    'planner and simulator wait for each other); see its /diagnostics'
)


class LockStep(FlightSimulation):
    """Flies a step as soon as the command with the stamp of the newest odometry arrives.

    The last odometry is answered too, so that every run has the same messages. If faults leave no
    odometry to answer, or lose the answer, the step is flown on the last command while that is in
    force. With faults, odometry is sent some time after clock and goals, because stamps no longer
    show which messages belong together, and DDS does not preserve order across topics. With a
    ``rate`` or a shared clock, the next step is not published before its time.
    """

    def __init__(self, node: Managed, settings: SimSettings) -> None:
        super().__init__(node, settings)
        self._patience = settings.wait_timeout or math.inf  # [s]
        self._apart = APART if settings.faults != Faults() else 0.0
        self._shared = math.inf  # time of the shared clock; infinite without one [ns]
        self._due = True  # whether the rate allows the next step
        if settings.clock == 'shared':
            self._shared = -math.inf
            node.create_subscription(Clock, '/clock', node.at_work(self._on_clock), qos(DEPTH))
        node.every(LOOK, self.resume)
        if settings.rate > 0.0:
            node.every(settings.model.step / settings.rate, self._on_rate)

    @property
    def now(self) -> int:
        """Return the simulated time [ns], including jumps by faults."""
        return round((self.begun + self.flight.vehicle.time + self.jump) * SECOND)

    def _on_clock(self, message: Clock) -> None:
        self._shared = message.clock.sec * SECOND + message.clock.nanosec
        self.resume()

    def _on_rate(self) -> None:
        self._due = True
        self.resume()

    def course(self) -> Course:
        """Fly a step for each answer; see :meth:`FlightSimulation.course`."""
        for absent, since in self.waiting(planner=True):
            self._give_up(absent, since, self._patience)
            yield
        half = 0.5 * self.settings.model.step * SECOND  # far above rounding errors
        newest, goal_sent = -np.inf, False  # true time of the newest odometry sent [s]
        heard = -np.inf  # simulated arrival time of the last command [s]
        while not self.finished:
            while not self._due or self.now > self._shared + half:
                yield
            self._due = not self.settings.rate
            sent, answered = self.view.of(self.flight), None
            told = [each for each in sent if np.isfinite(each.position).all()]
            goal_sent |= not all(isinstance(each, Odometry) for each in told)
            for seen in told:  # the planner will answer the newest odometry
                if isinstance(seen, Odometry) and seen.time > newest:
                    newest = seen.time
                    answered = self.stamp_of(seen, self.now) if goal_sent else None
            order = yield from self._answer(sent, answered)
            if order is not None and not self.view.command_lost(self.flight.ticks):
                self.order, heard = order, self.flight.vehicle.time
            if self.flight.over:
                self.finish()
            else:
                self.fly(heard + self.settings.command_timeout - self.flight.vehicle.time)
        yield

    def _answer(self, sent: list[Seen], answered: int | None) -> Answer:
        """Publish the flight until odometry of a stamp [ns], if any, is answered; return that."""
        begun = self.node.steady_now()
        # Vehicles with a shared clock wait for each other, too.
        longest = math.inf if self.settings.clock == 'shared' else PATIENCE
        while True:
            asked, waited = self.node.steady_now(), 0.0
            self.show(sent, self._apart)
            while waited <= (SETTLED if answered is None else RESEND):
                order = yield
                if order is not None and order.stamp == answered:
                    return order
                waited = self.node.steady_now() - asked
            if answered is None:
                return None
            absent = self.planner_lacking or NO_ANSWER
            self._give_up(absent, begun, min(longest, self._patience))

    def _give_up(self, awaited: str, since: float, patience: float) -> None:
        """End this process if something has been awaited for too long [s]."""
        waited = self.node.steady_now() - since
        if waited > patience:
            self.node.get_logger().fatal(f'waited {waited:.0f} s in vain for {awaited}: giving up')
            self.node.exit_code = FAILED


class RealTime(FlightSimulation):
    """Flies each step when its time is over, on the command in force; waits for the first command.

    The vehicle is stopped when no command has come for ``command_timeout``, or as soon as DDS
    reports that the last planner with a liveliness lease has lost it, long before a command is due.
    Planners on a busy machine lose it too: once regained, the last command is in force again.
    """

    def __init__(self, node: Managed, settings: SimSettings) -> None:
        super().__init__(node, settings)
        node.every(LOOK, self.look)
        node.every(settings.model.step, self.resume)
        # Publishers without a liveliness lease do not match this QoS, which is no fault.
        events = SubscriptionEventCallbacks(
            liveliness=node.at_work(self.on_life), incompatible_qos=lambda _event: None
        )
        promised = qos(lease=max(LIFE, SHARE * settings.given_command_timeout))
        node.create_subscription(
            TwistStamped, 'cmd_vel', lambda _message: None, promised, event_callbacks=events
        )

    @property
    def now(self) -> int:
        """Return the ROS time [ns], including jumps by faults."""
        now: int = self.node.get_clock().now().nanoseconds
        return now + round(self.jump * SECOND)

    def on_order(self, order: Order) -> None:
        """Put a command in force."""
        if not self.view.command_lost(self.flight.ticks):
            self.order, self._stopped = order, np.inf
            self._expires = self.node.steady_now() + self.settings.command_timeout

    def on_life(self, event: Any) -> None:
        """Stop when the planner loses liveliness; resume when it regains it."""
        if event.alive_count == 0 and event.alive_count_change < 0:
            self._stop('the planner gives no sign of life')
            return
        # The lost planner is back; a new one would not reduce the number of lost ones.
        back = event.alive_count_change > 0 > event.not_alive_count_change
        if back and self._stopped < np.inf and self.node.steady_now() < self._expires:
            self._stopped = np.inf
            self.node.get_logger().info('the planner lives: its command is in force again')

    def look(self) -> None:
        """Stop when the command in force has expired."""
        if self._stopped == np.inf and self.node.steady_now() >= self._expires:
            self._stop(f'no command for {self.settings.command_timeout:g} s')

    def _stop(self, reason: str) -> None:
        """Stop the vehicle and report why, even if it has already stopped for another reason."""
        if self._expires == -np.inf or self.finished:  # no command so far
            return
        self._stopped = min(self._stopped, self._expires, self.node.steady_now())
        share, turn = self.settings.failsafe_fraction, self.settings.failsafe_rate
        kept = f'failsafe at {share:g} of full speed or thrust, {turn:g} rad/s'
        self.warn(f'{reason}: {kept if share or turn else "stopped"}')

    def course(self) -> Course:
        """Fly a step each time that it is resumed, once there has been a command."""
        self._expires = -np.inf  # when the last command expires, on the steady clock [s]
        self._stopped = np.inf  # since when the vehicle is stopped; infinite while it is not [s]
        for _ in self.waiting(planner=False):
            yield
        while not self.finished:
            begun = self.node.steady_now()
            self.show(self.view.of(self.flight))
            if self.flight.over:
                self.finish()
            yield
            if self._expires > -np.inf:
                self.fly(min(self._expires, self._stopped) - begun)
        yield


class SimNode(Managed):
    """A node that simulates the flight described by its parameters."""

    kind, specs, settings_of = 'sim', SIM, staticmethod(sim_settings)
    # It publishes /clock: under simulated time it would wait for itself.
    forced = (Parameter('use_sim_time', value=False),)
    settings: SimSettings

    def configure(self) -> None:
        """Set up the flight described by the parameters."""
        self._flown = False  # whether it has been active
        pace = RealTime if self.settings.clock == 'wall' else LockStep
        self._flight = pace(self, self.settings)
        self.create_service(Trigger, '~/reset', self.guard(self._on_reset))

    def activate(self) -> None:
        """Start the flight, from its beginning."""
        if self._flown:
            self._flight.restart()
        else:
            self._flight.start()
        self._flown = True

    def _on_reset(self, _request: Any, response: Any) -> Any:
        if self.active:
            self._flight.restart()
        response.success, response.message = True, 'back at the start'
        return response


main = partial(run, SimNode)
