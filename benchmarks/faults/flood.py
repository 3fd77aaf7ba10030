# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.faults.flood RATE``: publishes odometry at a rate [Hz] until killed."""

from __future__ import annotations

import sys
import time

from harness import Observer
from nav_msgs.msg import Odometry

from benchmarks.faults import stimulus
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.process import qos

AT_ONCE = 0.1  # [s] to catch up with, at most


def main() -> None:
    """Publish odometry, its pose moved on a hundred times a second."""
    period = 1.0 / float(sys.argv[1])
    source = Observer()
    publisher = source.node.create_publisher(Odometry, 'odom', qos())
    message = stimulus.odometry_at(0.0, 0)
    posed = due = time.monotonic()
    while True:
        now = time.monotonic()
        due = max(due + period, now - AT_ONCE)
        if now - posed > 0.01:
            message, posed = stimulus.odometry_at(now, 0), now
        message.header.stamp = messages.time_message(time.time_ns())
        publisher.publish(message)
        time.sleep(max(0.0, due - time.monotonic()))


if __name__ == '__main__':
    main()
