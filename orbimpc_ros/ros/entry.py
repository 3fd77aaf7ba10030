"""The entry points of the installed executables: they obey signals before a node is imported.

Importing a node takes the better part of a second, in which a signal would end in a traceback.
"""

from __future__ import annotations

import os
import signal
from importlib import import_module


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
    return int(import_module(f'orbimpc_ros.ros.{node}').main())
