# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The interface of a convex program of the problem: half-spaces in, a relaxation out.

Mathematics: docs/mathematics.md, 4.8.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.proof.tree import ProofTree
from orbimpc_ros.mpc.solve.request import Request


class Point(NamedTuple):
    """A control point of the motion within a step, less what the state alone decides of it.

    Attributes:
        number: of the control points of all steps.
        row: what R_1 e1..R_N e1 add to it, shape (N,).
    """

    number: int
    row: Array


NO_PULL, NO_CONES = np.zeros(0), np.zeros((0, 0))

# What it is put on, a slot or a control point v, a unit normal and an offset: normal . v >= offset.
Halfspace = tuple[int | Point, Array, float]


@dataclass(frozen=True)
class Relaxation:
    """The optimum of a convex program with some half-spaces in force, as far as it was found.

    Attributes:
        x: rotation coordinates of R_1..R_N, shape (N, d); None if the program was not solved.
        bound: no trajectory of this relaxation costs less; -inf if nothing was proved.
        own: what the multipliers that belong to ``x`` prove, where others prove more; -inf where
            ``x`` is too inaccurate for a parabola to begin there, but good enough to branch on.
        proof: of the bound, where it needs no choices; None where it is not known.
    """

    x: Array | None
    bound: float
    own: float | None = None
    proof: ProofTree | None = None

    @property
    def dual_value(self) -> float:
        """Return the value of the dual function whose minimiser is ``x``."""
        return self.bound if self.own is None else self.own

    @property
    def is_accurate(self) -> bool:
        """Return whether the program was solved, and as accurately as a solver can."""
        return self.x is not None and self.dual_value > -np.inf


class Multipliers(NamedTuple):
    """What holds the solution of a relaxation, or proves that there is none.

    Attributes:
        point: where the Lagrangian is least: all that the cost sees of R_1..R_N, shape (N, d).
        rows: of the half-spaces asked for, then of the edges of a cone; -1 - b of a tangent to
            ball b; the first N balls hold R_1 e1..R_N e1, the others their chords, shape (S,).
        normals: of rows and tangents, shape (S, n).
        sizes: of the multipliers, >= 0, shape (S,).
        pull: of s_N - g_N, and then of p_N, where a plan has to arrive, shape (m,).
        leans: of the cones of a first turn, tilt, glide slope and approach, shape (C, n).
        props: of how far along their axes least headings are, >= 0, shape (P,).
        ways: over SO(3), along which lengths are at least what they count, no longer than 1,
            shape (N, n).
    """

    point: Array
    rows: np.ndarray
    normals: Array
    sizes: Array
    pull: Array = NO_PULL
    leans: Array = NO_CONES
    props: Array = NO_PULL
    ways: Array = NO_CONES


class Relaxed(Protocol):
    """A convex program of a problem, to be solved with half-spaces in some of its slots.

    Attributes:
        multipliers: of the last relaxation, as far as they are known; None where they are not.
        chords: how many steps a chord bounds whose multipliers are among them.
    """

    multipliers: Multipliers | None
    chords: int

    def relax(
        self,
        request: Request,
        halfspaces: Iterable[Halfspace] = (),
        chords: Array | None = None,
    ) -> Relaxation:
        """Solve for a state and goals with some slots filled, the others inert, until time is up.

        What depends on state and goals alone is worked out once for a request.

        Args:
            request: state, goals and deadline.
            halfspaces: what slots are filled with.
            chords: how far R e1 may move in the steps that a chord bounds, shape (K,), where that
                is to be less than the problem says.

        Raises:
            Infeasible: proved that no trajectory satisfies the constraints.
        """
