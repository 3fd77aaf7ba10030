# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner node with a /tf that carries single transforms, as geometry_msgs/TransformStamped.

PyPI has no tf2_msgs, whose messages are lists of them. All but the list is as on a vehicle.
"""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

from geometry_msgs.msg import TransformStamped

from orbimpc_ros.ros.planner import node as planner
from orbimpc_ros.ros.transforms import Transforms

sound = Transforms.hear


def hear(self: Transforms, topic: str, message: TransformStamped) -> None:
    """Take in a single transform."""
    sound(self, topic, SimpleNamespace(transforms=[message]))


if __name__ == '__main__':
    messages: Any = ModuleType('tf2_msgs.msg')
    messages.TFMessage = TransformStamped
    sys.modules['tf2_msgs.msg'] = messages
    Transforms.hear = hear  # type: ignore[method-assign]
    sys.exit(planner.main())
