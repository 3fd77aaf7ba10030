# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""One search for every problem: stage sets, a relaxation, and best-first branch and bound."""
