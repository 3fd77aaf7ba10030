# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Machine code for the hottest loops, compiled by numba where that is installed.

Without numba the functions are ordinary Python: right, and too slow to be used.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from fcntl import LOCK_EX, LOCK_UN, lockf
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from zlib import crc32

try:
    from numba import njit
    from numba.core.caching import CompileResultCacheImpl, FunctionCache
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import Compiler
    from numba.core.runtime import rtsys
except ImportError:
    COMPILED = False
else:
    COMPILED = True

    class _CodeAlone(CompileResultCacheImpl):
        """Machine code without the environments in which Python would run parts of it.

        There are none, but to read them imports all that numba has them for, SciPy among it.
        """

        def reduce(self, result: Any) -> tuple:
            """Return what is kept of a compiled function."""
            *known, _ = super().reduce(result)
            return *known, ()

    class _KeptCode(FunctionCache):
        """Machine code kept between processes, loaded without setting up the compiler."""

        _impl_class = _CodeAlone

        def load_overload(self, signature: Any, context: Any) -> Any:
            """Return the code for a signature, or None: then it is compiled.

            Of several processes that need it at the same time one compiles it, and the others wait.
            numba would refresh the context first, with all that it can compile: 0.3 s and 60 MB of
            every start. What code calls at run time is all that is needed to load it.
            """
            rtsys.initialize(context)
            found = self._kept(signature, context)
            if found is None:
                for listener in LISTENERS:
                    listener()
                self._lock(LOCK_EX)
                found = self._kept(signature, context)  # another process may just have compiled it
                if found is not None:
                    self._lock(LOCK_UN)
            return found

        def save_overload(self, signature: Any, data: Any) -> None:
            """Keep what has been compiled."""
            super().save_overload(signature, data)
            self._lock(LOCK_UN)

        def _kept(self, signature: Any, context: Any) -> Any:
            with self._guard_against_spurious_io_errors():
                return self._load_overload(signature, context)

        def _lock(self, what: int) -> None:
            """Lock or unlock this function: a byte of a file, while it is being compiled."""
            byte = crc32(f'{self._py_func.__module__}.{self._py_func.__qualname__}'.encode())
            with suppress(OSError):  # such as a cache that others alone may write
                lockf(_lock_file(Path(self.cache_path)), what, 1, byte)

    class _Part(JITCodeLibrary):
        """The code of a function that becomes part of what calls it, and is called by no one else.

        numba would optimise and translate it on its own, together with all that it calls, and do
        so again as a part of each of its callers: as long again as all else that compiling takes.
        """

        def finalize(self) -> None:
            """Take up what the function calls; callers' code is optimised as a whole."""
            for library in dict.fromkeys(self._linking_libraries):
                self._final_module.link_in(library._get_module_for_linking(), preserve=True)
            self._finalized = True

        def get_pointer_to_function(self, name: str) -> int:
            """Return that there is none."""
            self._ensure_finalized()
            return 0

        @property
        def codegen(self) -> Any:
            """Return what the environment of running code is set in: nothing runs here."""
            return SimpleNamespace(set_env=lambda name, environment: None)

    class _PartCompiler(Compiler):
        """Compiles a function to a part of what calls it."""

        def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
            super().__init__(typing, target, _Part(target.codegen(), 'part'), *rest)


STAMP = 'orbimpc_ros.sha256'  # of the sources that the machine code beside it was compiled from
LOCKS = 'orbimpc_ros.lock'
LISTENERS: list[Callable[[], None]] = []  # called for each function that has to be compiled


@cache
def _lock_file(folder: Path) -> int:
    """Return the descriptor of a cache's lock file, open until the process ends."""
    folder.mkdir(parents=True, exist_ok=True)
    return os.open(folder / LOCKS, os.O_RDWR | os.O_CREAT, 0o666)


def entry_point(function: Callable) -> Callable:
    """Compile at its first call from Python, and keep the code for the next process."""
    return _kept(function) if COMPILED else function


def compiled(function: Callable) -> Callable:
    """Compile to a part of what calls it in machine code; Python does not call it."""
    return _nested(function) if COMPILED else function


def vectorised(function: Callable) -> Callable:
    """Compile as :func:`compiled` does, and let sums be reordered, as wide arithmetic needs."""
    return _nested(function, fastmath={'reassoc', 'contract'}) if COMPILED else function


def _nested(function: Callable, **options: Any) -> Callable:
    options |= {'no_cpython_wrapper': True, 'no_cfunc_wrapper': True}
    made: Callable = njit(pipeline_class=_PartCompiler, **options)(function)
    return made


def _kept(function: Callable) -> Callable:
    made: Any = njit(cache=True)(function)
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
