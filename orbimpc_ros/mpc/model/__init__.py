# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The discrete dynamics and the cost, as functions of the planned rotations."""
