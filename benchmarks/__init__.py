# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Comparisons with other methods, and reactions to faults: run from a clone, not installed.

Harnesses, scenarios and the loop without ROS are shared with the tests.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / 'test'))
