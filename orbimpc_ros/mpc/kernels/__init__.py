# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Machine code for the hottest loops, compiled by numba where that is installed.

Without numba the functions are ordinary Python: right, and too slow to be used.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

try:
    from numba import njit
    from numba.core.caching import FunctionCache
    from numba.core.runtime import rtsys
except ImportError:
    COMPILED = False
else:
    COMPILED = True

    class _KeptCode(FunctionCache):
        """Machine code kept between processes, loaded without setting up the compiler."""

        def load_overload(self, signature: Any, context: Any) -> Any:
            """Return the code for a signature, or None: then it is compiled.

            numba would refresh the context first, with all that it can compile: 0.3 s and 60 MB of
            every start. What code calls at run time is all that is needed to load it.
            """
            rtsys.initialize(context)
            with self._guard_against_spurious_io_errors():
                return self._load_overload(signature, context)


STAMP = 'orbimpc_ros.sha256'  # of the sources that the machine code beside it was compiled from


def compiled(function: Callable) -> Callable:
    """Compile a function at its first call, and keep the code for the next process."""
    return _kept(function) if COMPILED else function


def vectorised(function: Callable) -> Callable:
    """Compile as :func:`compiled` does, and let sums be reordered, as wide arithmetic needs."""
    return _kept(function, fastmath={'reassoc', 'contract'}) if COMPILED else function


def inlined(function: Callable) -> Callable:
    """Compile into what calls it, where to pass arrays takes longer than to go through them."""
    return _kept(function, inline='always') if COMPILED else function


def _kept(function: Callable, **options: Any) -> Callable:
    made = njit(cache=True, **options)(function)
    if made is not function:  # as it is with NUMBA_DISABLE_JIT
        made._cache = _KeptCode(function)
        folder = Path(function.__code__.co_filename).parent
        _forget_other_sources(folder, Path(made.stats.cache_path))
    return made


@cache
def _forget_other_sources(folder: Path, kept: Path) -> None:
    """Delete machine code that was compiled from other sources than those of today.

    numba looks at the file that a function is in alone. What it calls in other files is part of
    its code, and would stay as it was; and code whose types have other names now cannot be read.

    Args:
        folder: of the sources; they call those of this package.
        kept: where their code is.
    """
    found = sha256()
    for source in sorted({*folder.glob('*.py'), *Path(__file__).parent.glob('*.py')}):
        found.update(source.read_bytes())
    stamp = kept / STAMP
    with suppress(OSError):  # others may be at it, or may alone be allowed to
        if stamp.exists() and stamp.read_text() == found.hexdigest():
            return
        for code in (*kept.glob('*.nbi'), *kept.glob('*.nbc')):
            code.unlink(missing_ok=True)
        stamp.write_text(found.hexdigest())
