# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Active constraints and their shadow prices."""
