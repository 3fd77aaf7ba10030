# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The entry points of the installed executables: they handle signals before importing a node.

Importing a node takes most of a second, during which a signal would end in a traceback. It also
requires ROS, which may be missing.
"""

from __future__ import annotations

import gc
import math
import os
import signal
import sys
import textwrap
import time
from collections.abc import Callable
from importlib import import_module
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from orbimpc_ros.ros.parameters.spec import ParameterSpec

# Needed by the tool and the general methods, besides ROS, NumPy and SciPy.
OTHERS = ('clarabel', 'matplotlib', 'mcap', 'rosbags')
# Part of ROS, or of the PyPI extra with that name.
ROS = (
    *('builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs', 'lifecycle_msgs', 'nav_msgs'),
    *('rcl_interfaces', 'rclpy', 'rosgraph_msgs', 'std_msgs', 'std_srvs', 'visualization_msgs'),
)
PACKAGES = {'planner': 'orbimpc_ros.ros.planner', 'sim': 'orbimpc_ros.sim'}
TABLES = {'planner': 'orbimpc_ros.ros.parameters.planner', 'sim': 'orbimpc_ros.sim.parameters'}
DONE, BAD_INPUT = 0, 2  # exit codes
SIGNALS = (signal.SIGINT, signal.SIGTERM)
WIDTH = 80  # of --help
TOPICS = {
    'planner': 'Plans from odom and goal, and commands on cmd_vel (cmd_thrust at translation '
    'order 2). Reports on tick, plan and /diagnostics; arrived and caught are events.',
    'sim': 'Flies a vehicle by the commands on cmd_vel and cmd_thrust, and publishes odom, goal '
    'and captured.',
}
COMPILING = 'compiling machine code, only once'
PAUSE = 5.0  # [s] between lines of progress
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


def leave_at_signals() -> None:
    """Exit silently at SIGINT and SIGTERM while the process has not begun its work.

    An exception would not do: raised by a handler inside one of LLVM's callbacks, it is dropped.
    The handlers are installed even if SIGINT is ignored, as in background jobs of a shell.
    """
    for number in SIGNALS:
        signal.signal(number, lambda _number, _frame: os._exit(0))


def planner() -> int:
    """Run the planner; return the exit code."""
    return _run('planner')


def sim() -> int:
    """Run the simulator; return the exit code."""
    return _run('sim')


def _run(node: str) -> int:
    leave_at_signals()
    gc.disable()  # until the node runs: objects of the start are permanent
    plain = takewhile('--ros-args'.__ne__, sys.argv)
    try:
        if any(word in ('-h', '--help') for word in plain):
            signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # for uses like `planner --help | head`
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


def _help(node: str) -> str:
    """Return the text of ``--help`` of a node: topics, arguments, parameters, exit codes."""
    specs = getattr(import_module(TABLES[node]), node.upper())
    name = Path(sys.argv[0]).name
    return USAGE.format(
        name=node if name == '__main__.py' else name,
        topics=textwrap.fill(TOPICS[node], WIDTH),
        parameters='\n'.join(map(_help_on, sorted(specs, key=lambda spec: spec.name))),
    )


def _help_on(spec: ParameterSpec) -> str:
    default, indent = spec.default, ' ' * 6
    if isinstance(default, tuple):
        default = f'[{", ".join(map(str, default))}]'
    shown = str(default).lower() if isinstance(default, bool) else default
    meaning = textwrap.wrap(spec.description, WIDTH - len(indent))
    return f'\n{indent}'.join([f'  {spec.name}  {shown} {spec.unit}'.rstrip(), *meaning])


def in_a_line(error: ModuleNotFoundError) -> str:
    """Return in one line how to install a missing package; empty if it is not a dependency."""
    package = (error.name or '').partition('.')[0]
    if package not in OTHERS + ROS:
        return ''
    from orbimpc_ros import install  # slow: it reads package metadata

    hint = install.command(package)
    if package in ROS:
        hint = f'install ROS 2, or {install.command_for_extra("ros")}'
    return f'{package} is missing: {hint}'


def report_compilation(report: Callable[[str], None]) -> None:
    """Report progress, by a line every few seconds, whenever machine code has to be compiled."""
    from orbimpc_ros.mpc.kernels import LISTENERS  # readers of COMPILING alone need no compiler

    begun = reported = -math.inf
    count = 0

    def on_function() -> None:
        nonlocal begun, reported, count
        now, count = time.monotonic(), count + 1
        begun = now if count == 1 else begun
        if now - reported >= PAUSE:
            reported = now
            report(f'{COMPILING}: function {count}, {now - begun:.0f} s')

    LISTENERS[:] = [on_function]


def without_compiler() -> str:
    """Return a message that the compiler is missing, and how to install it."""
    from orbimpc_ros import install

    hint = install.command_for_extra('fast')
    return f'numba is missing or too old: plans take 6 to 60 times as long; to install it: {hint}'
