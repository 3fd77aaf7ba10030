"""A search over the cells of a planar floor, in slices between which the time is looked at."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.cells import Table
from orbimpc_ros.mpc.kernels.active_set import (
    DONE,
    FULL,
    LEAST,
    NODES,
    STALLS,
    VALUE,
    Quadratic,
    begin,
    dive,
    search,
    tree,
)
from orbimpc_ros.mpc.kernels.annulus import SLICE
from orbimpc_ros.mpc.model.condensed import regular

FEW = 200  # nodes to have room for at first


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
        self._tree = tree(len(hessian), min(FEW, most), max(table.roots, 2))

    def begin(self, q: Array, constant: float, known: float = np.inf) -> None:
        """Begin a search.

        Args:
            q: linear terms, shape (N, 2).
            constant: what costs lack.
            known: cost, without the constant, that a trajectory is to beat.
        """
        self._quadratic = Quadratic(self._hessian, self._inverse, q)
        self._constant = constant
        begin(self._tree, known)

    def run(self, out_of_time: Callable[[], bool] | None = None) -> bool:
        """Search on until that is complete, or can or may not go on; return whether it has ended.

        It pauses when there is no room for another node: whoever calls it again gives it more.
        """
        if self.nodes >= len(self._tree.active) - 1:
            self._grow()
        while True:
            status = search(
                self._quadratic, self._table, self._constant, self._tolerance, self._tree, SLICE
            )
            if status == DONE:
                return True
            if status == FULL:
                return len(self._tree.active) > self._most
            if out_of_time is not None and out_of_time():
                return False

    def _grow(self) -> None:
        nodes = min(self._most, 2 * (len(self._tree.active) - 1))
        self._tree = self._tree.grown(nodes, max(self._table.roots, 2))

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
    def last(self) -> Array:
        """Return the headings of the last relaxation, shape (N, 2)."""
        return self._tree.x.copy()

    def beat(self, cost: float) -> None:
        """Look for nothing from now on but what costs less, without the constant."""
        numbers = self._tree.numbers
        numbers[VALUE], numbers[LEAST] = min(self.value, cost), min(self._tree.numbers[LEAST], cost)

    def dived(self) -> Array:
        """Return headings that satisfy the floor, shape (N, 2), near the last relaxation's."""
        x = self.last
        dive(self._quadratic, self._table, x)
        return x
