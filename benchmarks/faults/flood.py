# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A process that publishes odometry at a given rate, until it is killed.

It prints its own pauses: a planner that stops since none came is right to.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from harness import Observer
from nav_msgs.msg import Odometry

from benchmarks.faults import stimulus
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.process import qos
from orbimpc_ros.tool.run.tethered import tether

AT_ONCE = 0.1  # [s] to catch up with, at most
HELD_UP = 0.15  # [s] without a message worth telling


class Pause(NamedTuple):
    """A time without odometry, from and to [s], on the monotonic clock."""

    begin: float
    end: float


def pauses(log: Path) -> list[Pause]:
    """Return the pauses that have been printed."""
    return [Pause(*map(float, line.split())) for line in log.read_text().splitlines()]


def excused(at: float, paused: Iterable[Pause], after: float) -> bool:
    """Return whether a stop at a time [s] is right: in a pause, or for ``after`` [s] behind it."""
    return any(begin <= at <= end + after for begin, end in paused)


def main() -> None:
    """Publish at the rate [Hz] that the command line gives."""
    tether(os.getppid())
    rate = float(sys.argv[1])
    source = Observer()
    publisher = source.node.create_publisher(Odometry, 'odom', qos())
    message = stimulus.odometry_at(0.0, 0)
    begun = due = last = time.monotonic()
    while True:
        now = time.monotonic()
        if now - last > HELD_UP:
            print(last, now, flush=True)
        last = now
        due = max(due + 1.0 / rate, now - AT_ONCE)
        if now - begun > 0.01:  # another pose a hundred times a second
            message, begun = stimulus.odometry_at(now, 0), now
        message.header.stamp = messages.time_message(time.time_ns())
        publisher.publish(message)
        time.sleep(max(0.0, due - time.monotonic()))


if __name__ == '__main__':
    main()
