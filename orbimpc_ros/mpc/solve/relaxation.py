# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Interface of convex relaxations: half-spaces in, solution, bound and multipliers out.

Mathematics: docs/mathematics.md, 4.8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.solve.request import Request

HEADING = -1  # in place of a row number


class Row(NamedTuple):
    """A half-space normal . sum_k shares_k R_k e1 >= offset on a heading or a control point.

    Attributes:
        place: index: 0..N - 1 for headings, then the control points of all steps.
        shares: coefficients of R_1 e1..R_N e1, shape (N,).
        normal: unit vector, shape (n,).
        offset: less the part of the point that is fixed by the state.
        number: of the row among presses of a proof; negative for one on a heading.
    """

    place: int
    shares: Array
    normal: Array
    offset: float
    number: int = HEADING


def stacked(rows: Sequence[Row], n: int) -> tuple[np.ndarray, Array, Array]:
    """Return the places, shape (M,), the normals, shape (M, n), and the offsets, shape (M,)."""
    places = np.array([row.place for row in rows], np.int64)
    normals = np.array([row.normal for row in rows], float).reshape(-1, n)
    return places, normals, np.array([row.offset for row in rows], float)


class Multipliers(NamedTuple):
    """Multipliers at the solution of a relaxation, or the Farkas certificate of its infeasibility.

    The last four are defined as in :class:`~orbimpc_ros.mpc.proof.tree.ProofTree`.

    Attributes:
        point: minimiser of the Lagrangian in the coordinates that the cost depends on, (N, d).
        sizes: multipliers of the rows passed to ``relax``, >= 0, shape (M,).
        pull: for a terminal constraint, of s_N = g_N and p_N = 0, shape (m, n).
        slide: of the glide slope, shape (N, 3) or (0, 0).
        tether: of the limits on the motion of R e1 in a step, shape (N, n).
        share: of all other constraints on a single R_k e1 except rows, shape (N, n).
    """

    point: Array
    sizes: Array
    pull: Array
    slide: Array
    tether: Array
    share: Array


@dataclass(frozen=True)
class Relaxation:
    """The solution of a convex program with half-spaces added.

    Attributes:
        x: rotation coordinates of R_1..R_N, shape (N, d); None if the program was not solved.
        bound: dual value that belongs to ``x``; -inf if unknown, or if ``x`` is only accurate
            enough for branching. Only the verifier proves bounds.
        multipliers: None if unknown.
        empty: whether no trajectory satisfies the constraints.
    """

    x: Array | None
    bound: float
    multipliers: Multipliers | None = None
    empty: bool = False

    @property
    def is_accurate(self) -> bool:
        """Return True if the program was solved to full accuracy."""
        return self.x is not None and self.bound > -np.inf


class Relaxed(Protocol):
    """A convex program of a problem, solved repeatedly with different half-spaces."""

    def relax(
        self, request: Request, rows: Sequence[Row] = (), chords: Array | None = None
    ) -> Relaxation:
        """Solve for a state and goals within half-spaces, until the deadline.

        Data that depend only on state and goals are computed once per request.

        Args:
            request: state, goals and deadline.
            rows: half-spaces.
            chords: tighter limits on |R_{k+1} e1 - R_k e1| for the K steps where the problem bounds
                that chord, shape (K,).
        """
