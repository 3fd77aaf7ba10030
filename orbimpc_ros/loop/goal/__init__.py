# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Where the goal will be: forecasts from its observations, trajectories from outside."""
