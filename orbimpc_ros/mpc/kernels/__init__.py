# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Machine code for the hottest loops, compiled by numba if it is installed.

Without numba the functions are ordinary Python: correct, but too slow to be used.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def _plain(function: Callable, *_: Any, **__: Any) -> Callable:
    return function


try:
    from orbimpc_ros.mpc.kernels.compiler import LISTENERS, bare, compiled, entry_point, vectorised
except ImportError:  # there is no numba, or none that fits
    COMPILED = False
    LISTENERS = list[Callable[[], None]]()
    bare = compiled = entry_point = vectorised = _plain
else:
    COMPILED = True
