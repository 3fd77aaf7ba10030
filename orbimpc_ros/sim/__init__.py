# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The simulated world: vehicle, rope, capture, scenarios. No ROS, no clock, no logging."""
