"""Word of machine code that is being compiled, for which a start takes up to a minute."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from orbimpc_ros.mpc.kernels import COMPILED

NOTICE = (
    'compiling machine code, which takes up to a minute and is kept for later starts; '
    'python -m orbimpc_ros.mpc.kernels does it beforehand'
)
MISSING = (
    'numba is not installed: plans take 6 to 60 times as long; to have it, '
    'apt install python3-numba or pip install numba'
)


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
