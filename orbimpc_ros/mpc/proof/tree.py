# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Trees of a branch and bound, which prove its bound: splits, and multipliers at the leaves.

Node 0 is all trajectories. A split cuts what a *choice* may be into parts, which are its children;
a leaf has a point where a tangent of the cost touches, and multipliers. The bound of a tree is the
least of its leaves', whatever their numbers are: see :mod:`orbimpc_ros.mpc.proof.bound`.

Choices are numbered: the heading of step k is k - 1, its speed N + k - 1, and on which side of body
j it is 2 N + j N + k - 1.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem.units import Units

# Kinds of nodes: leaves, and what splits cut, into which parts; docs/proofs.md has the table.
LEAF, ARCS, CUT, SPEED, FACES, PATCHES, QUARTERS, SIDES, EMPTY = range(9)
POINTS = 4  # control points of a step that a side of a body has rows of, at most

NOWHERE: Array = np.zeros(0)
NOTHING: Array = np.zeros((0, 0, 0))  # of multipliers that are not used


class ProofTree(NamedTuple):
    """A tree in arrays: M nodes, L leaves.

    Attributes:
        nodes: of each its kind, ``LEAF``, ``EMPTY`` (its multipliers alone prove that nothing is in
            it) or that of a split; which choice is split; the first of its children, which the
            others follow, all of them after their parent; how many these are; and the row of a
            leaf in the arrays below, -1 of splits, and of parts that limits leave nothing of;
            shape (M, 5).
        at: where angles or speeds are cut, shape (M,).
        point: where tangents touch, shape (L, N, d).
        shor: b_k, curvature of the cost that step k keeps for itself, shape (L, N).
        press_end: where the multipliers of rows of each leaf end in the arrays below, shape (L,).
        press_row: 4 (choice - 2 N) + i, of control point i on the side of a choice, shape (P,);
            4 N J more, of J bodies, for each level above the leaf where that side is known.
        press: their multipliers, >= 0, shape (P,).
        pull: multipliers of an arrival s_N = g_N (and p_N = 0), shape (L, m, n); (0, 0, 0) without.
        slide: of the glide slope, shape (L, N, 3) or (0, 0, 0).
        tether: of how far R e1 moves in a step, shape (L, N, n) or (0, 0, 0).
        share: what of a step's slope is held by the limits on R e1 alone, (L, N, n) or (0, 0, 0).
        origins: from where directions of headings are counted, once around, shape (N,) [rad]; (0,)
            where attitudes say so, or none are cut before they are split into arcs.
        ordered: whether steps that can be exchanged are in the order of their directions.
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
    ordered: bool = False


ARRAYS = ProofTree._fields[:7]  # of each tree
OPTIONAL = ProofTree._fields[7:12]  # without elements where there are none
INTEGERS = 'nodes', 'press_end', 'press_row'
INTEGER, FLOAT = np.dtype(np.int64), np.dtype(np.float64)
KINDS = [INTEGER if name in INTEGERS else FLOAT for name in ARRAYS + OPTIONAL]


def one(point: Array, shor: Array, **multipliers: Array) -> ProofTree:
    """Return the tree of a single leaf.

    Args:
        point: where its tangent touches, shape (N, d).
        shor: shape (N,).
        multipliers: other arrays of the leaf, by their names, without the axis of leaves.
    """
    none = np.zeros(1, np.int64)
    known: dict[str, Any] = {name: value[None] for name, value in multipliers.items()}
    return ProofTree(
        nodes=np.zeros((1, 5), np.int64),
        at=np.zeros(1),
        point=np.ascontiguousarray(point[None]),
        shor=np.ascontiguousarray(shor[None]),
        press_end=none,
        press_row=none[:0],
        press=np.zeros(0),
        **known,
    )


def in_users_units(tree: ProofTree, units: Units) -> ProofTree:
    """Return the tree of a problem as it was posed, from that of the same in natural units."""
    cost, force = units.cost, units.cost / units.length
    known: Any = tree
    nodes, at, point, shor, end, row, press, pull, slide, tether, share, *order = known
    if pull.size:
        pull = pull * (force * np.array([1.0, units.time])[: pull.shape[1], None])
    presses = end, row, _times(press, force)
    bound = _times(slide, force), _times(tether, cost), _times(share, cost)
    return ProofTree(nodes, at, point, shor * cost, *presses, pull, *bound, *order)


def _times(values: Array, scale: float) -> Array:
    return values * scale if values.size else values


def fits(tree: ProofTree, horizon: int, n: int, width: int, arrives: int) -> bool:
    """Return whether a tree's arrays are of the kinds and shapes of a problem's.

    Args:
        tree: of any origin.
        horizon: N.
        n: dimension.
        width: d, how many coordinates of a rotation the cost sees.
        arrives: m, how many vectors an arrival is about.
    """
    arrays: Any = tree[: len(KINDS)]
    nodes, leaves, presses = len(tree.nodes), len(tree.point), tree.press.size
    vectors = leaves, horizon, n
    shapes = (
        (nodes, 5), (nodes,), (leaves, horizon, width), (leaves, horizon),
        (leaves,), (presses,), (presses,),
        (leaves, arrives, n), (leaves, horizon, 3), vectors, vectors, (horizon,),
    )  # fmt: skip
    for i, (value, kind, shape) in enumerate(zip(arrays, KINDS, shapes, strict=True)):
        if value.dtype != kind or not value.flags.c_contiguous:
            return False
        absent = i >= len(ARRAYS) and not value.size and value.ndim == len(shape)
        if not absent and value.shape != shape:
            return False
    return nodes > 0
