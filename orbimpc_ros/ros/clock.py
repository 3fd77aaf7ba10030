"""The node's clock of ROS, the system's or a simulated one: its time, jumps and standstills."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import JumpThreshold, TimeJump
from rclpy.duration import Duration

from orbimpc_ros.ros.arrival import RosTime
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.process import Guarded
from orbimpc_ros.ros.timing import Drift, Standstill


class NodeClock:
    """Reads a node's clock.

    Args:
        node: whose clock.
        step: by which simulated time may move at once [s].
        on_jump: told by how much time has jumped [s]: simulated time back or on by more than a
            step, the system's by any amount that a look can tell.

    Attributes:
        simulated: whether time comes from ``/clock``; that cannot change while the node runs.
    """

    def __init__(self, node: Guarded, step: float, on_jump: Callable[[float], None]) -> None:
        self._clock, self._step, self._on_jump = node.get_clock(), step, on_jump
        self.simulated = bool(node.get_parameter('use_sim_time').value)
        self._drift, self._standstill = Drift(), Standstill()
        threshold = JumpThreshold(
            min_forward=Duration(seconds=step),
            min_backward=Duration(nanoseconds=-1),
            on_clock_change=False,
        )
        self._jumps = self._clock.create_jump_callback(
            threshold, post_callback=node.guard(self._on_simulated_jump)
        )

    @property
    def nanoseconds(self) -> int:
        """Return what the clock shows [ns]."""
        return self._clock.now().nanoseconds

    @property
    def seconds(self) -> float:
        """Return what the clock shows [s]."""
        return self.nanoseconds / SECOND

    @property
    def now(self) -> RosTime:
        """Return the time, and how exact it is; simulated time is zero until it starts."""
        shown = self.nanoseconds
        return RosTime(shown or None, self._step) if self.simulated else RosTime(shown)

    def standstill(self, patience: float) -> str:
        """Return that simulated time has stood still for longer than ``patience`` [s], in words."""
        if not self.simulated:
            return ''
        stood = self._standstill.lasted(self.nanoseconds, time.monotonic())
        if stood <= patience:
            return ''
        if self.nanoseconds:
            return f'the clock has stood still for {stood:.2f} s'
        return (
            f'use_sim_time is true, and nothing has come on /clock for {stood:.2f} s: start what '
            'publishes it (a simulator, ros2 bag play --clock), or set use_sim_time to false'
        )

    def look(self) -> None:
        """Look whether the system's clock was set, which nothing else would tell."""
        if self.simulated:
            return
        before = time.monotonic()
        jump = self._drift.jump(before, self.seconds, time.monotonic())
        if jump:
            self._on_jump(jump)

    def _on_simulated_jump(self, jump: TimeJump) -> None:
        if self.nanoseconds != jump.delta.nanoseconds:  # else it starts
            self._on_jump(jump.delta.nanoseconds / SECOND)
