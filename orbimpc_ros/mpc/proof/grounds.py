# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What a method's lower bound rests on, as it leaves the method: tangents, and the parts they hold.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array

LEAF = -1  # in the place of the step that a node is split by
NO_PULLS, NO_STIFFNESS = np.zeros((0, 0)), np.zeros(0)
NO_LEANS = NO_WAYS = np.zeros((0, 0, 0))


class Grounds(NamedTuple):
    """A tree in arrays: what is split has parts, which together hold all that it does.

    Node 0 stands for all trajectories. A node that is not split is a leaf, and has a tangent to
    the cost.

    Attributes:
        splits: the step k, 0..N-1, by whose heading a node is split, N + k by whose speed, ``LEAF``
            of leaves, shape (T,).
        parts: the first of a node's parts, which the others follow, shape (T,).
        angles: that part the directions of that step [rad], or its speeds; NaN where the faces of
            the floor do, shape (T,).
        points: where the tangents touch, shape (T, N, d): R_k e1, all of it that the cost sees.
        bends: what is added to the curvature of each step, in natural units, shape (T, N).
        origins: from where directions are counted, once around, where no turn limit says how far
            they are from the attitude's, shape (N,) [rad].
        pulls: multipliers of s_N - g_N, and then of p_N, where plans have to arrive, shape (T, m).
        stiffness: weight on half the square of these, shape (T,).
    """

    splits: np.ndarray
    parts: np.ndarray
    angles: Array
    points: Array
    bends: Array
    origins: Array
    pulls: Array = NO_PULLS
    stiffness: Array = NO_STIFFNESS


class ChoiceGrounds(NamedTuple):
    """A tree of choices in arrays: beyond which faces headings are, on which sides bodies.

    Node 0 stands for all trajectories. A node that is not split is a leaf, and has a tangent to
    the cost with what holds there added, by multipliers, or multipliers that prove it empty. They
    are in natural units. Which choices there are, and what their sides ask for, is for whoever
    counts the bound again to say (:mod:`orbimpc_ros.mpc.proof.sides`).

    Attributes:
        splits: the choice that a node is split by, ``LEAF`` of leaves, shape (T,).
        parts: the first of a node's parts, which the others follow, shape (T,).
        counts: how many parts there are; sides that nothing reaches have none, shape (T,).
        levels: how often the quarter of a circle was halved that a node is of, shape (T,).
        sides: which it is then, from the x axis on, or which side or face, shape (T,).
        points: where the tangents of the leaves touch, shape (L, N, n).
        empty: which of the leaves nothing is in, shape (L,).
        ends: where the multipliers of each leaf end, shape (L,).
        holders: nodes whose side a row belongs to; 0 for what always holds, shape (E,).
        rows: which of its rows, shape (E,).
        presses: their multipliers, >= 0, shape (E,).
        tethers: multipliers of how far R e1 moves in a step, shape (L, K, n).
        leans: multipliers of what lies in cones, vectors that come to no less than nothing with
            all of a cone, shape (L, C, n).
        ways: over SO(3), along which a length is at least what it counts, no longer than 1, shape
            (L, N, n); none where no length is told of.
    """

    splits: np.ndarray
    parts: np.ndarray
    counts: np.ndarray
    levels: np.ndarray
    sides: np.ndarray
    points: Array
    empty: np.ndarray
    ends: np.ndarray
    holders: np.ndarray
    rows: np.ndarray
    presses: Array
    tethers: Array
    leans: Array = NO_LEANS
    ways: Array = NO_WAYS


class Tangent(NamedTuple):
    """A tangent to the cost that needs no split, over SO(3) or with what pulls at its end.

    Methods leave it in natural units, proofs have it in those of the problem as it was posed.

    Attributes:
        point: where it touches, coordinates of R_1..R_N, shape (N, d).
        bends: what is added to the curvature of each step, shape (N,).
        pull: multipliers of s_N - g_N, and then of p_N, where a plan has to arrive, shape (m,).
        stiffness: weight on half the square of these.
        tops: over SO(3), the largest value of each step's -<G, R>, shape (N,).
        ways: over SO(3), along which a length is at least what it counts, no longer than 1,
            shape (N, n).
    """

    point: Array
    bends: Array
    pull: Array
    stiffness: float
    tops: Array
    ways: Array


Left = ChoiceGrounds | Grounds | Tangent  # by a method, of what its bound rests on


def is_array(value: object, kind: type, *shape: int) -> bool:
    """Return whether a value is an array that machine code may go through, of a kind and shape."""
    return (
        isinstance(value, np.ndarray)
        and value.dtype == kind
        and value.shape == shape
        and value.flags.c_contiguous
    )


def fits(left: Left, count: int, n: int, width: int) -> bool:
    """Return whether what a method left is arrays of a problem's kinds and shapes.

    Args:
        left: by the method.
        count: N.
        n: dimension.
        width: how many coordinates of a rotation the cost sees.
    """
    if isinstance(left, Tangent):
        sizes = (left.point, (count, width)), (left.bends, (count,)), (left.tops, (count,))
        told = (left.pull, np.shape(left.pull)[:1]), (left.ways, (count, n))
        return all(is_array(each, float, *shape) for each, shape in (*sizes, *told))
    nodes = len(left.splits)
    if not (nodes and is_array(left.parts, np.int64, nodes)):
        return False
    if not is_array(left.splits, np.int64, nodes) or (left.parts[left.splits >= 0] >= nodes).any():
        return False
    if isinstance(left, Grounds):
        cells = (left.points, (nodes, count, width)), (left.bends, (nodes, count))
        along = (left.angles, (nodes,)), (left.origins, (count,))
        pulls = (
            (left.pulls, np.shape(left.pulls)[:2]),
            (left.stiffness, np.shape(left.stiffness)[:1]),
        )
        return all(is_array(each, float, *shape) for each, shape in (*cells, *along, *pulls))
    leaves, rows, words = (
        len(left.points),
        len(left.presses),
        (left.counts, left.levels, left.sides),
    )
    tied, leant = (np.shape(each)[1:2] or (0,) for each in (left.tethers, left.leans))
    numbers = (
        (left.points, (leaves, count, width)),
        (left.presses, (rows,)),
        (left.tethers, (leaves, *tied, n)),
        (left.leans, (leaves, *leant, n) if np.size(left.leans) else (0, 0, 0)),
        (left.ways, (leaves, count, n) if np.size(left.ways) else (0, 0, 0)),
    )
    return (
        all(is_array(each, np.int64, nodes) for each in words)
        and is_array(left.empty, bool, leaves)
        and is_array(left.ends, np.int64, leaves)
        and all(is_array(each, np.int64, rows) for each in (left.holders, left.rows))
        and all(is_array(each, float, *shape) for each, shape in numbers)
    )


UNSPLIT = np.array([LEAF])
NO_PARTS, NO_ANGLES = np.zeros(1, np.int64), np.zeros(1)


def tangent(point: Array, bends: Array) -> Grounds:
    """Return the grounds of a bound that needs no split.

    Args:
        point: where the cost's tangent touches, shape (N, d).
        bends: what is added to the curvature of each step, in natural units, shape (N,).
    """
    touched = np.ascontiguousarray(point[None])
    return Grounds(UNSPLIT, NO_PARTS, NO_ANGLES, touched, bends[None], np.zeros(len(point)))
