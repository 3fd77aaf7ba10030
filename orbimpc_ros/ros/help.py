# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What ``--help`` of the nodes prints: topics, arguments, parameters, exit codes."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

from orbimpc_ros.ros.parameters.spec import ParameterSpec

WIDTH = 80
TOPICS = {
    'planner': 'Plans from odom and goal, and commands on cmd_vel (cmd_thrust at translation '
    'order 2). Reports on tick, plan and /diagnostics; arrived and caught are events.',
    'sim': 'Flies a vehicle by the commands on cmd_vel and cmd_thrust, and publishes odom, goal '
    'and captured.',
}
USAGE = """\
usage: {name} [--ros-args ARGUMENT...]

{topics}

arguments of ROS:
  --params-file FILE   parameters, as in config/retrieval.yaml
  -p NAME:=VALUE       one parameter; decimal numbers need a point: 1.0
  -r FROM:=TO          another name of a topic, or __ns:=/NAMESPACE

parameters (name, default, meaning):
{parameters}

exit codes: 0 done or ended by a signal, 1 failed, 2 bad input"""


def help_of(node: str, name: str, rows: Iterable[ParameterSpec]) -> str:
    """Return the help of a node.

    Args:
        node: ``planner`` or ``sim``.
        name: of the executable.
        rows: the node's parameters.
    """
    topics = textwrap.fill(TOPICS[node], WIDTH)
    parameters = '\n'.join(map(_lines, sorted(rows, key=lambda row: row.name)))
    return USAGE.format(name=name, topics=topics, parameters=parameters)


def _lines(row: ParameterSpec) -> str:
    default = row.default
    if isinstance(default, tuple):
        default = f'[{", ".join(map(str, default))}]'
    unit = f' {row.unit}' if row.unit else ''
    shown = str(default).lower() if isinstance(default, bool) else default
    indent = ' ' * 6
    meaning = textwrap.wrap(row.description, WIDTH - len(indent))
    return f'\n{indent}'.join([f'  {row.name}  {shown}{unit}'.rstrip(), *meaning])
