# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The retrieval in real time, planner and simulator as processes, and a monitor on both."""

from __future__ import annotations

import math
import random

from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy
from std_msgs.msg import Bool

from benchmarks.faults.harness import PATIENCE, Place, Session
from benchmarks.faults.monitor import STILL, Limits
from orbimpc_ros.ros.process import qos
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.settings import config

LATCH = 0.2  # [s] command_timeout
FLIGHT = 16  # steps until the usual capture
START = [-10.0, 0.0, 0.0]  # [m]: far enough off for something to happen on the way


class Flying(Session):
    """A flight over DDS, faster than the paper's by a factor, until closed.

    Args:
        place: of the nodes.
        step: between ticks [s]; speed, swing and cost of turning are scaled with it.
        seed: of random moments.

    Attributes:
        planner: its process.
        captured: how the flight ended; None while it lasts.
    """

    def __init__(self, place: Place, *, step: float, seed: int) -> None:
        super().__init__(place, Limits(1.0 / step, math.pi / step))
        self.draw = random.Random(seed)
        self.usual = FLIGHT * step
        self.captured: bool | None = None
        changes = [
            'clock=wall', f'step={step}', f'forward={1.0 / step}', f'rope.frequency={0.1 / step}',
            'max_ticks=400', 'odom_timeout=0.0', 'goal_timeout=0.0', 'goal_prediction=harmonic',
            f'start.position={START}', f'weights.input={0.05 * step**2}',
        ]  # fmt: skip
        self._values = settings.resolve(config('retrieval.yaml'), changes) | {'use_sim_time': False}
        self._poses: list[tuple[float, float, float]] = []
        self.subscribe(Odometry, 'odom', self._on_odometry)
        kept = qos(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.subscribe(Bool, 'captured', self._on_captured, kept)
        self.launch('orbimpc_ros.sim', self._values)
        self.start_planner()

    def start_planner(self) -> None:
        """Start a planner."""
        self.planner = self.launch('orbimpc_ros.ros.planner', self._values)

    def _on_odometry(self, message: Odometry) -> None:
        place = message.pose.pose.position
        self._poses.append((place.x, place.y, message.twist.twist.linear.x))

    def _on_captured(self, message: Bool) -> None:
        self.captured = message.data

    def spin_steps(self, count: int) -> None:
        """Listen until the simulator has shown so many steps more."""
        enough = len(self._poses) + count
        self.spin(PATIENCE, lambda: len(self._poses) >= enough)

    def until_moving(self) -> None:
        """Listen until the vehicle flies.

        Raises:
            OrbimpcError: it does not.
        """
        self.until(lambda: self._moves, 'a vehicle that flies')

    def until_over(self) -> None:
        """Listen until the flight has ended, for many times as long as it usually lasts."""
        self.spin(10 * self.usual, lambda: self.captured is not None)

    @property
    def _moves(self) -> bool:
        return len(self._poses) > 1 and self._poses[0][:2] != self._poses[-1][:2]

    @property
    def still(self) -> bool:
        """Return whether the vehicle stands."""
        before, now = self._poses[-2:]
        return before[:2] == now[:2] and abs(now[2]) <= STILL
