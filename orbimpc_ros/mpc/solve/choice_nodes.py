# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The nodes of a tree of choices, as searches tell of them.

What is made of them is :class:`orbimpc_ros.mpc.proof.grounds.ChoiceGrounds`.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.proof.grounds import LEAF, NO_LEANS, NO_WAYS, ChoiceGrounds, Left, tangent
from orbimpc_ros.mpc.solve.relaxation import NO_CONES

TELLING = 20  # times as long it takes to tell of a tangent as to count it
Press = tuple[int, int, float]  # the node that holds a row, which of its rows, its multiplier


class TreeLeaf(NamedTuple):
    """A tangent in the making.

    Attributes:
        point: where it touches, shape (N, d).
        presses: what holds there.
        tethers: see :class:`orbimpc_ros.mpc.proof.grounds.ChoiceGrounds`.
        empty: whether what holds proves that nothing is there.
        leans: see there.
        ways: see there.
        moves: how far headings still move from that point along a normal, shape (n,), a step times
            a column of H^-1, shape (N,); all leaves are moved at once.
    """

    point: Array
    presses: tuple[Press, ...]
    tethers: Array
    empty: bool = False
    leans: Array = NO_CONES
    ways: Array = NO_CONES
    moves: tuple[Array, float, Array] | None = None

    @property
    def is_free(self) -> bool:
        """Return whether it is a tangent to the cost alone, of headings alone."""
        held = self.presses or self.empty or self.tethers.any() or self.leans.any()
        return not held and self.point.shape[1] <= 3

    def raised(self, press: Press, column: Array, normal: Array) -> TreeLeaf:
        """Return the tangent of a point that was solved, a step on along a row.

        Args:
            press: the row, and its multiplier.
            column: what that moves headings by, H^-1 a, shape (N,).
            normal: of the row, shape (n,).
        """
        presses, moves = (*self.presses, press), (column, press[2], normal)
        known = self.tethers, self.empty, self.leans, self.ways
        return TreeLeaf(self.point, presses, *known, moves)


class ChoiceNodes:
    """What nodes are split by, and who holds what was chosen on the way to each.

    Args:
        apart: whether a leaf that is free is one with no tree.

    Attributes:
        splits: the choice that each node is split by, ``LEAF`` of leaves.
        holders: by choice that is made, at which node it was.
    """

    def __init__(self, *, apart: bool = True) -> None:
        self._apart = apart
        self.splits, self._parts, self._counts = [LEAF], [0], [0]
        self.holders: list[dict[int, int]] = [{}]

    def part(self, t: int, choice: int, count: int) -> range:
        """Split a node by a choice into so many parts, and return their numbers."""
        first = len(self.splits)
        self.splits[t], self._parts[t], self._counts[t] = choice, first, count
        self.splits += [LEAF] * count
        self._parts += [0] * count
        self._counts += [0] * count
        numbers = range(first, first + count)
        self.holders += [{**self.holders[t], choice: number} for number in numbers]
        return numbers

    def first(self, most: int) -> ChoiceNodes:
        """Return the nodes as they were before there were more than so many of them."""
        ends = [sum(each) for each in zip(self._parts, self._counts, strict=True)]  # of their parts
        count = max([1, *(end for end in ends if end <= most)])
        made, kept = ChoiceNodes(apart=self._apart), [end <= count for end in ends[:count]]
        known = (self.splits, LEAF), (self._parts, 0), (self._counts, 0)
        made.splits, made._parts, made._counts = (
            [each if whole else blank for each, whole in zip(numbers, kept, strict=False)]
            for numbers, blank in known
        )
        return made

    @property
    def leaves(self) -> list[int]:
        """Return the numbers of the nodes that are not split."""
        return [t for t, split in enumerate(self.splits) if split == LEAF]

    def grounds(self, sides: np.ndarray, leaves: Sequence[TreeLeaf]) -> Left:
        """Return the grounds that nodes and leaves are; one that is free needs no tree.

        Args:
            sides: levels and sides of the nodes, shape (2, T).
            leaves: of the nodes that are not split, in their order.
        """
        if self._apart and len(leaves) == 1 and leaves[0].is_free:
            return tangent(leaves[0].point, np.zeros(len(leaves[0].point)))
        presses = [each for leaf in leaves for each in leaf.presses]
        holders, rows, sizes = zip(*presses, strict=True) if presses else ((), (), ())
        splits, parts, counts = np.array((self.splits, self._parts, self._counts))
        holding, pressed = np.array((holders, rows), np.int64)
        levels, at = sides
        return ChoiceGrounds(
            splits,
            parts,
            counts,
            levels,
            at,
            _moved(leaves),
            np.array([leaf.empty for leaf in leaves]),
            np.cumsum([len(leaf.presses) for leaf in leaves]),
            holding,
            pressed,
            np.array(sizes, float),
            _stacked([leaf.tethers for leaf in leaves]),
            _filled([leaf.leans for leaf in leaves], NO_LEANS),
            _filled([leaf.ways for leaf in leaves], NO_WAYS),
        )


def _stacked(matrices: Sequence[Array]) -> Array:
    """Return what :func:`numpy.stack` does, several times as fast for small matrices."""
    return np.concatenate(matrices).reshape(len(matrices), *matrices[0].shape)


def _filled(matrices: Sequence[Array], none: Array) -> Array:
    """Return matrices stacked, zeros in the place of those that are empty; none if all are."""
    blank = next((np.zeros(each.shape) for each in matrices if each.size), None)
    return none if blank is None else _stacked([e if e.size else blank for e in matrices])


def _moved(leaves: Sequence[TreeLeaf]) -> Array:
    """Return where the tangents of leaves touch, shape (L, N, d)."""
    points = _stacked([leaf.point for leaf in leaves])
    raised = [i for i, leaf in enumerate(leaves) if leaf.moves]
    if raised:
        columns, steps, normals = zip(*(leaves[i].moves or () for i in raised), strict=True)
        ahead = np.array(steps)[:, None] * np.array(normals)
        points[raised, :, : ahead.shape[1]] += np.array(columns)[:, :, None] * ahead[:, None]
    return points
