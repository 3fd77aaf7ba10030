# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Proof trees of a branch and bound: splits, and multipliers at the leaves.

Node 0 is the set of all trajectories. A split divides the range of a *choice* into parts, its
children. A leaf has a tangent point of the cost, and multipliers. The bound of a tree is the least
of its leaves' bounds, and is valid for any numbers: see :mod:`orbimpc_ros.mpc.proof.bound`.

Choices are numbered: the heading of step k is k - 1, its speed N + k - 1, and its side of body j
is 2 N + j N + k - 1.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array

# Kinds of nodes: leaves, and splits by the kind of their parts; docs/proofs.md has the table.
LEAF, ARCS, CUT, SPEED, FACES, PATCHES, QUARTERS, SIDES, EMPTY = range(9)
KIND, CHOICE, CHILD, CHILDREN, ROW = range(5)  # columns of a tree's nodes
POINTS = 4  # rows of a step for a side of a body, one per control point, at most

NOWHERE: Array = np.zeros(0)
NOTHING: Array = np.zeros((0, 0, 0))  # for unused multipliers


class ProofTree(NamedTuple):
    """A tree in arrays: M nodes, L leaves.

    Attributes:
        nodes: the kind of each node, ``LEAF``, ``EMPTY`` (multipliers alone prove that the leaf is
            empty) or that of a split; the choice that is split; the first of its children, which
            are consecutive and come after their parent; the number of children; and the row of a
            leaf in the arrays below, -1 for splits and for parts that are empty by the limits;
            shape (M, 5).
        at: angle or speed at which a node is cut, shape (M,).
        point: tangent points, shape (L, N, d).
        shor: b_k, curvature of the cost that is assigned to step k alone, shape (L, N).
        press_end: end of each leaf's row multipliers in the arrays below, shape (L,).
        press_row: 4 (choice - 2 N) + i for control point i on the side of a choice, shape (P,);
            plus 4 N J, with J bodies, for each level above the leaf whose side is meant.
        press: their multipliers, >= 0, shape (P,).
        pull: multipliers of an arrival s_N = g_N (and p_N = 0), shape (L, m, n); (0, 0, 0) without.
        slide: of the glide slope, shape (L, N, 3) or (0, 0, 0).
        tether: of the limit on the chord of R e1 in a step, shape (L, N, n) or (0, 0, 0).
        share: part of a step's slope to bound by the limits on R e1 alone, (L, N, n) or (0, 0, 0).
        origins: least direction of the headings, N times the same [rad], if exchangeable steps are
            in the order of their directions; (0,) if they are not.
    """

    nodes: np.ndarray
    at: Array
    point: Array
    shor: Array
    press_end: np.ndarray
    press_row: np.ndarray
    press: Array
    pull: Array = NOTHING
    slide: Array = NOTHING
    tether: Array = NOTHING
    share: Array = NOTHING
    origins: Array = NOWHERE


ARRAYS = ProofTree._fields[:7]  # in every tree
OPTIONAL = ProofTree._fields[7:]  # empty if unused
INTEGERS = 'nodes', 'press_end', 'press_row'
KINDS = [np.dtype(np.int64 if name in INTEGERS else float) for name in ProofTree._fields]


def one(point: Array, shor: Array, **multipliers: Array) -> ProofTree:
    """Return the tree of a single leaf.

    Args:
        point: tangent point, shape (N, d).
        shor: shape (N,).
        multipliers: other arrays of the leaf, by name, without the axis of leaves.
    """
    known = {'point': point, 'shor': shor, **multipliers}
    arrays: dict[str, Any] = {n: np.ascontiguousarray(each[None]) for n, each in known.items()}
    none = np.zeros(1, np.int64)
    return ProofTree(
        nodes=np.zeros((1, 5), np.int64),
        at=np.zeros(1),
        press_end=none,
        press_row=none[:0],
        press=np.zeros(0),
        **arrays,
    )
