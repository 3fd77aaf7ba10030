# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The command line, with one module per command."""
