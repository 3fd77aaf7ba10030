# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Compilation of machine code, for which a start takes a minute or more: said, and broken off."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from orbimpc_ros.install import command
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.ros.entry import leave_at_signals

NOTICE = (
    'compiling machine code, which takes a minute or more and is kept for later starts; '
    'python -m orbimpc_ros.mpc.kernels does it beforehand'
)
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


def report_compilation(say: Callable[[str], None]) -> None:
    """From now on say so whenever machine code has to be compiled; say it now if it cannot be.

    Args:
        say: called with a line, often with the same one.
    """
    if not COMPILED:
        say(MISSING)
        return
    from numba.core import event

    class Compilation(event.Listener):
        """Hears of every function that is compiled instead of loaded."""

        def on_start(self, _event: Any) -> None:
            say(NOTICE)

        def on_end(self, _event: Any) -> None:
            pass

    event.register('numba:compile', Compilation())
