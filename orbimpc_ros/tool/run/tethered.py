# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A module run as by ``python -m``, or a program, that ends with the process that started it."""

from __future__ import annotations

import ctypes
import os
import runpy
import signal
import sys

from orbimpc_ros.ros.entry import leave_at_signals

PR_SET_PDEATHSIG = 1  # <sys/prctl.h>
PROGRAM = '--program'  # instead of a module: its path and arguments follow


def tether(parent: int) -> None:
    """Have this process stopped as soon as its parent is gone, even if that was killed.

    By SIGTERM: a shell has its background jobs ignore SIGINT, and all that these start.
    """
    leave_at_signals()
    if not sys.platform.startswith('linux'):
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it went before we asked
        sys.exit(1)


if __name__ == '__main__':
    tether(int(sys.argv.pop(1)))
    module = sys.argv.pop(1)
    if module == PROGRAM:
        os.execv(sys.argv[1], sys.argv[1:])  # what was arranged for this process stays
    runpy.run_module(module, run_name='__main__', alter_sys=True)
