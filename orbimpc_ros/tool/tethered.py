"""Runs a module as ``python -m`` does, but not longer than the process that started it."""

from __future__ import annotations

import ctypes
import os
import runpy
import signal
import sys

PR_SET_PDEATHSIG = 1  # <sys/prctl.h>


def tether(parent: int) -> None:
    """Have this process told to stop (SIGINT) as soon as its parent is gone, even if killed."""
    if not sys.platform.startswith('linux'):
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGINT)
    if os.getppid() != parent:  # it went before we asked
        sys.exit(1)


if __name__ == '__main__':
    tether(int(sys.argv.pop(1)))
    module = sys.argv.pop(1)
    runpy.run_module(module, run_name='__main__', alter_sys=True)
