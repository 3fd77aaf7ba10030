# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A node's ROS clock, the system's or a simulated one: its time, jumps and standstills."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from rclpy.clock import JumpThreshold, TimeJump
from rclpy.duration import Duration

from orbimpc_ros.ros.lifecycle import Managed
from orbimpc_ros.ros.messages import SECOND


@dataclass(frozen=True)
class RosTime:
    """What the node's ROS clock shows.

    Attributes:
        nanoseconds: the time [ns]; None if it is not known, as before simulated time starts.
        lag: how far it may trail: simulated time moves only when a message says so [s].
    """

    nanoseconds: int | None = None
    lag: float = 0.0


UNKNOWN = RosTime()
HELD_UP = 0.05  # [s] between two looks at clocks, which then tell nothing of one another


class NodeClock:
    """Reads a node's clock.

    Args:
        node: whose clock.
        step: by which simulated time may move at once [s].
        on_jump: called with how far time has jumped [s]: simulated time back or on by more than a
            step, the system's by any amount that a look can detect.

    Attributes:
        simulated: whether time comes from ``/clock``; that cannot change while the node runs.
    """

    def __init__(self, node: Managed, step: float, on_jump: Callable[[float], None]) -> None:
        self._clock, self._step, self._on_jump = node.get_clock(), step, on_jump
        self.simulated = bool(node.get_parameter('use_sim_time').value)
        self._offset: float | None = None  # from the steady clock to this one [s]
        self._stood: tuple[int, float] | None = None  # what was shown, and since when [ns], [s]
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
    def now(self) -> RosTime:
        """Return the time, and how exact it is; simulated time is zero until it starts."""
        shown = self._clock.now().nanoseconds
        return RosTime(shown or None, self._step) if self.simulated else RosTime(shown)

    def standstill(self, patience: float) -> str:
        """Return that simulated time has stood still for longer than ``patience`` [s], in words."""
        if not self.simulated:
            return ''
        shown, now = self.nanoseconds, time.monotonic()
        if self._stood is None or self._stood[0] != shown:
            self._stood = shown, now
        stood = now - self._stood[1]
        if stood <= patience:
            return ''
        if shown:
            return f'the clock has stood still for {stood:.2f} s'
        return (
            f'use_sim_time is true, and nothing has come on /clock for {stood:.2f} s: start what '
            'publishes it (a simulator, ros2 bag play --clock), or set use_sim_time to false'
        )

    def look(self) -> None:
        """Look whether the system's clock was set, which nothing else would show."""
        before, shown, after = time.monotonic(), self.nanoseconds, time.monotonic()
        if self.simulated or after - before > HELD_UP:
            return
        offset, last = shown / SECOND - after, self._offset
        self._offset = offset
        if last is not None and abs(offset - last) > HELD_UP:
            self._on_jump(offset - last)

    def _on_simulated_jump(self, jump: TimeJump) -> None:
        if self.nanoseconds != jump.delta.nanoseconds:  # else it starts
            self._on_jump(jump.delta.nanoseconds / SECOND)
