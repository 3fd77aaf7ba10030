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


Left = Grounds | Tangent  # by a method, of what its bound rests on


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
