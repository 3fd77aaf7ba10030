# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The mathematics: orbitope MPC in NumPy and Clarabel. No ROS, no clock, no logging."""
