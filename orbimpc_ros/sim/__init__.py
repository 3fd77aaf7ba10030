# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The simulator: a vehicle, the world that it flies in, and the node that shows the flight."""
