# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Parameters of nodes: tables, settings derived from them, their declaration and changes."""
