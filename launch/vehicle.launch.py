# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A planner for a real vehicle: ros2 launch orbimpc_ros vehicle.launch.py autopilot:=mavros."""

from orbimpc_ros.tool.launching import vehicle


def generate_launch_description():
    """Return the planner, on the topics of an autopilot."""
    return vehicle()
