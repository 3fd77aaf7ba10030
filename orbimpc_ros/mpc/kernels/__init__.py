# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Machine code for the hottest loops, compiled by numba where that is installed.

Without numba the functions are ordinary Python: right, and too slow to be used.
"""

from __future__ import annotations

from collections.abc import Callable

try:
    from numba import njit
except ImportError:
    COMPILED = False
else:
    COMPILED = True


def compiled(function: Callable) -> Callable:
    """Compile a function at its first call, and keep the code for the next process."""
    return njit(cache=True)(function) if COMPILED else function


def vectorised(function: Callable) -> Callable:
    """Compile as :func:`compiled` does, and let sums be reordered, as wide arithmetic needs."""
    return njit(cache=True, fastmath={'reassoc', 'contract'})(function) if COMPILED else function
