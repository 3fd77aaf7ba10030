# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The parameters of nodes: tables, the settings they add up to, their declaration and changes."""
