# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A fleet of retrievals: ros2 launch orbimpc_ros fleet.launch.py vehicles:=8."""

from orbimpc_ros.tool.launching import fleet


def generate_launch_description():
    """Return a planner and a simulator for each vehicle, in namespaces."""
    return fleet()
