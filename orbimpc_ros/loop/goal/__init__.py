# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Future goals: forecasts from observations, and trajectories from external sources."""
