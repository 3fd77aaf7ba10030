# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner node, modified to raise an exception on odometry with fast sideslip.

No message makes the planner itself raise, as far as is known.
"""

from __future__ import annotations

import sys
from typing import Any

from benchmarks.faults.stimulus import SLIP
from orbimpc_ros.loop.planner import Planner, Snapshot
from orbimpc_ros.ros.planner import node as planner

sound = Planner.step


def step(self: Planner, snapshot: Snapshot, *rest: Any, **more: Any) -> Any:
    """Plan, unless the odometry has sideslip."""
    odometry = snapshot.odometry
    if odometry is not None and odometry.body_velocity[1] > 0.5 * SLIP and not snapshot.stop:
        raise ArithmeticError('slipped')
    return sound(self, snapshot, *rest, **more)


if __name__ == '__main__':
    Planner.step = step  # type: ignore[method-assign]
    sys.exit(planner.main())
