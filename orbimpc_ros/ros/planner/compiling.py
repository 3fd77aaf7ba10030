# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The progress of compiling machine code at the first start."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from orbimpc_ros.install import command

COMPILING = 'compiling machine code, only once'
PAUSE = 5.0  # [s] between two lines of progress
MISSING = (
    'numba is not installed: plans take 6 to 60 times as long; to have it, '
    f'apt install python3-numba or {command("numba")}'
)


def report_compilation(report: Callable[[str], None]) -> None:
    """From now on report the progress whenever machine code has to be compiled.

    Args:
        report: called with a line every few seconds.
    """
    from orbimpc_ros.mpc.kernels import LISTENERS  # whoever only reads the log needs no compiler

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
