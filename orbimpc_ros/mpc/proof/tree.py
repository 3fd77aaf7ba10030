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
        meet: of s_N within a radius of g_N, shape (L, n) or (0, 0).
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
    pull: Array
    slide: Array
    tether: Array
    share: Array
    meet: Array
    origins: Array = NOWHERE
    ordered: bool = False


INTEGERS = 'nodes', 'press_end', 'press_row'
MULTIPLIERS = ('pull', 'slide', 'tether', 'share')
INTEGER, FLOAT = np.dtype(np.int64), np.dtype(np.float64)
NOTHING = np.zeros((0, 0, 0))  # of multipliers that are not used


def one(point: Array, shor: Array, **multipliers: Array) -> ProofTree:
    """Return the tree of a single leaf.

    Args:
        point: where its tangent touches, shape (N, d).
        shor: shape (N,).
        multipliers: other arrays of the leaf, by their names, without the axis of leaves.
    """
    none = np.zeros(1, np.int64)
    known: dict[str, Any] = dict.fromkeys(('pull', 'slide', 'tether', 'share'), NOTHING)
    known['meet'] = np.zeros((0, 0))
    return ProofTree(
        nodes=np.zeros((1, 5), np.int64),
        at=np.zeros(1),
        point=np.ascontiguousarray(point[None]),
        shor=np.ascontiguousarray(shor[None]),
        press_end=none,
        press_row=none[:0],
        press=np.zeros(0),
        **known | {name: value[None] for name, value in multipliers.items()},
    )


def in_users_units(tree: ProofTree, units: Units) -> ProofTree:
    """Return the tree of a problem as it was posed, from that of the same in natural units."""
    cost, force = units.cost, units.cost / units.length
    timed = np.array([1.0, units.time])[: tree.pull.shape[1], None]
    scales = {'shor': cost, 'press': force, 'pull': force * timed, 'slide': force}
    scales |= {'tether': cost, 'share': cost, 'meet': force}
    every = ((name, getattr(tree, name), scale) for name, scale in scales.items())
    return tree._replace(**{name: scale * value for name, value, scale in every if value.size})


def fits(tree: ProofTree, horizon: int, n: int, width: int, arrives: int) -> bool:
    """Return whether a tree's arrays are of the kinds and shapes of a problem's.

    Args:
        tree: of any origin.
        horizon: N.
        n: dimension.
        width: d, how many coordinates of a rotation the cost sees.
        arrives: m, how many vectors an arrival is about.
    """
    nodes, leaves, presses = len(tree.nodes), len(tree.point), np.shape(tree.press)[:1]
    vectors = leaves, horizon, n
    return (
        nodes > 0
        and len(tree.origins) in (0, horizon)
        and _is(tree.nodes, INTEGER, (nodes, 5))
        and _is(tree.press_end, INTEGER, (leaves,))
        and _is(tree.press_row, INTEGER, presses)
        and _is(tree.at, FLOAT, (nodes,))
        and _is(tree.point, FLOAT, (leaves, horizon, width))
        and _is(tree.shor, FLOAT, (leaves, horizon))
        and _is(tree.press, FLOAT, presses)
        and _is(tree.origins, FLOAT, (len(tree.origins),))
        and _is(tree.pull, FLOAT, (leaves, arrives, n), optional=True)
        and _is(tree.slide, FLOAT, (leaves, horizon, 3), optional=True)
        and _is(tree.tether, FLOAT, vectors, optional=True)
        and _is(tree.share, FLOAT, vectors, optional=True)
        and _is(tree.meet, FLOAT, (leaves, n), optional=True)
    )


def _is(value: Any, kind: np.dtype, shape: tuple[int, ...], *, optional: bool = False) -> bool:
    """Return whether something is an array of a kind and a shape, or none where it is optional."""
    if not (isinstance(value, np.ndarray) and value.dtype == kind and value.flags.c_contiguous):
        return False
    return value.shape == shape or (optional and value.size == 0)
