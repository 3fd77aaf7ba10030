"""A process that publishes odometry as fast as it is told to, until it is killed."""

from __future__ import annotations

import os
import sys
import time

import rclpy
from nav_msgs.msg import Odometry

from orbimpc_ros.ros import messages
from orbimpc_ros.ros.process import qos
from orbimpc_ros.tool.tethered import tether
from orbimpc_ros.tool.trials import feed

AT_ONCE = 0.1  # [s] to catch up with, at most


def main() -> None:
    """Publish at the rate [Hz] that the command line gives."""
    tether(os.getppid())
    rate = float(sys.argv[1])
    rclpy.init(args=[])
    node = rclpy.create_node('flood', enable_rosout=False, start_parameter_services=False)
    publisher = node.create_publisher(Odometry, 'odom', qos())
    message = feed.odometry_at(0.0, 0)
    begun = due = time.monotonic()
    while True:
        now = time.monotonic()
        due = max(due + 1.0 / rate, now - AT_ONCE)
        if now - begun > 0.01:  # another pose a hundred times a second
            message, begun = feed.odometry_at(now, 0), now
        message.header.stamp = messages.time_message(time.time_ns())
        publisher.publish(message)
        time.sleep(max(0.0, due - time.monotonic()))


if __name__ == '__main__':
    main()
