# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The receding-horizon loop: odometry and forecasts in, checked commands out."""
