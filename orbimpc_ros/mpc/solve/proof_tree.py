# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The search tree and the proof written from it.

A solved node has the multipliers of its relaxation. An unsolved one has those of its parent,
improved by one dual step along a row of its own split, the gain that the search counts on.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.proof.splits import Cut, Region
from orbimpc_ros.mpc.proof.tree import EMPTY, LEAF, NOTHING, POINTS, ProofTree
from orbimpc_ros.mpc.solve.regions import CONE, Held, Regions, Rows
from orbimpc_ros.mpc.solve.relaxation import HEADING, Multipliers, Relaxation

LATE_NODES = 80  # limit for a proof written after the deadline: 1 to 3 ms


class Leaf(NamedTuple):
    """The proof of a single node, as in :class:`~orbimpc_ros.mpc.proof.tree.ProofTree`.

    Attributes:
        point: where the tangent touches, shape (N, d).
        pull: shape (m, n).
        slide: shape (N, n).
        tether: shape (N, n).
        share: with d = 9 the multipliers of constraints on each R_k e1 alone, since orbitopes hold
            the rest of the slope; otherwise the whole slope, or zero without any, shape (N, n).
        presses: multipliers of rows on the sides of bodies: depth of the node from which on the
            side is known, number of the row, and multiplier.
        empty: whether the multipliers prove that the node is infeasible.
    """

    point: Array
    pull: Array
    slide: Array
    tether: Array
    share: Array
    presses: tuple[tuple[int, int, float], ...] = ()
    empty: bool = False

    def raised(self, held: Held, inverse: Array, depth: int) -> Leaf:
        """Return the leaf after the dual step along the row of a side that gains most.

        Args:
            held: the half-spaces of the side.
            inverse: H^-1, shape (N, N).
            depth: of the node from which on they are known.
        """
        n, point = len(held[0].normal), self.point.copy()
        moved = [inverse @ row.shares for row in held]
        steep = np.array([row.shares @ way for row, way in zip(held, moved, strict=True)])
        short = [row.offset - row.shares @ point[:, :n] @ row.normal for row in held]
        steps = np.maximum(short, 0.0) / steep
        best = int(np.argmax(steps * steps * steep))
        row, step = held[best], float(steps[best])
        point[:, :n] += step * np.outer(moved[best], row.normal)
        if row.number >= 0:  # its force cancels the change of the slope
            return self._replace(point=point, presses=(*self.presses, (depth, row.number, step)))
        share = self.share
        if point.shape[1] == 9 or share.any():
            share = share + step * np.outer(row.shares, row.normal)
        return self._replace(point=point, share=share)

    def refuting(self, row: int, depth: int) -> Leaf:
        """Return the leaf of a node that is empty since a row next to a body is out of reach."""
        return Leaf._make([*map(np.zeros_like, self[:5]), ((depth, row, 1.0),), True])


class Node:
    """A node of the search tree and of the proof.

    Attributes:
        number: of the node.
        bound: lower bound of the search on the cost of its trajectories.
        region: its region; None if that is empty.
        above: its parent; None for the root.
        depth: 0 for the root.
        own: half-spaces of the split that created it.
        refuted: number of a row, among presses, that cannot be satisfied; negative without one.
        rows: half-spaces by choice, computed when needed.
        cut: how it is split; None for a leaf.
        first: number of its first child.
        leaf: its own proof; None without multipliers.
        better: whether its own proof is at least as good as that of its parent.
    """

    def __init__(
        self, number: int, bound: float, region: Region | None, above: Node | None = None
    ) -> None:
        self.number, self.bound, self.region, self.above = number, bound, region, above
        self.depth: int = 0 if above is None else above.depth + 1
        self.own: Held = ()
        self.refuted = HEADING
        self.rows: Rows | None = None
        self.cut: Cut | None = None
        self.first = 0
        self.leaf: Leaf | None = None
        self.better = False

    def __lt__(self, other: Node) -> bool:
        """Return True if this node is solved before another: of equal bounds, the newer one."""
        return (self.bound, -self.number) < (other.bound, -other.number)


class ProofWriter:
    """Writer of the proof of one request.

    Args:
        regions: of the request.
    """

    def __init__(self, regions: Regions) -> None:
        self._regions = regions
        # Rows on sides of bodies, per level of the tree.
        self._rows = POINTS * regions.problem.horizon * regions.bodies

    def solved(self, relaxed: Relaxation, held: Held, depth: int) -> Leaf | None:
        """Return the proof of a node from its relaxation; None without multipliers.

        Args:
            relaxed: its solution.
            held: half-spaces of the relaxation.
            depth: of the node.
        """
        dual = relaxed.multipliers
        if dual is None:
            return None
        # The proof of an infeasible node does not involve the cost, so any point will do.
        point = np.zeros_like(dual.point) if relaxed.empty else dual.point
        orbitope, share, force = point.shape[1] == 9, dual.share, self._force(dual)
        presses = list[tuple[int, int, float]]()
        for row, size in zip(held, dual.sizes.tolist(), strict=True):
            if not size:
                continue
            pressed = size * np.outer(row.shares, row.normal)
            if row.number >= 0:
                presses.append((depth, row.number, size))
                force -= pressed
            elif orbitope or row.number == CONE:  # stage sets contain other half-spaces on headings
                share = share + pressed
        if not orbitope and share.any():
            share = force - share
            if not relaxed.empty:
                request, condensed = self._regions.request, self._regions.condensed
                share += condensed.affine(request.state, request.goals)[0]
                share += condensed.hessian @ point
        slide = dual.slide if dual.slide.size else np.zeros(force.shape)
        return Leaf(point, dual.pull, slide, dual.tether, share, tuple(presses), relaxed.empty)

    def _force(self, dual: Multipliers) -> Array:
        """Return the slopes of turns, a glide slope and an arrival, shape (N, n)."""
        maps, force = self._regions.problem.maps, dual.tether.copy()
        force[:-1] -= dual.tether[1:]
        force += maps.arrival[: len(dual.pull), 1:].T @ dual.pull
        return force + maps.reach[:, 1:].T @ dual.slide if dual.slide.size else force

    def best(self, node: Node) -> Leaf | None:
        """Return the best proof of a node; None without multipliers."""
        if (node.leaf is not None and node.better) or node.above is None:
            return node.leaf
        above, inverse = self.best(node.above), self._regions.inverse
        if above is not None and node.refuted >= 0:
            return above.refuting(node.refuted, node.depth)
        if above is None or not node.own or inverse is None:
            return above
        return above.raised(node.own, inverse, node.depth)

    def tree(self, nodes: Sequence[Node], most: int | None = None) -> ProofTree | None:
        """Return the proof of a search tree; None if a leaf has no multipliers.

        Args:
            nodes: all nodes; the children of each follow it, one after another.
            most: use only the first nodes, at most this many, for a weaker bound; None for as
                many as there is time for.
        """
        count, leaves = len(nodes), dict[int, Leaf]()
        if most is not None:
            ends = [each.first + each.cut.parts for each in nodes if each.cut]
            count = max([1, *(end for end in ends if end <= most)])
        for node in nodes[:count]:
            if most is None and count > LATE_NODES and self._regions.request.late:
                return self.tree(nodes, LATE_NODES)
            is_split = node.cut is not None and node.first + node.cut.parts <= count
            if is_split or node.region is None:
                continue
            leaf = self.best(node)
            if leaf is None:
                return None
            leaves[node.number] = leaf
        return self._stacked(nodes[:count], leaves)

    def _stacked(self, nodes: Sequence[Node], leaves: dict[int, Leaf]) -> ProofTree:
        numbers, at = _numbered(nodes, leaves)
        every = list(leaves.values())
        presses = [
            (self._rows * (nodes[number].depth - depth) + row, size)
            for number, leaf in leaves.items()
            for depth, row, size in leaf.presses
        ]
        return ProofTree(
            nodes=numbers,
            at=at,
            point=np.array([leaf.point for leaf in every]),
            shor=np.zeros((len(every), self._regions.problem.horizon)),
            press_end=np.cumsum([len(leaf.presses) for leaf in every]),
            press_row=np.array([row for row, _ in presses], np.int64),
            press=np.array([size for _, size in presses], float),
            pull=_used([leaf.pull for leaf in every]),
            slide=_used([leaf.slide for leaf in every]),
            tether=_used([leaf.tether for leaf in every]),
            share=_used([leaf.share for leaf in every]),
            origins=self._regions.origins,
        )


def _numbered(nodes: Sequence[Node], leaves: dict[int, Leaf]) -> tuple[np.ndarray, Array]:
    """Return the arrays of nodes and of cuts of a proof."""
    numbers, at = np.zeros((len(nodes), 5), np.int64), np.zeros(len(nodes))
    numbers[:] = EMPTY, 0, 0, 0, -1  # stays for nodes with an empty region
    for i, (number, leaf) in enumerate(leaves.items()):
        numbers[number] = EMPTY if leaf.empty else LEAF, 0, 0, 0, i
    for node in nodes:
        if node.cut is not None and node.number not in leaves:
            kind, choice, parts, at[node.number] = node.cut
            numbers[node.number] = kind, choice, node.first, parts, -1
    return numbers, at


def _used(values: Sequence[Array]) -> Array:
    """Return the stacked multipliers of leaves, or an empty array if all are zero."""
    stacked = np.array(values, float)
    return stacked if stacked.size and stacked.any() else NOTHING
