# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Controllers that users would pick instead, to compare with: they fly the same loop.

All plan the same planar problem from the same state and goals, and all their plans are turned into
commands alike; what differs is how the thrust axes R_1 e1..R_N e1 are chosen.
"""
