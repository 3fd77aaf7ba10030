# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The interface of a convex program of the problem: half-spaces in, a relaxation out.

Mathematics: docs/mathematics.md, 4.8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.solve.request import Request


class Row(NamedTuple):
    """A half-space normal . (what R_1 e1..R_N e1 add to a place) >= offset.

    Attributes:
        place: 0..N - 1 of headings, then the control points of all steps.
        shares: of R_1 e1..R_N e1 in it, shape (N,).
        normal: unit vector, shape (n,).
        offset: of what the state alone decides taken off.
    """

    place: int
    shares: Array
    normal: Array
    offset: float


class Multipliers(NamedTuple):
    """What holds the solution of a relaxation, or proves that there is none.

    All but the point and the sizes are as :class:`~orbimpc_ros.mpc.proof.tree.ProofTree` has them.

    Attributes:
        point: where the Lagrangian is least: all that the cost sees of R_1..R_N, shape (N, d).
        sizes: of the multipliers of the rows that were asked for, >= 0, shape (M,).
        pull: of s_N - g_N, and then of p_N, where a plan has to arrive, shape (m, n).
        slide: of the glide slope, shape (N, 3) or (0, 0).
        tether: of how far R e1 moves in a step, shape (N, n).
        share: of what else holds a single R_k e1, but for rows, shape (N, n).
    """

    point: Array
    sizes: Array
    pull: Array
    slide: Array
    tether: Array
    share: Array


@dataclass(frozen=True)
class Relaxation:
    """The optimum of a convex program with some half-spaces in force, as far as it was found.

    Attributes:
        x: rotation coordinates of R_1..R_N, shape (N, d); None if the program was not solved.
        bound: the value of the dual function whose minimiser is ``x``; -inf where that is not
            known, or ``x`` is only accurate enough to branch on. The verifier alone proves bounds.
    """

    x: Array | None
    bound: float

    @property
    def is_accurate(self) -> bool:
        """Return whether the program was solved, and as accurately as a solver can."""
        return self.x is not None and self.bound > -np.inf


class Relaxed(Protocol):
    """A convex program of a problem, to be solved with any half-spaces on its places.

    Attributes:
        multipliers: of the last relaxation, as far as they are known; None where they are not.
    """

    multipliers: Multipliers | None

    def relax(
        self, request: Request, rows: Sequence[Row] = (), chords: Array | None = None
    ) -> Relaxation:
        """Solve for a state and goals within half-spaces, until time is up.

        What depends on state and goals alone is worked out once for a request.

        Args:
            request: state, goals and deadline.
            rows: half-spaces.
            chords: how far R e1 may move in the steps that a chord bounds, shape (K,), where that
                is to be less than the problem says.

        Raises:
            Infeasible: proved that no trajectory satisfies the constraints.
        """
