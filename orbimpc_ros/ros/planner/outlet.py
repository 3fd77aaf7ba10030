"""The planner's one way out: its publishers, and what went out last."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped, TwistStamped, WrenchStamped
from nav_msgs.msg import Path
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.publisher import Publisher
from visualization_msgs.msg import MarkerArray

from orbimpc_ros.ros.process import LIFE, Guarded, qos

KINDS: dict[str, type] = {
    'cmd_vel': TwistStamped,
    'rotation': QuaternionStamped,
    'plan': Path,
    'plan_markers': MarkerArray,
    'tick': DiagnosticArray,
}
# Who is connected is watched instead: every event handler makes every wait of the node longer.
NO_EVENTS = PublisherEventCallbacks(use_default_callbacks=False)


class Outlet:
    """Publishes answers, and repeats the last one to who asks again.

    Args:
        node: that publishes.
        thrust: whether the vehicle is commanded a thrust, too.

    Attributes:
        velocity: the publisher of ``cmd_vel``.
        at: when something went out last, on the steady clock [s]; -inf before.
    """

    def __init__(self, node: Guarded, thrust: bool) -> None:
        kinds = KINDS | ({'cmd_thrust': WrenchStamped} if thrust else {})
        self._node = node
        self._publishers: dict[str, Publisher] = {
            topic: node.create_publisher(kind, topic, qos(lease=LIFE), event_callbacks=NO_EVENTS)
            for topic, kind in kinds.items()
        }
        self.velocity = self._publishers['cmd_vel']
        self.at = -math.inf
        self._answer: Mapping[str, Any] = {}

    @property
    def used(self) -> bool:
        """Return whether anything went out yet."""
        return self.at > -math.inf

    def begin(self, orders: Mapping[str, Any]) -> None:
        """Publish what the vehicle is told, by topic: it comes first."""
        self._answer = orders
        self._send(orders)

    def add(self, told: Mapping[str, Any]) -> None:
        """Publish what everybody else is told, by topic."""
        self._answer = {**self._answer, **told}
        self._send(told)

    def repeat(self) -> None:
        """Publish the last answer again."""
        self._send(self._answer)

    def _send(self, told: Mapping[str, Any]) -> None:
        for topic, message in told.items():
            self._publishers[topic].publish(message)
        self.at = self._node.steady_now()
