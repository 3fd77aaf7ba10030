# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Nodes and leaves of a proof in the making, and the proof of them.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.proof.tree import EMPTY, LEAF, NOTHING, ProofTree

SWEEPS = 3  # over the rows of a side, the one that raises most first, of nodes not solved
Span = tuple[float, float]  # least and greatest direction of a sector [rad]


class Row(NamedTuple):
    """A half-space a . (R_1 e1..R_N e1) >= offset of a relaxation.

    Attributes:
        place: which row of a body's side it is, as proofs number them; -1 of a heading.
        step: k - 1 of a heading whose multiplier counts; -1 where the stage set itself does.
        shares: what each R_k e1 adds to what it is a row of, shape (N,).
        normal: shape (n,).
        offset: of the half-space.
        since: which node of the search it is known from; -1 of the leaf.
    """

    place: int
    step: int
    shares: Array
    normal: Array
    offset: float
    since: int = -1


class Held(NamedTuple):
    """A leaf in the making: where its tangent touches, and multipliers.

    Attributes:
        point: shape (N, d).
        share: what limits of each R_k e1 alone hold of its slope, shape (N, n).
        presses: rows of bodies' sides, with their multipliers.
        force: what multipliers of positions and turns add to slopes, shape (N, n).
        ends: pull, slide and tether of :class:`~orbimpc_ros.mpc.proof.tree.ProofTree`.
        empty: whether the multipliers prove that nothing is there.
    """

    point: Array
    share: Array
    presses: tuple[tuple[Row, float], ...]
    force: Array
    ends: tuple[Array, Array, Array]
    empty: bool = False

    def raised(self, rows: Sequence[Row], inverse: Array) -> Held:
        """Return a tangent that is better for multipliers of a side's rows, those of others held.

        Args:
            rows: of the side.
            inverse: H^-1, shape (N, N).
        """
        n, point = len(rows[0].normal), self.point.copy()
        sizes, moved = np.zeros(len(rows)), [inverse @ row.shares for row in rows]
        steep = np.array([row.shares @ way for row, way in zip(rows, moved, strict=True)])
        short = [row.offset - row.shares @ point[:, :n] @ row.normal for row in rows]
        for i in SWEEPS * np.argsort(-(np.maximum(short, 0.0) ** 2) / steep).tolist():
            row = rows[i]
            missed = float(row.offset - row.shares @ point[:, :n] @ row.normal)
            step = max(-sizes[i], missed / steep[i])
            sizes[i] += step
            point[:, :n] += step * np.outer(moved[i], row.normal)
        made = self._replace(point=point)
        for row, size in zip(rows, sizes.tolist(), strict=True):
            made = made.pressed(row, size) if size else made
        return made

    def pressed(self, row: Row, size: float) -> Held:
        """Return the same with the multiplier of a row."""
        if row.place < 0:
            if row.step < 0:
                return self
            share = self.share.copy()
            share[row.step] += size * row.normal
            return self._replace(share=share)
        force = self.force - size * np.outer(row.shares, row.normal)
        return self._replace(presses=(*self.presses, (row, size)), force=force)


class Node:
    """A node of the proof: how it is split, what is known of its directions, what it is a part of.

    Attributes:
        kind, choice, first, count, at: see :class:`~orbimpc_ros.mpc.proof.tree.ProofTree`.
        spans: of choices in the plane, as far as they are sectors.
        of: the node of the search whose multipliers it has.
        refuted: a row that nothing of it reaches.
    """

    def __init__(self, spans: dict[int, Span], of: int, refuted: Row | None = None) -> None:
        self.kind, self.choice, self.first, self.count = LEAF, 0, 0, 0
        self.at, self.spans, self.of, self.refuted = 0.0, spans, of, refuted

    def unsplit(self) -> Node:
        """Return the node before it was split."""
        return Node(self.spans, self.of, self.refuted)


def tree_of(nodes: Sequence[Node], leaves: Mapping[int, Held]) -> ProofTree:
    """Return the proof that nodes are, with the leaves of those that are not split."""
    rows = np.full(len(nodes), -1)
    rows[list(leaves)] = np.arange(len(leaves))
    for place, leaf in leaves.items():
        if leaf.empty:
            nodes[place].kind = EMPTY
    numbers = [(node.kind, node.choice, node.first, node.count) for node in nodes]
    every = list(leaves.values())
    presses = [press for leaf in every for press in leaf.presses]
    pull, slide, tether = zip(*(leaf.ends for leaf in every), strict=True)
    return ProofTree(
        nodes=np.column_stack([np.array(numbers, np.int64), rows]),
        at=np.array([node.at for node in nodes]),
        point=np.array([leaf.point for leaf in every]),
        shor=np.zeros((len(every), len(every[0].point))),
        press_end=np.cumsum([len(leaf.presses) for leaf in every]),
        press_row=np.array([row.place for row, _ in presses], np.int64),
        press=np.array([size for _, size in presses], float),
        pull=_used(pull),
        slide=_used(slide),
        tether=_used(tether),
        share=_used([leaf.share for leaf in every]),
        meet=np.zeros((0, 0)),
    )


def _used(values: Sequence[Array]) -> Array:
    """Return multipliers of leaves stacked; none where all are zero."""
    stacked = np.array(values, float)
    return stacked if stacked.size and stacked.any() else NOTHING
