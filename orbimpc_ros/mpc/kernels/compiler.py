# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Compiling by numba: parts linked into what calls them, code kept between processes.

This uses numba's internals, so that ``setup.py`` limits its versions.
"""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from contextlib import suppress
from fcntl import LOCK_EX, LOCK_UN, lockf
from functools import cache
from hashlib import sha256
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from zlib import crc32

from llvmlite.binding import add_symbol, parse_assembly
from numba import njit
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import register_pass
from numba.core.lowering import Lower
from numba.core.runtime._nrt_python import c_helpers
from numba.core.typed_passes import NativeLowering

STAMP = 'orbimpc_ros.sha256'  # hash of the sources of the machine code next to it
SHARED = 'kernels/*.py', 'proof/tree.py'  # sources that machine code of other folders uses
LOCKS = 'orbimpc_ros.lock'
WRAPPER = '_ZN7cpython'  # numba's names of functions: wrappers for Python,
RUNTIME = 'NRT_'  # and those that create, count and free arrays
MAKING = 'call', 'binop', 'inplace_binop', 'unary', 'arrayexpr'  # arrays, not parts of others
COMMON: dict[str, Any] = {'error_model': 'numpy', 'no_cfunc_wrapper': True}
USUAL = gc.get_threshold()
SELDOM = 100_000  # objects between collections while compiling, which took a seventh of its time
LISTENERS: list[Callable[[], None]] = []  # called for each function that has to be compiled


def entry_point(function: Callable, **options: Any) -> Callable:
    """Compile a function at its first call from Python, and cache the code for later processes."""
    made: Any = njit(cache=True, pipeline_class=_WholeCompiler, **COMMON | options)(function)
    if made is not function:  # they are the same with NUMBA_DISABLE_JIT
        made._cache = _KeptCode(function)
        folder = Path(function.__code__.co_filename).parent
        _forget_other_sources(folder, Path(made.stats.cache_path))
    return made


def bare(function: Callable) -> Callable:
    """Return the machine code of an :func:`entry_point` without its dispatch on types.

    Dispatch on the types of a problem's numbers takes longer than to bound a leaf. Arguments must
    have the types of the one call that it was compiled for; arrays must be contiguous. A function
    that has not been called is returned as it is.
    """
    known: Any = list(getattr(function, 'overloads', {}).values())
    return known[0].entry_point if len(known) == 1 else function


def compiled(function: Callable, **options: Any) -> Callable:
    """Compile a function that only machine code calls, into which it is linked."""
    options = COMMON | {'no_cpython_wrapper': True} | options
    made: Callable = njit(pipeline_class=_PartCompiler, **options)(function)
    return made


def vectorised(function: Callable) -> Callable:
    """Compile as :func:`compiled` does, but with reordered sums, as SIMD arithmetic requires."""
    return compiled(function, fastmath={'reassoc', 'contract'})


class _Part(JITCodeLibrary):
    """The code of a function that is linked into its callers, and never called otherwise.

    numba would optimise and translate it separately, with all its callees, and again as a part
    of each of its callers, which would double the time of compiling.
    """

    def finalize(self) -> None:
        """Link the function's callees."""
        _link_parts(self)
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0, since the function has no address."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> Any:
        """Return a stub for setting the environment of running code: nothing runs here."""
        return SimpleNamespace(set_env=lambda name, environment: None)


class _Lowering(Lower):
    """Translation of a function, which counts references only if it owns arrays.

    Without arrays that it creates or returns, it would count each reference up and down again:
    a quarter of the time of compiling.
    """

    def __init__(self, context: Any, library: Any, known: Any, *rest: Any, **more: Any) -> None:
        super().__init__(context, library, known, *rest, **more)
        models = context.data_model_manager
        made = (
            signature.return_type
            for each, signature in known.calltypes.items()
            if signature is not None and getattr(each, 'op', '') in MAKING
        )
        if not any(models[each].contains_nrt_meminfo() for each in (known.restype, *made)):
            self.context = self.context.subtarget(enable_nrt=False)


@register_pass(mutates_CFG=True, analysis_only=False)
class _NativeLowering(NativeLowering):
    _name = 'lowering_without_counts'

    @property
    def lowering_class(self) -> Any:
        return _Lowering


class _Compiler(Compiler):
    """numba's compiler with another translation of functions."""

    def define_pipelines(self) -> list:
        """Return the passes of compiling."""
        (pipeline,) = super().define_pipelines()
        for i, (each, what) in enumerate(pipeline.passes):
            if each is NativeLowering:
                pipeline.passes[i] = _NativeLowering, what
        return [pipeline]


class _PartCompiler(_Compiler):
    """Compiler of functions that are linked into their callers."""

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
        super().__init__(typing, target, _Part(target.codegen(), 'part'), *rest)


class _Whole(JITCodeLibrary):
    """The code of a function that Python calls, with all its callees."""

    def add_ir_module(self, added: Any) -> None:
        """Link a function and all its callees; or its wrapper for Python."""
        super().add_ir_module(added)
        if any(each.name.startswith(WRAPPER) for each in added.functions):
            return
        _link_parts(self)
        entries = {each.name for each in added.functions if not each.is_declaration}
        # So that what has a single caller is inlined, and no other code calls it by its name:
        # the optimiser may have changed its arguments.
        for each in self._final_module.functions:
            if not (each.is_declaration or each.name in entries or each.name.startswith(RUNTIME)):
                each.linkage = 'internal'

    def serialize_using_object_code(self) -> tuple:
        """Return the data to cache: the code, and only the names of functions to link."""
        name, what, (code, _) = super().serialize_using_object_code()
        names = (
            f'define void @"{each.name}"() {{ ret void }}' for each in self.get_defined_functions()
        )
        return name, what, (code, parse_assembly('\n'.join(names)).as_bitcode())


class _WholeCompiler(_Compiler):
    """Compiler of functions that Python calls."""

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
        whole = _Whole(target.codegen(), 'whole')
        whole.enable_object_caching()
        super().__init__(typing, target, whole, *rest)


@cache
def _name_runtime() -> None:
    """Make numba's runtime functions known by their names to the code that is loaded."""
    for name, address in c_helpers.items():
        add_symbol(name if name.startswith('_') else RUNTIME + name, address)


def _link_parts(library: JITCodeLibrary) -> None:
    """Link all callees of a function."""
    for part in dict.fromkeys(library._linking_libraries):
        library._final_module.link_in(part._get_module_for_linking(), preserve=True)
    library._linking_libraries.clear()


# --- the cache


class _CodeAlone(CompileResultCacheImpl):
    """Machine code without the environments in which Python would run parts of it.

    They are not needed, but reading them would import all that numba supports, such as SciPy.
    """

    def reduce(self, result: Any) -> tuple:
        """Return the data of a compiled function to cache."""
        *known, _ = super().reduce(result)
        return *known, ()


class _KeptCode(FunctionCache):
    """A cache of machine code between processes, loaded without setting up the compiler."""

    _impl_class = _CodeAlone

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the code for a signature, or None if it has to be compiled.

        If several processes need it at the same time, one compiles it and the others wait.
        numba would first set up its context for compiling: 0.3 s and 80 MB at every start.
        Loading needs only the addresses of the runtime functions that the code calls.
        """
        _name_runtime()
        found = self._kept(signature, context)
        if found is None:
            for listener in LISTENERS:
                listener()
            self._lock(LOCK_EX)
            found = self._kept(signature, context)  # another process may just have compiled it
            if found is not None:
                self._lock(LOCK_UN)
            else:
                gc.set_threshold(SELDOM)
        return found

    def save_overload(self, signature: Any, data: Any) -> None:
        """Cache compiled code."""
        super().save_overload(signature, data)
        self._lock(LOCK_UN)
        gc.set_threshold(*USUAL)

    def _kept(self, signature: Any, context: Any) -> Any:
        with self._guard_against_spurious_io_errors():
            return self._load_overload(signature, context)

    def _lock(self, what: int) -> None:
        """Lock or unlock this function, a byte of a file, during its compilation."""
        byte = crc32(f'{self._py_func.__module__}.{self._py_func.__qualname__}'.encode())
        with suppress(OSError):  # such as a cache without write permission
            lockf(_lock_file(Path(self.cache_path)), what, 1, byte)


@cache
def _lock_file(folder: Path) -> int:
    """Return the descriptor of a cache's lock file, open until the process ends."""
    folder.mkdir(parents=True, exist_ok=True)
    return os.open(folder / LOCKS, os.O_RDWR | os.O_CREAT, 0o666)


@cache
def _forget_other_sources(folder: Path, kept: Path) -> None:
    """Delete machine code that was compiled from other versions of the sources.

    numba checks only the file that contains a function. Its callees in other files are part of its
    code, which would become outdated; and code with types that were renamed cannot be read.

    Args:
        folder: of the sources; they may also use those of :data:`SHARED`.
        kept: folder of their machine code.
    """
    found = sha256()
    shared = (Path(__file__).parents[1].glob(pattern) for pattern in SHARED)
    for source in sorted({*folder.glob('*.py'), *chain.from_iterable(shared)}):
        found.update(source.read_bytes())
    stamp = kept / STAMP
    with suppress(OSError):  # other processes may be doing so, or permission may be lacking
        if stamp.exists() and stamp.read_text() == found.hexdigest():
            return
        for code in (*kept.glob('*.nbi'), *kept.glob('*.nbc')):
            code.unlink(missing_ok=True)
        stamp.write_text(found.hexdigest())
