# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Numbers of the last decision on topics of their own, which plots and scripts can read."""

from __future__ import annotations

from collections.abc import Mapping

from rclpy.node import Node
from std_msgs.msg import Float64

from orbimpc_ros.ros.process import qos

# On ~/distance [m], ~/solve_time [s] and so on; each is a key of what is published.
NUMBERS = ('distance', 'gap', 'lower_bound', 'objective', 'solve_time')


class NumberPublishers:
    """Publishers of a planner's numbers; each is used while somebody subscribes."""

    def __init__(self, node: Node) -> None:
        self._publishers = {
            name: node.create_publisher(Float64, f'~/{name}', qos()) for name in NUMBERS
        }

    def publish(self, numbers: Mapping[str, float]) -> None:
        """Publish numbers by name."""
        for name, number in numbers.items():
            publisher = self._publishers[name]
            if publisher.get_subscription_count():
                publisher.publish(Float64(data=float(number)))
