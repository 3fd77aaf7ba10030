"""The retrieval in real time, planner and simulator as processes, and a watch on both."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy
from std_msgs.msg import Bool

from orbimpc_ros.lab.faults.monitor import STILL, Limits, Watch
from orbimpc_ros.lab.faults.test_node import Ears
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.ros.process import qos
from orbimpc_ros.tool.io import settings
from orbimpc_ros.tool.io.share import config
from orbimpc_ros.tool.run.processes import Process

PATIENCE = 60.0  # [s] until it flies, on a busy machine too
LATCH = 0.2  # [s] command_timeout
FLIGHT = 16  # steps until the usual capture
START = [-10.0, 0.0, 0.0]  # [m]: far enough off for something to happen on the way


class Flying:
    """A flight over DDS, faster than the paper's by a factor, until closed.

    Args:
        folder: takes parameters and logs.
        domain: of ROS, nobody else's.
        step: between ticks [s]; speed, swing and cost of turning are scaled with it.
        seed: of random moments.

    Attributes:
        planner: its process.
        captured: how the flight ended; None while it lasts.
    """

    def __init__(self, folder: Path, domain: int, *, step: float, seed: int) -> None:
        self._folder, self._domain, self._count = folder, domain, 0
        self.draw = random.Random(seed)
        self.usual = FLIGHT * step
        self.patience = 10 * self.usual
        self.captured: bool | None = None
        changes = [
            'clock=wall', f'step={step}', f'forward={1.0 / step}', f'rope.frequency={0.1 / step}',
            'max_ticks=400', 'odom_timeout=0.0', 'goal_timeout=0.0', 'goal_prediction=harmonic',
            f'start.position={START}', f'weights.input={0.05 * step**2}',
        ]  # fmt: skip
        self._values = settings.resolve(config('retrieval.yaml'), changes)
        self.watch = Watch(Limits(1.0 / step, math.pi / step))
        self._poses: list[tuple[float, float, float]] = []
        self._ears = Ears(domain)
        listen = self._ears.listen
        listen(TwistStamped, 'cmd_vel', self.watch.on_command)
        listen(DiagnosticArray, '/diagnostics', self.watch.on_health)
        listen(Odometry, 'odom', self._on_odometry)
        kept = qos(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        listen(Bool, 'captured', self._on_captured, kept)
        self.sim = self._start('sim')
        self.start_planner()

    def _start(self, name: str) -> Process:
        self._count += 1
        file = self._folder / f'{name}-{self._count}.yaml'
        settings.write(file, self._values, use_sim_time=False)
        return Process(f'orbimpc_ros.ros.{name}', file, file.with_suffix('.log'), self._domain)

    def start_planner(self) -> None:
        """Start a planner."""
        self.planner = self._start('planner')

    def _on_odometry(self, message: Odometry) -> None:
        place = message.pose.pose.position
        self._poses.append((place.x, place.y, message.twist.twist.linear.x))

    def _on_captured(self, message: Bool) -> None:
        self.captured = message.data

    def spin(self, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        """Listen for a while, or until ``done``."""
        self._ears.hear_until(time.monotonic() + seconds, done)

    def spin_steps(self, count: int) -> None:
        """Listen until the simulator has shown so many steps more."""
        enough = len(self._poses) + count
        self.spin(PATIENCE, lambda: len(self._poses) >= enough)

    def until_moving(self) -> None:
        """Listen until the vehicle flies.

        Raises:
            OrbimpcError: it does not.
        """
        self.spin(PATIENCE, lambda: self._moves)
        if not self._moves:
            raise OrbimpcError(f'waited {PATIENCE:g} s in vain for a vehicle that flies')

    def until_over(self) -> None:
        """Listen until the flight has ended, for many times as long as it usually lasts."""
        self.spin(self.patience, lambda: self.captured is not None)

    @property
    def _moves(self) -> bool:
        return len(self._poses) > 1 and self._poses[0][:2] != self._poses[-1][:2]

    @property
    def still(self) -> bool:
        """Return whether the vehicle stands."""
        before, now = self._poses[-2:]
        return before[:2] == now[:2] and abs(now[2]) <= STILL

    def latched(self, since: float) -> float:
        """Return when the simulator told that it has stopped the vehicle [s]."""
        return self.watch.first_complaint(since, 'stopped')

    def __enter__(self) -> Flying:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for process in (self.planner, self.sim):
            process.stop()
        self._ears.close()
