# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Measurements against others, and of the reactions to faults: run from a clone, not installed.

Harnesses, scenarios and the loop without ROS are those of the tests.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / 'test'))
