# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Measurements against others, and of the reactions to faults: run from a clone, not installed."""
