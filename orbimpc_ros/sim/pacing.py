# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The paces of a simulated flight: a step as soon as it is commanded, or when its time is over."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from rosgraph_msgs.msg import Clock

from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.process import FAILED, qos
from orbimpc_ros.sim.commands import Order
from orbimpc_ros.sim.faults import Delivery
from orbimpc_ros.sim.simulation import DEPTH, FlightSimulation

LOOK = 0.02  # [s] between looks at who is there
SETTLED = 0.1  # [s] lock-step: a planner that is asked nothing still has to take in the goal
RESEND = 0.5  # [s] lock-step: ask again without an answer; first messages may be lost
PATIENCE = 20.0  # [s] lock-step: give up without an answer
SHORTEST_TIMEOUT = 1.5  # steps: the shortest timeouts of a planner
NO_ANSWER = (
    'an answer to the odometry on cmd_vel, which takes a planner with trigger: odom '
    '(a timer waits for time to go on, and time for the answer); its /diagnostics may say more'
)


class LockStep:
    """Flies a step as soon as the command for the newest odometry's own stamp is there.

    The last odometry is answered too, so that every run has the same messages. Where faults leave
    nothing to answer, or lose the answer, the step is flown on the last command while that is in
    force. With faults odometry follows clock and goals at a distance: stamps no longer show what
    belongs together, and DDS keeps no order among topics. At a ``rate``, or with a shared clock,
    the next step is not shown before its time.
    """

    def __init__(self, simulation: FlightSimulation) -> None:
        self._simulation, self._node = simulation, simulation.node
        self._settings, self._waiting = simulation.settings, simulation.waiting
        self._paced = self._settings.rate > 0.0
        self._shared = math.inf  # what the shared clock shows, if there is one [ns]
        if self._settings.shared_clock:
            self._shared = -math.inf
            self._node.create_subscription(
                Clock, '/clock', self._node.at_work(self._on_clock), qos(DEPTH)
            )
        self.restart()
        self._node.every(LOOK, self.look)
        if self._paced:
            took = self._settings.scenario.model.step / self._settings.rate
            self._node.every(took, self._on_due)
            if self._settings.rate <= 1.0 / SHORTEST_TIMEOUT:
                wanted = f"set the planner's odom_timeout and goal_timeout to more than {took:g} s"
                self._node.get_logger().warning(f'a step takes {took:g} s at this rate: {wanted}')

    def restart(self) -> None:
        """Start again as soon as planner and readers are there."""
        self._begun = False
        self._asking = False  # whether a step waits for a command
        self._awaited: int | None = None  # stamp of the odometry to be answered [ns]
        self._newest = -np.inf  # true time of the last odometry sent [s]
        self._goal_sent = False
        self._order: Order | None = None
        self._heard = -np.inf  # when the last command came, in simulated time [s]
        self._sent: list[Delivery] = []
        self._held_back: list[Delivery] = []  # odometry that follows
        self._progress = self._asked_at = self._node.steady_now()
        self._waiting.restart()

    @property
    def now(self) -> int:
        """Return the simulated time [ns], which jumps where faults make it."""
        return round((self._simulation.flight.vehicle.time + self._simulation.jump) * SECOND)

    def look(self) -> None:
        """Start once planner and readers are there; send again, or give up, without an answer."""
        if self._simulation.finished:
            return
        if not self._begun:
            self._begin_or_wait()
        elif self._held_back:
            self._follow_up()
        elif self._asking:
            self._keep_asking()

    def _begin_or_wait(self) -> None:
        absent = self._waiting.for_all()
        if not absent:
            self._begun = True
            self._ask_when_due()
        elif self._waiting.lasted > self._settings.wait_timeout:
            self._give_up(absent, self._waiting.lasted)

    def _keep_asking(self) -> None:
        now, patience = self._node.steady_now(), self._settings.wait_timeout
        if not self._settings.shared_clock:  # where vehicles wait for each other, too
            patience = min(PATIENCE, patience)
        if self._awaited is None:
            if now - self._asked_at > SETTLED:
                self._fly_on()
        elif now - self._progress > patience:
            self._give_up(self._waiting.planner_lacking or NO_ANSWER, now - self._progress)
        elif now - self._asked_at > RESEND:
            self._send()

    def _give_up(self, awaited: str, waited: float) -> None:
        self._node.get_logger().fatal(f'waited {waited:.0f} s in vain for {awaited}: giving up')
        self._node.exit_code = FAILED

    def _on_due(self) -> None:
        if self._begun and not self._asking and not self._simulation.finished:
            self._ask()

    def _ask(self) -> None:
        self._asking = True
        self._progress = self._node.steady_now()
        self._sent = self._simulation.view.of(self._simulation.flight)
        self._awaited = self._to_be_answered()
        self._send()

    def _to_be_answered(self) -> int | None:
        """Return the stamp of the odometry that a planner answers, which may not be there."""
        fresh = None
        for sent in self._sent:
            self._goal_sent |= sent.finite and not sent.is_odometry
            if sent.is_odometry and sent.finite and sent.content.time > self._newest:
                self._newest = sent.content.time
                fresh = self._simulation.stamp_of(sent, self.now)
        return fresh if self._goal_sent else None

    def _send(self) -> None:
        self._asked_at = self._node.steady_now()
        apart = self._settings.faults.any
        self._held_back = [sent for sent in self._sent if apart and sent.is_odometry]
        self._simulation.show(self.now, [s for s in self._sent if not (apart and s.is_odometry)])

    def _follow_up(self) -> None:
        if self._node.steady_now() - self._asked_at >= 0.5 * LOOK:
            self._simulation.deliver(self.now, self._held_back)
            self._held_back = []

    def on_order(self) -> None:
        """Fly a step if this is the answer awaited."""
        order, flight = self._simulation.orders.latest, self._simulation.flight
        if self._simulation.finished or order is None or order.stamp != self._awaited:
            return
        if not self._simulation.view.command_lost(flight.ticks):
            self._order, self._heard = order, flight.vehicle.time
        self._fly_on()

    def _fly_on(self) -> None:
        if self._simulation.flight.over:
            self._simulation.finish(self.now)
            return
        held = self._heard + self._settings.command_timeout - self._simulation.flight.vehicle.time
        self._simulation.fly(self._order, held)
        self._asking, self._awaited = False, None
        if not self._paced:
            self._ask_when_due()

    def _on_clock(self, message: Clock) -> None:
        self._shared = message.clock.sec * SECOND + message.clock.nanosec
        self._ask_when_due()

    def _ask_when_due(self) -> None:
        """Ask, unless a step is under way or the shared clock has not come to the next one."""
        half = 0.5 * self._settings.scenario.model.step * SECOND  # rounding is less
        due = self.now <= self._shared + half
        if due and self._begun and not self._asking and not self._simulation.finished:
            self._ask()


class RealTime:
    """Flies a step when its time is over, on the command in force; waits for the first command.

    The vehicle is stopped when no command has come for ``command_timeout``, or as soon as DDS
    misses signs of life from the last planner that promised some, long before a command is due. On
    a busy machine living planners miss some, too: the command is in force again with the next one.
    """

    def __init__(self, simulation: FlightSimulation) -> None:
        self._simulation, self._node = simulation, simulation.node
        self._settings, self._waiting = simulation.settings, simulation.waiting
        self.restart()
        self._node.every(LOOK, self.look)
        self._node.every(self._settings.scenario.model.step, self.on_time)

    def restart(self) -> None:
        """Wait for subscribers, then for a first command."""
        self._begins = False
        self._order: Order | None = None
        self._until = -np.inf  # when the command in force ends, on the steady clock [s]
        self._ends = -np.inf  # when it would have ended, had the planner not been missed [s]
        self._begun = self._node.steady_now()  # this step
        self._latched = False
        self._waiting.restart()

    @property
    def now(self) -> int:
        """Return the time of ROS [ns], which jumps where faults make it."""
        now: int = self._node.get_clock().now().nanoseconds
        return now + round(self._simulation.jump * SECOND)

    def on_order(self) -> None:
        """Put a command in force."""
        if self._simulation.view.command_lost(self._simulation.flight.ticks):
            return
        self._order, self._latched = self._simulation.orders.latest, False
        self._until = self._node.steady_now() + self._settings.command_timeout

    def on_life(self, event: Any) -> None:
        """Stop, or go on, as signs of life from the planner cease or come again."""
        if event.alive_count == 0 and event.alive_count_change < 0:
            self._stop('the planner gives no sign of life')
        elif event.alive_count_change > 0 > event.not_alive_count_change:
            self._resume()  # the one that was missed; a new one would not lessen the missed ones

    def _resume(self) -> None:
        if self._latched and self._node.steady_now() < self._ends:
            self._latched, self._until = False, self._ends
            self._node.get_logger().info('the planner lives: its command is in force again')

    def look(self) -> None:
        """Stop when the command in force has ended."""
        if not self._latched and self._node.steady_now() >= self._until:
            self._stop(f'no command for {self._settings.command_timeout:g} s')

    def _stop(self, reason: str) -> None:
        """Stop the vehicle, and report why, even where it has been stopped for another reason."""
        if self._order is None or self._simulation.finished:
            return
        self._ends = self._until
        self._latched, self._until = True, min(self._until, self._node.steady_now())
        model = self._settings.scenario.model
        share, turn = model.failsafe_fraction, model.failsafe_rate
        kept = f'failsafe at {share:g} of full speed or thrust, {turn:g} rad/s'
        self._simulation.warn(self.now, f'{reason}: {kept if share or turn else "stopped"}')

    def on_time(self) -> None:
        """Fly a step, unless nobody has commanded yet, and show where it led."""
        self._begins = self._begins or not self._waiting.for_readers()
        if self._simulation.finished or not self._begins:
            return
        if self._order is not None:
            self._simulation.fly(self._order, self._until - self._begun)
        if self._simulation.finished:
            return
        self._begun = self._node.steady_now()
        self._simulation.show(self.now, self._simulation.view.of(self._simulation.flight))
        if self._simulation.flight.over:
            self._simulation.finish(self.now)
