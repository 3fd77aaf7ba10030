# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner's ear for transforms: /tf and /tf_static, with the qualities of service of tf2."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.qos import DurabilityPolicy

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.process import Guarded, qos
from orbimpc_ros.ros.transforms import TF, TF_STATIC

DEPTH = 100  # messages that may wait: each tells of other frames
DURABILITY = {TF: DurabilityPolicy.VOLATILE, TF_STATIC: DurabilityPolicy.TRANSIENT_LOCAL}


def listen_to_transforms(node: Guarded, heard: Callable[[str, Any], None]) -> None:
    """Subscribe to transforms; ``heard`` is given each topic and message.

    The messages of tf2 are enough: its library would hear them in a thread of its own.

    Raises:
        BadInput: the messages are not installed.
    """
    try:
        from tf2_msgs.msg import TFMessage
    except ModuleNotFoundError:
        hint = 'install ros-<distro>-tf2-msgs, or state them in transforms, with tf: false'
        raise BadInput.stating('tf', 'true, and tf2_msgs is missing', hint) from None
    for topic, durability in DURABILITY.items():
        take = node.guard(_hearing(heard, topic))
        node.create_subscription(TFMessage, topic, take, qos(DEPTH, durability=durability))


def _hearing(heard: Callable[[str, Any], None], topic: str) -> Callable[[Any], None]:
    def on_transforms(message: Any) -> None:
        heard(topic, message)

    return on_transforms
