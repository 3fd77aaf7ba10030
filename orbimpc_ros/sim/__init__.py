# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The simulator: a vehicle, its world, and the ROS node that publishes the flight."""
