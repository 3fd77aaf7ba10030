# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Goals to come: forecasts from its observations, trajectories from outside."""
