# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Files, bags and messages that the commands read and write."""
