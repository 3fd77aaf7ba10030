# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner's topics, as autopilots name them; ``config/`` has parameters for each."""

from __future__ import annotations

from collections.abc import Mapping

# The topics of each, by the planner's. MAVROS is to have mav_frame BODY_NED for its setpoints.
TOPICS: Mapping[str, Mapping[str, str]] = {
    'ardupilot': {
        'pose': '/ap/pose/filtered',
        'twist': '/ap/twist/filtered',
        'cmd_vel': '/ap/cmd_vel',
    },
    'mavros': {
        'odom': '/mavros/local_position/odom',
        'cmd_vel': '/mavros/setpoint_velocity/cmd_vel',
    },
    'rover': {},
    'px4': {},  # and arduplane: wings on the autopilot's own topics, by the parameter autopilot
    'arduplane': {},
}
