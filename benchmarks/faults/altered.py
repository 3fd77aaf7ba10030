# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner node, made to raise on odometry that slips sideways fast, and with a simpler /tf.

No message makes the planner itself raise, as far as is known. PyPI has no tf2_msgs, whose messages
are lists of transforms: here /tf carries single ones, as geometry_msgs/TransformStamped.
"""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

from geometry_msgs.msg import TransformStamped

from benchmarks.faults.stimulus import SLIP
from orbimpc_ros.loop.planner import Planner, Snapshot
from orbimpc_ros.ros.planner import node as planner
from orbimpc_ros.ros.transforms import Transforms

sound, heard = Planner.step, Transforms.hear


def step(self: Planner, snapshot: Snapshot, *rest: Any, **more: Any) -> Any:
    """Plan, unless the odometry slips."""
    odometry = snapshot.odometry
    if odometry is not None and odometry.body_velocity[1] > 0.5 * SLIP and not snapshot.stop:
        raise ArithmeticError('slipped')
    return sound(self, snapshot, *rest, **more)


def hear(self: Transforms, topic: str, message: TransformStamped) -> None:
    """Take in a single transform."""
    heard(self, topic, SimpleNamespace(transforms=[message]))


if __name__ == '__main__':
    Planner.step = step  # type: ignore[method-assign]
    messages: Any = ModuleType('tf2_msgs.msg')
    messages.TFMessage = TransformStamped
    sys.modules['tf2_msgs.msg'] = messages
    Transforms.hear = hear  # type: ignore[method-assign]
    sys.exit(planner.main())
