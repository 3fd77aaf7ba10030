# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks.bench.echo``: answers each odometry message at once.

The command has the same type and stamp but needs no planning: its latency is that of rclpy and
DDS. Goals are received as well, since they come just before odometry.
"""

from __future__ import annotations

import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.utilities import get_default_context

from orbimpc_ros.ros.process import LATEST, executor_named, qos
from orbimpc_ros.tool.processes import interruptions


def main() -> None:
    """Echo until a signal arrives."""
    with interruptions() as received, get_default_context():
        node = rclpy.create_node('echo', automatically_declare_parameters_from_overrides=True)
        commands = node.create_publisher(TwistStamped, 'cmd_vel', qos())

        def answer(message: Odometry) -> None:
            commands.publish(TwistStamped(header=message.header))

        node.create_subscription(Odometry, 'odom', answer, LATEST)
        node.create_subscription(PoseStamped, 'goal', lambda _message: None, LATEST)
        executor = executor_named(node.get_parameter('executor').value)
        executor.add_node(node)
        while not received:
            executor.spin_once(timeout_sec=0.05)


if __name__ == '__main__':
    main()
