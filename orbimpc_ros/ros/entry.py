# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The entry points of the installed executables: they handle signals before importing a node.

Importing a node takes most of a second, during which a signal would end in a traceback. It also
requires ROS, which may be missing.
"""

from __future__ import annotations

import gc
import itertools
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module

# Needed by the tool and the general methods, besides ROS, NumPy and SciPy.
OTHERS = ('clarabel', 'matplotlib', 'mcap', 'rosbags')
# Part of ROS, or of the PyPI extra with that name.
ROS = (
    *('builtin_interfaces', 'diagnostic_msgs', 'geometry_msgs', 'lifecycle_msgs', 'nav_msgs'),
    *('rcl_interfaces', 'rclpy', 'rosgraph_msgs', 'std_msgs', 'std_srvs', 'visualization_msgs'),
)
EXTRAS = dict.fromkeys(ROS, 'ros') | {'distributed': 'study', 'rerun': 'view'}  # by package
PACKAGES = {'planner': 'orbimpc_ros.ros.planner', 'sim': 'orbimpc_ros.sim'}
DONE, BAD_INPUT = 0, 2  # exit codes
SIGNALS = (signal.SIGINT, signal.SIGTERM)
COMPILING = 'compiling machine code, only once'
PAUSE = 5.0  # [s] between lines of progress


def leave_at_signals() -> None:
    """Exit silently at SIGINT and SIGTERM while the process has not begun its work.

    An exception would not do: raised by a handler inside one of LLVM's callbacks, it is dropped.
    The handlers are installed even if SIGINT is ignored, as in background jobs of a shell.
    """
    for number in SIGNALS:
        signal.signal(number, lambda _number, _frame: os._exit(0))


def _run(node: str) -> int:
    """Run a node; return the exit code."""
    leave_at_signals()
    gc.disable()  # until the node runs: objects of the start are permanent
    try:
        main = import_module(f'{PACKAGES[node]}.node').main
    except ImportError as error:
        print(f'{node}: {in_a_line(error)}', file=sys.stderr)
        return BAD_INPUT
    return int(main())


planner, sim = partial(_run, 'planner'), partial(_run, 'sim')


def in_a_line(error: ImportError) -> str:
    """Return in one line how to install a missing package; raise the error of any other module."""
    if 'shared object' in str(error):  # the environment of ROS is incomplete, as under sudo
        return f'{str(error).splitlines()[0]}; source the setup.sh of ROS 2 in this shell'
    package = (error.name or '').partition('.')[0]
    if package not in (*OTHERS, *EXTRAS):
        raise error
    from orbimpc_ros import install  # slow: it reads package metadata

    extra = EXTRAS.get(package)
    hint = install.command_for_extra(extra) if extra else install.command(package)
    return f'{package} is missing: {"install ROS 2, or " * (extra == "ros")}{hint}'


def report_compilation(report: Callable[[str], None]) -> None:
    """Report progress, by a line every few seconds, whenever machine code has to be compiled."""
    from orbimpc_ros.mpc.kernels import LISTENERS  # readers of COMPILING alone need no compiler

    def progress() -> Iterator[None]:
        begun, due = time.monotonic(), 0.0
        for count in itertools.count(1):
            taken = time.monotonic() - begun
            if taken >= due:
                due = taken + PAUSE
                report(f'{COMPILING}: function {count}, {taken:.0f} s')
            yield

    LISTENERS[:] = [progress().__next__]


def without_compiler() -> str:
    """Return a message that the compiler is missing, and how to install it."""
    from orbimpc_ros import install

    hint = install.command_for_extra('fast')
    return f'numba is missing or too old: plans take 6 to 60 times as long; to install it: {hint}'
