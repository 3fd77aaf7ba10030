# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The former name of ros2 launch orbimpc_ros flight.launch.py scenario:=retrieval."""

from orbimpc_ros.tool.launching import flight


def generate_launch_description():
    """Return both nodes on one parameter file."""
    return flight('retrieval')
