# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``python -m orbimpc_ros.ros.planner``, equivalent to the installed executable."""

import sys

from orbimpc_ros.ros.entry import planner

if __name__ == '__main__':
    sys.exit(planner())
