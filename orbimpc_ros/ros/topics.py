# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The topics of planner and simulator: names, types, and those required of a bag."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any, NamedTuple


class Topic(NamedTuple):
    """A topic: its name, its type, and whether late subscribers receive the last message."""

    name: str
    type: str
    latched: bool = False

    @property
    def message(self) -> Any:
        """Return the class of its messages."""
        package, _, kind = self.type.split('/')
        return getattr(import_module(f'{package}.msg'), kind)


SHARED = (
    Topic('/clock', 'rosgraph_msgs/msg/Clock'),
    Topic('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray'),
)
TREE = (
    Topic('/tf', 'tf2_msgs/msg/TFMessage'),
    Topic('/tf_static', 'tf2_msgs/msg/TFMessage', latched=True),
)  # of frames: read if recorded
INPUTS = (
    Topic('goal', 'geometry_msgs/msg/PoseStamped'),
    Topic('goal_path', 'nav_msgs/msg/Path'),
    Topic('obstacles', 'visualization_msgs/msg/MarkerArray'),
    Topic('odom', 'nav_msgs/msg/Odometry'),
    Topic('pose', 'geometry_msgs/msg/PoseStamped'),
    Topic('twist', 'geometry_msgs/msg/TwistStamped'),
    Topic('wind', 'geometry_msgs/msg/TwistWithCovarianceStamped'),
)  # of the planner
OUTPUTS = (
    Topic('cmd_thrust', 'geometry_msgs/msg/WrenchStamped'),
    Topic('cmd_vel', 'geometry_msgs/msg/TwistStamped'),
    Topic('plan', 'nav_msgs/msg/Path'),
    Topic('plan_markers', 'visualization_msgs/msg/MarkerArray'),
    Topic('rotation', 'geometry_msgs/msg/QuaternionStamped'),
    Topic('tick', 'diagnostic_msgs/msg/DiagnosticArray'),
)
WORLD = (
    Topic('captured', 'std_msgs/msg/Bool', latched=True),
    Topic('truth', 'diagnostic_msgs/msg/DiagnosticArray'),
    Topic('world_markers', 'visualization_msgs/msg/MarkerArray'),
    Topic('arrived', 'std_msgs/msg/Bool', latched=True),
    Topic('caught', 'std_msgs/msg/Bool', latched=True),
    Topic('certificate', 'std_msgs/msg/UInt8MultiArray'),
)  # of the simulator; events and proofs
# On ~/distance [m], ~/solve_time [s] and so on, for plots in other programs.
NUMBERS = ('distance', 'gap', 'lower_bound', 'objective', 'solve_time')
PLOTTED = tuple(Topic(f'planner/{name}', 'std_msgs/msg/Float64') for name in NUMBERS)
UNRECORDED = (Topic('thrust', 'geometry_msgs/msg/Vector3Stamped'),)  # only to an autopilot
VEHICLE = (*INPUTS, *OUTPUTS, *WORLD)
TYPES = {topic.name.strip('/'): topic.type for topic in (*SHARED, *TREE, *VEHICLE, *PLOTTED)}
# Topics of autopilots by those of the planner. MAVROS needs mav_frame BODY_NED for its setpoints.
AUTOPILOTS: Mapping[str, Mapping[str, str]] = {
    'ardupilot': {
        'pose': '/ap/pose/filtered',
        'twist': '/ap/twist/filtered',
        'cmd_vel': '/ap/cmd_vel',
    },
    'mavros': {
        'odom': '/mavros/local_position/odom',
        'cmd_vel': '/mavros/setpoint_velocity/cmd_vel',
    },
    # The parameter autopilot selects the own topics of wings, px4 and arduplane.
    **{name: {} for name in ('rover', 'px4', 'arduplane')},
}


def topics_of(namespaces: Sequence[str] = ('',)) -> tuple[Topic, ...]:
    """Return the topics of a run with one vehicle in each namespace, such as ``/uav1``."""
    each = (*VEHICLE, *PLOTTED)
    own = (topic._replace(name=f'{ns}/{topic.name}') for ns in namespaces for topic in each)
    return (*SHARED, *own)


def resolving(namespace: str) -> Callable[[str], str]:
    """Return a function that makes a topic's full name, like a node in the namespace."""
    return lambda topic: topic if topic.startswith('/') else f'{namespace}/{topic}'


def known(name: str, kind: str) -> bool:
    """Return True if a topic, in any namespace, belongs to a run and has the right type."""
    return TYPES.get(name.rpartition('/')[2]) == kind


def message_of(name: str) -> Any:
    """Return the message class of a topic of planner or simulator, without a namespace."""
    topics = (*SHARED, *TREE, *VEHICLE, *UNRECORDED)
    return next(topic.message for topic in topics if topic.name == name)
