# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The simulator node: a scenario flown on the commands it receives, in lock-step or real time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped, WrenchStamped
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.lifecycle import Managed
from orbimpc_ros.ros.parameters.dynamic import DynamicParameters
from orbimpc_ros.ros.parameters.sections import warn_of_unused
from orbimpc_ros.ros.process import qos, run
from orbimpc_ros.sim.pacing import LockStep, RealTime
from orbimpc_ros.sim.parameters import SIM, sim_settings
from orbimpc_ros.sim.simulation import DEPTH, FlightSimulation

REFUSALS_SHOWN = 1.0  # [s] between diagnostics of refused commands


class SimNode(Managed):
    """A simulated flight with its parameters, commands and services, at one of two paces."""

    def __init__(self) -> None:
        # It makes the time: under simulated time it would wait for itself.
        super().__init__('sim', [Parameter('use_sim_time', value=False)])
        self._live = DynamicParameters(self, SIM, sim_settings)
        warn_of_unused(self)

    def configure(self) -> None:
        """Set up the flight that the parameters describe."""
        settings = self._live.settings()
        self._flown = False  # whether it has been active
        self._refused_at = -np.inf  # when a refusal was last shown, on the steady clock [s]
        self._simulation = FlightSimulation(self, settings, self._create_subscriptions())
        self._pace = LockStep(self._simulation) if settings.lockstep else RealTime(self._simulation)
        self.create_service(Trigger, '~/reset', self.guard(self._on_reset))
        if isinstance(self._pace, RealTime):
            self._watch_life(self._pace.on_life, settings.lease)

    def activate(self) -> None:
        """Fly, from the start."""
        if self._flown:
            self._simulation.restart()
        self._pace.restart()
        self._flown = True

    def _create_subscriptions(self) -> Subscription:
        """Subscribe to commands; return the subscription to those that every planner sends."""
        velocity, _ = (
            self.create_subscription(kind, topic, self.at_work(callback), qos(DEPTH))
            for kind, topic, callback in (
                (TwistStamped, 'cmd_vel', self._on_twist),
                (WrenchStamped, 'cmd_thrust', self._on_force),
            )
        )
        return velocity

    def _on_twist(self, message: TwistStamped) -> None:
        self._take('cmd_vel', self._simulation.orders.take_twist, message)

    def _on_force(self, message: WrenchStamped) -> None:
        self._take('cmd_thrust', self._simulation.orders.take_force, message)

    def _take(self, topic: str, take: Callable[[Any, int], bool], message: Any) -> None:
        try:
            complete = take(message, self._pace.now)
        except BadInput as error:
            self._refuse(topic, error)
            return
        if complete:
            self._pace.on_order()

    def _refuse(self, topic: str, error: BadInput) -> None:
        self._simulation.refused[f'refused {topic}: {error.culprit}'] += 1
        if self.steady_now() - self._refused_at > REFUSALS_SHOWN:
            self._refused_at = self.steady_now()
            self._simulation.warn(self._pace.now, f'{topic} refused: {error}')

    def _watch_life(self, heard: Callable[[Any], None], lease: float) -> None:
        """Call back when DDS hears, or misses, signs of life of the publisher of cmd_vel."""
        # A planner that promises none does not match, which is no fault.
        events = SubscriptionEventCallbacks(
            liveliness=self.at_work(heard), incompatible_qos=lambda _event: None
        )
        promised = qos(lease=lease)
        self.create_subscription(
            TwistStamped, 'cmd_vel', lambda _message: None, promised, event_callbacks=events
        )

    def _on_reset(self, _request: Any, response: Any) -> Any:
        if self.active:
            self._simulation.restart()
            self._pace.restart()
        response.success, response.message = True, 'back at the start'
        return response


def main(argv: Sequence[str] | None = None) -> int:
    """Run the simulator; return the exit code."""
    return run(SimNode, argv)
