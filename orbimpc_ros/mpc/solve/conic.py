# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Cone programs solved by Clarabel.

    minimise  x.Px/2 + q.x   subject to   Ax + s = b,  s in K.

Mathematics: docs/mathematics.md, 4.8.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from typing import Any, NamedTuple

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
# Of equalities; of rows Ax <= b; of vectors no longer than the number before them; of matrices as
# upper triangles by columns, with off-diagonals times sqrt(2).
Zero, Positive = clarabel.ZeroConeT, clarabel.NonnegativeConeT
Round, Semidefinite = clarabel.SecondOrderConeT, clarabel.PSDTriangleConeT
Part = tuple[Any, Array, list[Any]]  # rows of A, shape (m, columns), their b, and their cones


class ConeProgram(NamedTuple):
    """The data of a cone program.

    Attributes:
        quadratic: the upper triangle of P.
        linear: q, shape (columns,).
        rows: A, shape (M, columns).
        offsets: b, shape (M,).
        cones: of which K is the product, in the order of the rows.
    """

    quadratic: sparse.csc_matrix
    linear: Array
    rows: sparse.csc_matrix
    offsets: Array
    cones: list[Any]

    def extended(self, *parts: Part) -> ConeProgram:
        """Return the program with additional rows after the others."""
        if not parts:
            return self
        every, b, more_cones = zip(*parts, strict=True)
        a, rows, offsets = self.rows, np.concatenate(every), np.concatenate([self.offsets, *b])
        columns, lines = np.nonzero(rows.T)
        more = np.bincount(columns, minlength=a.shape[1])
        at = np.repeat(a.indptr[1:], more)  # behind the other entries of each column
        entries = np.insert(a.data, at, rows[lines, columns])
        places = np.insert(a.indices, at, a.shape[0] + lines)
        ends = a.indptr + np.append(0, np.cumsum(more))
        shape = len(offsets), a.shape[1]
        return self._replace(
            rows=sparse.csc_matrix((entries, places, ends), shape=shape),
            offsets=offsets,
            cones=[*self.cones, *chain.from_iterable(more_cones)],
        )


def run(
    program: ConeProgram,
    tolerance: float,
    scale: float = 1.0,
    out_of_time: Callable[[], bool] | None = None,
) -> Any:
    """Return Clarabel's solution of a program, with any status; None if it panicked.

    By default Clarabel reports ``AlmostSolved`` at errors of up to 1e-4. With :data:`REDUCED` it
    means a solution to 1e-7, which is accurate enough for the check and the gap of a plan.

    Args:
        program: what to solve.
        tolerance: on feasibility and on the gap.
        scale: that the cost is divided by.
        out_of_time: polled at each iteration; None for no deadline.
    """
    quadratic, linear, *rows = program
    solver = clarabel.DefaultSolver(quadratic / scale, linear / scale, *rows, _settings(tolerance))
    if out_of_time is not None:
        solver.set_termination_callback(lambda _: out_of_time())
    try:
        return solver.solve()
    except BaseException as error:  # a Rust panic does not derive from Exception
        if type(error).__name__ != 'PanicException':
            raise
        return None


def _settings(tolerance: float) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    for name in ('tol_feas', 'tol_gap_abs', 'tol_gap_rel'):
        setattr(settings, name, tolerance)
        setattr(settings, f'reduced_{name}', REDUCED)
    return settings
