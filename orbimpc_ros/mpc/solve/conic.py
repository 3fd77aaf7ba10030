# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Cone programs solved by Clarabel.

    minimise  x.Px/2 + q.x   subject to   Ax + s = b,  s in K.

Mathematics: docs/mathematics.md, 4.8.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
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


def extended(
    data: dict[str, Any], rows: Array, offsets: Array, *, equal: bool = False
) -> dict[str, Any]:
    """Return compiled data with additional rows A'x <= b' or A'x = b' after the others.

    Args:
        data: compiled.
        rows: A', shape (m, columns).
        offsets: b', shape (m,).
        equal: whether the additional rows are equalities.
    """
    a, count = data['A'], len(offsets)
    columns, lines = np.nonzero(rows.T)
    more = np.bincount(columns, minlength=a.shape[1])
    at = np.repeat(a.indptr[1:], more)  # behind the other entries of each column
    entries = np.insert(a.data, at, rows[lines, columns])
    places = np.insert(a.indices, at, a.shape[0] + lines)
    ends = a.indptr + np.append(0, np.cumsum(more))
    shape = a.shape[0] + count, a.shape[1]
    cone = clarabel.ZeroConeT(count) if equal else clarabel.NonnegativeConeT(count)
    return {
        **data,
        'A': sparse.csc_matrix((entries, places, ends), shape=shape),
        'b': np.concatenate([data['b'], offsets]),
        'cones': [*data['cones'], cone],
    }


def run(
    data: dict[str, Any],
    tolerance: float,
    scale: float = 1.0,
    out_of_time: Callable[[], bool] | None = None,
) -> Any:
    """Return Clarabel's solution of compiled data, with any status; None if it panicked.

    By default Clarabel reports ``AlmostSolved`` at errors of up to 1e-4. With :data:`REDUCED` it
    means a solution to 1e-7, which is accurate enough for the check and the gap of a plan.

    Args:
        data: the upper triangle of P; q, A, b and the ``cones``.
        tolerance: on feasibility and on the gap.
        scale: that the cost is divided by.
        out_of_time: polled at each iteration; None for no deadline.
    """
    cost, rows = (data['P'] / scale, data['q'] / scale), (data['A'], data['b'], data['cones'])
    solver = clarabel.DefaultSolver(*cost, *rows, _settings(tolerance))
    if out_of_time is not None:
        solver.set_termination_callback(lambda _: out_of_time())
    try:
        return solver.solve()
    except BaseException as error:  # a Rust panic does not derive from Exception
        if type(error).__name__ != 'PanicException':
            raise
        return None


def cones_of(zero: int, nonneg: int, soc: Sequence[int], psd: Sequence[int]) -> list:
    """Return the cones of rows in this order: zero, non-negative, second-order, semidefinite."""
    if psd:
        import_module('scipy.linalg')  # Clarabel would, at the first solve: 60 ms, in a tick
    cones: list = []
    if zero:
        cones.append(clarabel.ZeroConeT(zero))
    if nonneg:
        cones.append(clarabel.NonnegativeConeT(nonneg))
    cones += [clarabel.SecondOrderConeT(size) for size in soc]
    cones += [clarabel.PSDTriangleConeT(size) for size in psd]
    return cones


def _settings(tolerance: float) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_feas = tolerance
    settings.tol_gap_abs = tolerance
    settings.tol_gap_rel = tolerance
    settings.reduced_tol_feas = REDUCED
    settings.reduced_tol_gap_abs = REDUCED
    settings.reduced_tol_gap_rel = REDUCED
    return settings
