# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The laboratory: benchmarks, studies and the fault matrix."""
