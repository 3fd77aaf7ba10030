# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Methods that find optimal trajectories with proved bounds."""
