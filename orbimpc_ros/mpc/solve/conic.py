# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Cone programs solved by Clarabel.

    minimise  x.Px/2 + q.x   subject to   Ax + s = b,  s in K.

Mathematics: docs/mathematics.md, 4.8.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy import sparse

from orbimpc_ros.install import command
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput

try:
    import clarabel
except ModuleNotFoundError:
    hint = f'the general method for this problem needs it: {command("clarabel")}'
    raise BadInput.stating('clarabel', 'not installed', hint) from None

REDUCED = 1e-7
SOLVED = ('Solved', 'AlmostSolved')


def solver_for(data: dict[str, Any], tolerance: float) -> clarabel.DefaultSolver:
    """Return a Clarabel solver for compiled data; its A, b and q may be updated in place.

    Args:
        data: P, c (which is q), A, b and the sizes of the cones, ``dims``.
        tolerance: on feasibility and on the gap.
    """
    if data['dims'].psd:  # Clarabel would import it at the first solve: 60 ms, in a tick
        import_module('scipy.linalg')
    return clarabel.DefaultSolver(
        sparse.csc_matrix(sparse.triu(data['P'])),
        data['c'],
        data['A'],
        data['b'],
        _cones(data['dims']),
        _settings(tolerance),
    )


def extended(
    data: dict[str, Any], rows: Array, offsets: Array, *, equal: bool = False
) -> dict[str, Any]:
    """Return compiled data with additional rows A'x <= b' or A'x = b'.

    Args:
        data: compiled, with rows ordered by cone.
        rows: A', shape (m, columns).
        offsets: b', shape (m,).
        equal: whether the additional rows are equalities.
    """
    dims, a, m = data['dims'], data['A'].tocoo(), len(offsets)
    kind, end = ('zero', dims.zero) if equal else ('nonneg', dims.zero + dims.nonneg)
    lines, columns = np.nonzero(rows)
    entries = np.concatenate([a.data, rows[lines, columns]])
    places = np.concatenate([np.where(a.row < end, a.row, a.row + m), end + lines])
    shape = a.shape[0] + m, a.shape[1]
    across = np.concatenate([a.col, columns])
    return {
        **data,
        'A': sparse.csc_matrix((entries, (places, across)), shape=shape),
        'b': np.concatenate([data['b'][:end], offsets, data['b'][end:]]),
        'dims': SimpleNamespace(**{**vars(dims), kind: getattr(dims, kind) + m}),
    }


def run(solver: clarabel.DefaultSolver, out_of_time: Callable[[], bool] | None) -> Any:
    """Run a solver and return its solution with any status; None if it panicked.

    By default Clarabel reports ``AlmostSolved`` at errors of up to 1e-4. With :data:`REDUCED` it
    means a solution to 1e-7, which is accurate enough for the check and the gap of a plan.
    """
    if out_of_time is None:
        solver.unset_termination_callback()
    else:
        solver.set_termination_callback(lambda _: out_of_time())
    try:
        return solver.solve()
    except BaseException as error:  # a Rust panic does not derive from Exception
        if type(error).__name__ != 'PanicException':
            raise
        return None


def _cones(dims: Any) -> list:
    """Return the cones of the rows in their order."""
    cones: list = []
    if dims.zero:
        cones.append(clarabel.ZeroConeT(dims.zero))
    if dims.nonneg:
        cones.append(clarabel.NonnegativeConeT(dims.nonneg))
    cones += [clarabel.SecondOrderConeT(size) for size in dims.soc]
    cones += [clarabel.PSDTriangleConeT(size) for size in dims.psd]
    return cones


def _settings(tolerance: float) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    # In-place updates require the sparsity pattern to stay the same.
    settings.presolve_enable = False
    settings.chordal_decomposition_enable = False
    settings.input_sparse_dropzeros = False
    settings.tol_feas = tolerance
    settings.tol_gap_abs = tolerance
    settings.tol_gap_rel = tolerance
    settings.reduced_tol_feas = REDUCED
    settings.reduced_tol_gap_abs = REDUCED
    settings.reduced_tol_gap_rel = REDUCED
    return settings
