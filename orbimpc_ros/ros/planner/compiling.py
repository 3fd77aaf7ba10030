# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Compilation of machine code at the first start: its progress, and signals in the meantime."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from orbimpc_ros.install import command
from orbimpc_ros.ros.entry import leave_at_signals

COMPILING = 'compiling machine code, only once'
PAUSE = 5.0  # [s] between two lines of progress
MISSING = (
    'numba is not installed: plans take 6 to 60 times as long; to have it, '
    f'apt install python3-numba or {command("numba")}'
)


@contextmanager
def leaving_at_signals() -> Iterator[None]:
    """End the process at a signal, as long as nothing has been commanded.

    An exception would not do: raised by a handler inside one of LLVM's callbacks it is dropped.
    """
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.getsignal(number) for number in numbers]
    leave_at_signals()
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def report_compilation(report: Callable[[str], None]) -> None:
    """From now on report the progress whenever machine code has to be compiled.

    Args:
        report: called with a line every few seconds.
    """
    from orbimpc_ros.mpc.kernels import LISTENERS  # whoever only reads the log needs no compiler

    begun = said = -math.inf
    count = 0

    def on_function() -> None:
        nonlocal begun, said, count
        now, count = time.monotonic(), count + 1
        begun = now if count == 1 else begun
        if now - said >= PAUSE:
            said = now
            report(f'{COMPILING}: function {count}, {now - begun:.0f} s')

    LISTENERS[:] = [on_function]
