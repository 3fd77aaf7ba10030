"""The executables of the two nodes: what they print where ROS is not installed."""

from __future__ import annotations

import sys
from importlib import import_module

# What comes with ROS, or from PyPI with the extra of that name.
ROS = (
    *('builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs', 'nav_msgs', 'rcl_interfaces'),
    *('rclpy', 'rosgraph_msgs', 'std_msgs', 'std_srvs', 'visualization_msgs'),
)
BAD_INPUT = 2  # exit code


def missing(error: ModuleNotFoundError) -> str:
    """Return a line that says how to install what is missing of ROS; empty for anything else."""
    package = (error.name or '').partition('.')[0]
    hint = "install ROS 2, or pip install 'orbimpc_ros[ros]'"
    return f'{package} is missing: {hint}' if package in ROS else ''


def planner() -> int:
    """Run the planner; return the exit code."""
    return _run('planner')


def sim() -> int:
    """Run the simulator; return the exit code."""
    return _run('sim')


def _run(node: str) -> int:
    try:
        main = import_module(f'orbimpc_ros.ros.{node}').main
    except ModuleNotFoundError as error:
        line = missing(error)
        if not line:
            raise
        print(f'{node}: {line}', file=sys.stderr)
        return BAD_INPUT
    return main()
