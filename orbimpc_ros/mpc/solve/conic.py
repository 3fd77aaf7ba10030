# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Clarabel on the data of a cone program, and what its multipliers prove.

For the program

    minimise  x.Px/2 + q.x   subject to   Ax + s = b,  s in K,

any y in the dual cone proves bounds, however the solver came by it. With r = Px' + q + A'y at any
x', convexity gives for every feasible x

    x.Px/2 + q.x  >=  -x'.Px'/2 - b.y + r.x  >=  -x'.Px'/2 - b.y - sum_i |r_i| D_i,

D_i the most that |x_i| can be, which the orbitopes limit for every variable of a plan. And if
b.y + sum_i |A'y|_i D_i < 0, nothing is feasible (Farkas). What the solver says of itself, its dual
objective included, is not needed.

Mathematics: docs/mathematics.md, 5.2 and 5.3.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy import sparse

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput

try:
    import clarabel
except ModuleNotFoundError:
    raise BadInput.without('clarabel') from None

REDUCED = 1e-7
ROUNDING = 1e-15  # of the terms of a bound
SOLVED = ('Solved', 'AlmostSolved')


def solver_for(data: dict[str, Any], tolerance: float) -> clarabel.DefaultSolver:
    """Return Clarabel set up on compiled data; its A, b and q may be updated in place.

    Args:
        data: P, c, A, b and the sizes of cones, ``dims``, as a program is stated.
        tolerance: on feasibility and on the gap.
    """
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
    """Return compiled data with A'x <= b', or A'x = b', on top.

    Args:
        data: as compiled, its rows cone by cone.
        rows: A', shape (m, columns).
        offsets: b', shape (m,).
        equal: whether they are equalities.
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
    """Run a solver and return its answer, whatever its status; None if it panicked.

    Clarabel's own idea of an almost solved problem, off by up to 1e-4, is not accepted: with
    :data:`REDUCED` the word means a solution to 1e-7, which plans' checks and gaps allow for.
    """
    if out_of_time is None:
        solver.unset_termination_callback()
    else:
        solver.set_termination_callback(lambda _: out_of_time())
    try:
        return solver.solve()
    except BaseException as error:  # a panic of Rust code is no Exception
        if type(error).__name__ != 'PanicException':
            raise
        return None


class Certifier:
    """Bounds from multipliers, for programs whose data keep their shape.

    Args:
        data: as compiled; its P is symmetric, and may be scaled later.
    """

    def __init__(self, data: dict[str, Any]) -> None:
        dims, quadratic, rows = data['dims'], sparse.coo_matrix(data['P']), data['A'].tocsc()
        # Products as sums by index: making sparse matrices anew takes longer than they do.
        self._p = quadratic.data, quadratic.row, quadratic.col
        self._rows = rows.indices
        self._columns = np.repeat(np.arange(rows.shape[1]), np.diff(rows.indptr))
        self._inequalities = slice(dims.zero, dims.zero + dims.nonneg)
        sizes = np.array(dims.soc, dtype=int)
        self._heads = self._inequalities.stop + np.concatenate([[0], np.cumsum(sizes)[:-1]])
        self._heads = self._heads.astype(int) if len(sizes) else np.zeros(0, int)
        self._round_end = self._inequalities.stop + int(sizes.sum())
        self._order = dims.psd[0] if dims.psd else 0  # one for all: the LMI of SO(3)

    def lower_bound(
        self, answer: Any, a: Array, b: Array, q: Array, scale: float, largest: Array
    ) -> float:
        """Return what the multipliers of an answer prove about the optimum; -inf if nothing.

        Args:
            answer: Clarabel's, with any status.
            a: entries of A, in the order of the compiled matrix.
            b: right-hand sides.
            q: linear cost.
            scale: by which P is divided.
            largest: D, the most that each variable can be.
        """
        x, y = np.asarray(answer.x), self._dual(np.asarray(answer.z))
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            return -np.inf
        entries, rows, columns = self._p
        bent = np.bincount(rows, entries * x[columns], len(x)) / scale
        left = np.abs(bent + q + self._transposed(a, y, len(x)))
        parts = np.array([0.5 * x @ bent, b @ y, left @ largest])
        return float(-parts.sum() - ROUNDING * (np.abs(parts).sum() + np.abs(b) @ np.abs(y)))

    def refutes(self, answer: Any, a: Array, b: Array, largest: Array) -> bool:
        """Return whether the multipliers of an answer prove that nothing is feasible."""
        y = self._dual(np.asarray(answer.z))
        if not np.isfinite(y).all():
            return False
        slack = float(np.abs(self._transposed(a, y, len(largest))) @ largest)
        return float(b @ y) + slack < -ROUNDING * float(np.abs(b) @ np.abs(y))

    def _transposed(self, a: Array, y: Array, size: int) -> Array:
        """Return A'y, shape (size,), of the entries of A."""
        return np.bincount(self._columns, a * y[self._rows], size).astype(float)

    def _dual(self, z: Array) -> Array:
        """Return a point of the dual cone next to z."""
        y = z.copy()
        np.maximum(y[self._inequalities], 0.0, out=y[self._inequalities])
        if len(self._heads):
            with np.errstate(over='ignore'):  # of a solve that diverged: then nothing is proved
                squares = y[: self._round_end] ** 2
            squares[self._heads] = 0.0
            sizes = np.sqrt(np.add.reduceat(squares, self._heads))
            y[self._heads] = np.maximum(y[self._heads], sizes)
        if self._order:
            count = self._order * (self._order + 1) // 2
            _raise_to_psd(y[self._round_end :].reshape(-1, count), self._order)
        return y


def _raise_to_psd(triangles: Array, order: int) -> None:
    """Add to diagonals what matrices lack to be positive semidefinite.

    Args:
        triangles: upper triangles column by column, off the diagonal times sqrt(2), shape
            (K, order (order + 1) / 2).
        order: of the matrices.
    """
    rows, columns = np.tril_indices(order)  # of the transposes: column by column
    matrices = np.zeros((len(triangles), order, order))
    matrices[:, columns, rows] = triangles / np.where(rows == columns, 1.0, np.sqrt(2.0))
    least = np.linalg.eigvalsh(matrices, UPLO='U')[:, :1]
    triangles[:, rows == columns] -= np.minimum(least, 0.0) * (1.0 + 1e-12)


def _cones(dims: Any) -> list:
    """Return Clarabel's cones in the order of the rows."""
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
    # In-place updates need the data to keep its shape.
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
