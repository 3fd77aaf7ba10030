# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The simulator's node: its parameters, a flight at one of two paces, and a service to reset it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from orbimpc_ros.ros.lifecycle import Managed
from orbimpc_ros.ros.parameters.dynamic import DynamicParameters
from orbimpc_ros.ros.parameters.sections import warn_of_unused
from orbimpc_ros.ros.process import run
from orbimpc_ros.sim.pacing import LockStep, RealTime
from orbimpc_ros.sim.parameters import SIM, sim_settings


class SimNode(Managed):
    """A node that simulates the flight which its parameters describe."""

    def __init__(self) -> None:
        # It makes the time: under simulated time it would wait for itself.
        super().__init__('sim', [Parameter('use_sim_time', value=False)])
        self._live = DynamicParameters(self, SIM, sim_settings)
        warn_of_unused(self)

    def configure(self) -> None:
        """Set up the flight that the parameters describe."""
        settings = self._live.settings()
        self._flown = False  # whether it has been active
        self._flight = (RealTime if settings.clock == 'wall' else LockStep)(self, settings)
        self.create_service(Trigger, '~/reset', self.guard(self._on_reset))

    def activate(self) -> None:
        """Fly, from the start."""
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


def main(argv: Sequence[str] | None = None) -> int:
    """Run the simulator; return the exit code."""
    return run(SimNode, argv)
