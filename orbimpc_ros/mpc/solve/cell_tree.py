# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A search over the cells of a planar floor, in slices between which the time is looked at.

Mathematics: docs/mathematics.md, 4.3.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.cells import Table
from orbimpc_ros.mpc.kernels.active_set import (
    Quadratic,
    begin_cells,
    dive,
    search,
    splits_of,
    tree,
)
from orbimpc_ros.mpc.kernels.annulus import SLICE
from orbimpc_ros.mpc.kernels.best_first import DONE, FULL, LEAST, NODES, STALLS, VALUE
from orbimpc_ros.mpc.model.condensed import regular
from orbimpc_ros.mpc.proof.tree import ProofTree
from orbimpc_ros.mpc.solve.split_tree import Splits

FEW = 200  # nodes until a search pauses first
DIVE = 15 * SLICE  # multiplications of a dive: one comes after the deadline


class CellSearch:
    """Branch and bound for 1/2 z.Hz + q.z over headings in their disks and beyond a cell each.

    Args:
        hessian: H, positive semidefinite, shape (N, N).
        table: the cells.
        tolerance: relative gap at which a search stops.
        most: nodes of a search.
    """

    def __init__(self, hessian: Array, table: Table, tolerance: float, most: int) -> None:
        self._hessian, self._inverse, self._excess = regular(hessian)
        self._table, self._tolerance, self._most = table, tolerance, most
        self._tree = tree(len(hessian), most, max(len(table.bounds), 1))
        self._room = 0

    def begin(self, q: Array, constant: float, known: float = np.inf) -> None:
        """Begin a search.

        Args:
            q: linear terms, shape (N, 2).
            constant: what costs lack.
            known: cost, without the constant, that a trajectory is to beat.
        """
        self._quadratic = Quadratic(self._hessian, self._inverse, q)
        self._constant = constant
        self._room = 0
        begin_cells(self._tree, known)

    def run(self, out_of_time: Callable[[], bool] | None = None) -> bool:
        """Search on until that is complete, or can or may not go on; return whether it has ended.

        It pauses whenever it has solved twice as many nodes, for what it has found to be used.
        """
        if self.nodes >= self._room:
            self._room = min(self._most, max(FEW, 2 * self._room))
        asked = self._quadratic, self._table, self._constant, self._tolerance, self._tree
        while True:
            status = search(*asked, self._room, SLICE)
            if status == DONE:
                return True
            if status == FULL:
                return self._room >= self._most
            if out_of_time is not None and out_of_time():
                return False

    @property
    def nodes(self) -> int:
        """Return how many nodes have been solved."""
        return int(self._tree.counts[NODES])

    @property
    def complete(self) -> bool:
        """Return whether every node that was given up had been settled."""
        return self._tree.counts[STALLS] == 0

    @property
    def bound(self) -> float:
        """Return what no trajectory costs less than, without the constant."""
        return float(self._tree.numbers[LEAST]) - self._excess

    @property
    def value(self) -> float:
        """Return the least cost known, without the constant; inf if none is."""
        return float(self._tree.numbers[VALUE])

    @property
    def best(self) -> Array:
        """Return the best headings found, shape (N, 2)."""
        return self._tree.best.copy()

    @property
    def tangents(self) -> int:
        """Return how many tangents the bound rests on, at most."""
        return 1 + len(self._table.bounds) * self.nodes

    @property
    def proof(self) -> ProofTree:
        """Return the tree that proves the bound."""
        splits, parts, points = splits_of(self._quadratic, self._table, self._tree)
        return Splits(splits, parts, np.full(len(splits), np.nan), points).proof(
            len(self._table.bounds)
        )

    def dive(self) -> None:
        """Look for headings that satisfy the floor near the last relaxation's."""
        dive(self._quadratic, self._table, self._tree, DIVE)
