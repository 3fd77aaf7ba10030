# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Traffic: bodies that are seen, and plans of other vehicles, as hazards to stay clear of."""
