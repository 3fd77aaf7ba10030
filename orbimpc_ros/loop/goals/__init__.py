# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Models of a moving goal: fitted side by side, weighed by evidence, given up when it changes."""
