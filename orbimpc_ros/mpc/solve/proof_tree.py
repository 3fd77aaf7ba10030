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
from orbimpc_ros.mpc.model.dynamics import Condensed
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.proof.splits import Cut, Region
from orbimpc_ros.mpc.proof.stated import width_of
from orbimpc_ros.mpc.proof.tree import EMPTY, LEAF, NOTHING, NOWHERE, POINTS, ProofTree
from orbimpc_ros.mpc.solve.regions import CONE, Held
from orbimpc_ros.mpc.solve.relaxation import Relaxation
from orbimpc_ros.mpc.solve.request import Request

LATE_NODES = 40  # limit for a proof written after the deadline: 2 or 3 ms


class Leaf(NamedTuple):
    """The proof of a single node: a tangent point and multipliers.

    Attributes:
        point: where the tangent touches, shape (N, d).
        share: multipliers of constraints on each R_k e1 alone, shape (N, n).
        presses: multipliers of rows on the sides of bodies: depth of the node from which on the
            side is known, number of the row, and multiplier.
        force: gradient of the terms of positions and turns, shape (N, n).
        ends: pull, slide and tether of :class:`~orbimpc_ros.mpc.proof.tree.ProofTree`.
        empty: whether the multipliers prove that the node is infeasible.
    """

    point: Array
    share: Array
    presses: tuple[tuple[int, int, float], ...]
    force: Array
    ends: tuple[Array, Array, Array]
    empty: bool

    def pressed(self, held: Held, sizes: Sequence[float], depth: int) -> Leaf:
        """Return the leaf with multipliers of half-spaces that are known from a depth on added.

        Those on headings count only if d = 9: otherwise the stage sets contain the half-spaces.
        """
        share, force, presses = self.share, self.force, list(self.presses)
        whole = self.point.shape[1] == 9
        for row, size in zip(held, sizes, strict=True):
            if not size:
                continue
            if row.number >= 0:
                presses.append((depth, row.number, size))
                force = force - size * np.outer(row.shares, row.normal)
            elif whole or row.number == CONE:
                share = share + size * np.outer(row.shares, row.normal)
        return self._replace(share=share, force=force, presses=tuple(presses))

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
        point[:, :n] += steps[best] * np.outer(moved[best], held[best].normal)
        return self._replace(point=point).pressed(held[best : best + 1], [steps[best]], depth)


class Node:
    """A node of the search tree and of the proof.

    Attributes:
        number: of the node.
        bound: lower bound of the search on the cost of its trajectories.
        above: its parent; None for the root.
        known: its region, computed when needed.
        gone: whether its region is empty.
        depth: 0 for the root.
        own: half-spaces of the split that created it.
        refuted: one of these that cannot be satisfied.
        rows: half-spaces by choice, computed when needed.
        cut: how it is split; None for a leaf.
        first: number of its first child.
        leaf: its own proof; None without multipliers.
        better: whether its own proof is at least as good as that of its parent.
    """

    def __init__(self, number: int, bound: float, above: Node | None, known: Region | None) -> None:
        self.number, self.bound, self.above, self.known = number, bound, above, known
        self.depth: int = 0 if above is None else above.depth + 1
        self.gone = False
        self.own: Held = ()
        self.refuted: Held = ()
        self.rows: dict[int, Held] | None = None
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
        problem: what is solved.
        condensed: its quadratic.
        inverse: H^-1, shape (N, N); infinite if H is singular.
        request: state and goals.
        bodies: number of bodies.
        origins: as in :class:`~orbimpc_ros.mpc.proof.tree.ProofTree`.
    """

    def __init__(
        self,
        problem: Problem,
        condensed: Condensed,
        inverse: Array,
        request: Request,
        bodies: int = 0,
        origins: Array = NOWHERE,
    ) -> None:
        self._problem, self._condensed, self._inverse = problem, condensed, inverse
        self._request, self._origins = request, origins
        self._rows = POINTS * problem.horizon * bodies  # on sides, per level of the tree
        self._stiff = bool(np.isfinite(inverse).all())

    def solved(self, relaxed: Relaxation, held: Held, depth: int) -> Leaf | None:
        """Return the proof of a node from its relaxation; None without multipliers.

        Args:
            relaxed: its solution.
            held: half-spaces of the relaxation.
            depth: of the node.
        """
        found = relaxed.multipliers
        if found is None:
            return None
        maps, tether = self._problem.maps, found.tether
        slide = found.slide if found.slide.size else np.zeros(tether.shape)
        force = tether.copy()
        force[:-1] -= tether[1:]
        if found.slide.size:
            force += maps.reach[:, 1:].T @ slide
        if len(found.pull):
            force += maps.arrival[: len(found.pull), 1:].T @ found.pull
        # The proof of an infeasible node does not involve the cost, so any point will do.
        point = self._blank().point if relaxed.empty else found.point
        leaf = Leaf(point, found.share, (), force, (found.pull, slide, tether), relaxed.empty)
        return leaf.pressed(held, found.sizes.tolist(), depth)

    def _blank(self) -> Leaf:
        """Return a leaf without multipliers."""
        problem = self._problem
        shape = problem.horizon, problem.dimension
        arrives = (1 + problem.inertial) * (problem.terminal == 'constraint')
        none: Array = np.zeros(shape)
        ends = np.zeros((arrives, problem.dimension)), none, none
        return Leaf(np.zeros((problem.horizon, width_of(problem))), none, (), none, ends, True)

    def best(self, node: Node) -> Leaf | None:
        """Return the best proof of a node; None without multipliers."""
        if node.refuted:
            return self._blank().pressed(node.refuted, [1.0], node.depth)
        if (node.leaf is not None and node.better) or node.above is None:
            return node.leaf
        above = self.best(node.above)
        if above is None or not node.own or not self._stiff:
            return above
        return above.raised(node.own, self._inverse, node.depth)

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
            if most is None and self._request.late and count > LATE_NODES:
                return self.tree(nodes, LATE_NODES)
            whole = node.cut is not None and node.first + node.cut.parts <= count
            if whole or node.gone:
                continue
            leaf = self.best(node)
            if leaf is None:
                return None
            leaves[node.number] = leaf._replace(share=self._share(leaf))
        return self._stacked(nodes[:count], leaves)

    def _share(self, leaf: Leaf) -> Array:
        """Return the part of each slope that is minimised over the set of R_k e1 separately.

        With d = 9 orbitopes hold the rest, otherwise cones and lengths; zero without any.
        """
        if leaf.point.shape[1] == 9 or not leaf.share.any():
            return leaf.share
        slopes = leaf.force - leaf.share
        if not leaf.empty:
            slopes += self._condensed.affine(self._request.state, self._request.goals)[0]
            slopes += self._condensed.hessian @ leaf.point[:, : self._problem.dimension]
        return slopes

    def _stacked(self, nodes: Sequence[Node], leaves: dict[int, Leaf]) -> ProofTree:
        numbers, at = _numbered(nodes, leaves)
        every = list(leaves.values())
        found = [
            (self._rows * (nodes[number].depth - depth) + row, size)
            for number, leaf in leaves.items()
            for depth, row, size in leaf.presses
        ]
        pull, slide, tether = zip(*(leaf.ends for leaf in every), strict=True)
        return ProofTree(
            nodes=numbers,
            at=at,
            point=np.array([leaf.point for leaf in every]),
            shor=np.zeros((len(every), self._problem.horizon)),
            press_end=np.cumsum([len(leaf.presses) for leaf in every]),
            press_row=np.array([row for row, _ in found], np.int64),
            press=np.array([size for _, size in found], float),
            pull=_used(pull),
            slide=_used(slide),
            tether=_used(tether),
            share=_used([leaf.share for leaf in every]),
            origins=self._origins,
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
