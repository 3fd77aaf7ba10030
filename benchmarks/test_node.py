# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A node of the laboratory's own, in any domain, spun for as long as something lasts."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from rclpy.qos import QoSProfile

from orbimpc_ros.ros.process import attached, qos

KEPT = 1000  # messages: none may be missed


class TestNode:
    """Subscribes in a domain, and publishes there.

    Args:
        domain: of ROS; the environment's by default.
        executor: that it is spun by.

    Attributes:
        node: for publishers and clients.
    """

    def __init__(self, domain: int | None = None, executor: str = 'wait_set') -> None:
        self._stack = ExitStack()
        attaching = attached('laboratory', domain=domain, executor=executor, enable_rosout=False)
        self.node, self._executor = self._stack.enter_context(attaching)

    def subscribe(
        self, kind: Any, topic: str, heard: Callable[..., None], profile: QoSProfile | None = None
    ) -> Any:
        """Call back with every message of a topic and, if there is room, what DDS knows of it."""
        return self.node.create_subscription(kind, topic, heard, profile or qos(KEPT))

    def spin_once(self, seconds: float) -> None:
        """Listen until something has come, ``seconds`` at most."""
        self._executor.spin_once(timeout_sec=max(0.0, seconds))

    def spin_until(self, end: float, done: Callable[[], bool] = lambda: False) -> None:
        """Listen until a time of the monotonic clock [s], or until ``done``."""
        while (left := end - time.monotonic()) > 0.0 and not done():
            self.spin_once(left)

    def close(self) -> None:
        """Take the node down."""
        self._stack.close()
