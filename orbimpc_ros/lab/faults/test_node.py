"""A node of the tool's own, in a domain that it is told, spun for as long as something lasts."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from orbimpc_ros.ros.process import qos

KEPT = 1000  # messages: none may be missed


class Ears:
    """Hears what is said in a domain, and can speak there.

    Args:
        domain: of ROS.

    Attributes:
        node: for publishers and clients.
    """

    def __init__(self, domain: int) -> None:
        self._context = rclpy.Context()
        rclpy.init(
            args=[],
            context=self._context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = rclpy.create_node('watch', context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def listen(
        self, kind: Any, topic: str, heard: Callable[..., None], profile: QoSProfile | None = None
    ) -> Any:
        """Call back with every message of a topic and, if there is room, what DDS knows of it."""
        return self.node.create_subscription(kind, topic, heard, profile or qos(KEPT))

    def hear(self, seconds: float) -> None:
        """Listen until something has come, ``seconds`` at most."""
        self._executor.spin_once(timeout_sec=max(0.0, seconds))

    def hear_until(self, end: float, done: Callable[[], bool] = lambda: False) -> None:
        """Listen until a time of the monotonic clock [s], or until ``done``."""
        while (left := end - time.monotonic()) > 0.0 and not done():
            self.hear(left)

    def close(self) -> None:
        """Take the node down."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()
