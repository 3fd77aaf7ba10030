# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The entry points of the installed executables: they obey signals before a node is imported.

Importing a node takes the better part of a second, in which a signal would end in a traceback. And
it takes ROS, which may be missing.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from itertools import takewhile
from pathlib import Path

# What the tool and the general methods need beside ROS, NumPy and SciPy.
OTHERS = ('clarabel', 'matplotlib', 'mcap', 'rosbags')
# What comes with ROS, or from PyPI with the extra of that name.
ROS = (
    *('builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs', 'lifecycle_msgs', 'nav_msgs'),
    *('rcl_interfaces', 'rclpy', 'rosgraph_msgs', 'std_msgs', 'std_srvs', 'visualization_msgs'),
)
PACKAGES = {'planner': 'orbimpc_ros.ros.planner', 'sim': 'orbimpc_ros.sim'}
TABLES = {'planner': 'orbimpc_ros.ros.parameters', 'sim': 'orbimpc_ros.sim.parameters'}
DONE, BAD_INPUT = 0, 2  # exit codes


def leave_at_signals() -> None:
    """End this process at SIGINT and SIGTERM, without a word: it has not begun yet.

    The handlers are installed even where SIGINT is ignored, as by a shell's background jobs.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda _number, _frame: os._exit(0))


def planner() -> int:
    """Run the planner; return the exit code."""
    return _run('planner')


def sim() -> int:
    """Run the simulator; return the exit code."""
    return _run('sim')


def _run(node: str) -> int:
    leave_at_signals()
    gc.disable()  # until the node runs: what a start makes is kept
    try:
        if asks_for_help(sys.argv):
            signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # as for `planner --help | head`
            print(_help(node))
            return DONE
        main = import_module(f'{PACKAGES[node]}.node').main
    except ModuleNotFoundError as error:
        line = in_a_line(error)
        if not line:
            raise
        print(f'{node}: {line}', file=sys.stderr)
        return BAD_INPUT
    return int(main())


def asks_for_help(words: Sequence[str]) -> bool:
    """Return whether a command line asks for help, before the arguments of ROS."""
    plain = takewhile('--ros-args'.__ne__, words)
    return any(word in ('-h', '--help') for word in plain)


def _help(node: str) -> str:
    from orbimpc_ros.ros.help import help_of

    rows = getattr(import_module(TABLES[node]), node.upper())
    name = Path(sys.argv[0]).name
    return help_of(node, node if name == '__main__.py' else name, rows)


def in_a_line(error: ModuleNotFoundError) -> str:
    """Return in a line how to install what is missing; empty for what is missing by a mistake."""
    package = (error.name or '').partition('.')[0]
    if package not in OTHERS + ROS:
        return ''
    from orbimpc_ros import install  # metadata takes time that starts have not

    hint = install.command(package)
    if package in ROS:
        hint = f'install ROS 2, or {install.command_for_extra("ros")}'
    return f'{package} is missing: {hint}'
