# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Proof by the faces of a polygonal floor in the plane.

Mathematics: docs/mathematics.md, 4.3, and docs/proofs.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.cells import faces
from orbimpc_ros.mpc.kernels.active_set import Quadratic, begin_cells, search, tree
from orbimpc_ros.mpc.kernels.best_first import BOUND, STALLS
from orbimpc_ros.mpc.model.condensed import Condensed, regular
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.certificate import Leaf, Tree, split_into

SATISFIED = 1e-9  # a floor missed by less is not split


class FaceProof:
    """Depth first over the faces that headings are beyond, until each part costs enough.

    Args:
        problem: in natural units, with a polygonal floor and no other limit.
        state: where plans start.
        goals: shape (N, 2).
        target: the bound to prove.
        out_of_time: polled before each part; True gives up.
    """

    most = 20_000  # leaves
    origins = None  # no directions are split

    def __init__(
        self,
        problem: Problem,
        state: State,
        goals: Array,
        target: float,
        out_of_time: Callable[[], bool],
    ) -> None:
        condensed = Condensed(problem)
        q, constant = condensed.affine(state, goals)
        hessian, self._inverse, excess = regular(condensed.hessian)
        self._table = faces(problem.floor.faces, problem.floor.fraction)
        self._quadratic = Quadratic(hessian, self._inverse, q)
        self._target = target - constant + excess
        self._room = tree(problem.horizon, 2, problem.floor.faces)
        self._leaves, self._late = 0, out_of_time

    def tree(self) -> Tree | None:
        """Return splits and leaves that prove the target; None where that takes too many."""
        return self._proved(np.full(len(self._inverse), -1, np.int32))

    def _proved(self, choice: np.ndarray) -> Tree | None:
        if self._late():
            return None
        x, bound = self._relaxed(choice)
        if bound >= self._target:
            self._leaves += 1
            return Leaf(x) if self._leaves <= self.most else None
        k = self._branching(x, choice)
        if k < 0:
            return None
        return split_into(self._beyond_faces(choice, k), k + 1)

    def _beyond_faces(self, choice: np.ndarray, k: int) -> Iterator[Tree | None]:
        """Yield what proves the part beyond each face."""
        for face in range(len(self._table.bounds)):
            chosen = choice.copy()
            chosen[k] = face
            yield self._proved(chosen)

    def _relaxed(self, choice: np.ndarray) -> tuple[Array, float]:
        """Return the minimiser of the Lagrangian where faces are chosen, and the bound there."""
        room = self._room
        begin_cells(room, self._target)
        room.choice[0] = choice
        search(self._quadratic, self._table, 0.0, 0.0, room, 1, np.inf)
        bound = -np.inf if room.counts[STALLS] else float(room.numbers[BOUND])
        return room.x.copy(), bound

    def _branching(self, x: Array, choice: np.ndarray) -> int:
        """Return the step whose floor is missed by most, as the cost has it; -1 if none is."""
        short = (self._table.bounds - x @ self._table.normals.T).min(axis=1)
        short[choice >= 0] = 0.0
        gains = np.maximum(0.0, short) ** 2 / np.diag(self._inverse)
        k = int(np.argmax(gains))
        return k if short[k] > SATISFIED else -1
