# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The proof trees of searches in machine code over faces and sectors of the plane.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.proof.tree import ARCS, CUT, NOTHING, SPEED, ProofTree

TURN = 2.0 * math.pi
NOWHERE: Array = np.zeros(0)


class Splits(NamedTuple):
    """A tree as machine code leaves it.

    Attributes:
        split: the step k by whose heading a node is split, N + k by whose speed; -1 of leaves,
            shape (T,).
        first: the first of a node's parts, which the others follow, shape (T,).
        at: where these are cut [rad], or the speed; NaN where they are the faces, shape (T,).
        point: where the tangents touch, shape (T, N, 2).
    """

    split: np.ndarray
    first: np.ndarray
    at: Array
    point: Array

    def proof(self, faces: int = 0, origins: Array = NOWHERE) -> ProofTree:
        """Return the tree as a proof.

        Args:
            faces: of the floor, 0 for a round one.
            origins: from where directions are counted, where no turn limit bounds them, shape (N,).
        """
        count, steps = self.point.shape[:2]
        inner, faced = self.split >= 0, np.isnan(self.at)
        nodes, cut = np.zeros((count, 5), np.int64), inner & ~faced & (self.split < steps)
        kind = np.where(faced, ARCS, np.where(self.split >= steps, SPEED, CUT))
        known = kind, self.split, self.first, np.where(faced, faces, 2)
        for column, values in enumerate(known):
            nodes[inner, column] = values[inner]
        nodes[:, 4] = np.where(inner, -1, np.arange(count))
        corner = -math.pi / faces if faces else 0.0
        at = np.where(inner, np.where(faced, corner, self.at), 0.0)
        ends, none = np.zeros(count, np.int64), np.zeros((0, 0))
        made = nodes, at, self.point, np.zeros((count, steps)), ends, ends[:0], at[:0]
        left = origins if cut.any() else NOWHERE
        return ProofTree(*made, NOTHING, NOTHING, NOTHING, NOTHING, none, left)


def with_ways_round(tree: ProofTree, ways: int, last: float) -> ProofTree:
    """Return a proof whose last heading is first split half-way between one way round and the next.

    Args:
        tree: a root for each way comes first.
        ways: how many there are.
        last: the first of the last headings [rad].
    """
    size = 2 * ways - 1  # of a chain of splits, with copies of the roots of trees
    chain, cuts = np.zeros((size, 5), np.int64), np.zeros(size)
    moved = tree.nodes.copy()
    moved[:, 2] += size
    for way in range(ways - 1):
        t = 2 * way
        chain[t] = CUT, tree.shor.shape[1] - 1, t + 1, 2, -1
        cuts[t] = last + TURN * way + math.pi
        chain[t + 1], cuts[t + 1] = moved[way], tree.at[way]
    chain[size - 1], cuts[size - 1] = moved[ways - 1], tree.at[ways - 1]
    nodes, at = np.concatenate([chain, moved]), np.concatenate([cuts, tree.at])
    return tree._replace(nodes=nodes, at=at)
