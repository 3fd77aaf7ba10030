# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""ROS 2 adapters: messages and parameters to plain types and back, and the two nodes."""
