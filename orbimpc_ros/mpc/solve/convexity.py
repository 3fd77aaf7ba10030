# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What makes a tangent's cost convex for all headings, where it is for those that arrive.

A tangent proves a bound if the cost with its bends is convex. Headings z with a z = b need that on
the null space of a alone; a weight on |a z - b|^2, which costs them nothing, makes up for the rest.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.kernels.annulus import mirror, reflect
from orbimpc_ros.mpc.kernels.linear import solve_spd
from orbimpc_ros.mpc.proof.tree import ProofTree, one

LEAST = 1e-9  # of the largest curvature, on the null space: the weight grows as it falls
SPARE = 2.0  # times the least weight that makes convex
SHIFT = 1e-15  # a step: of the largest curvature, what rounding may hide of another
GROWTH, HALVINGS = 16.0, 8  # of shifts that are tried for want of convexity
MARGIN = 1e-13  # of the largest curvature, for each step, that convexity is verified with


@compiled
def _is_convex(hessian, bends, unit, e, factor):
    """Return whether Hessian, bends and e I are positive definite, by Cholesky's method."""
    for i in range(len(hessian)):
        for j in range(i + 1):
            total = hessian[i, j]
            if i == j:
                total += unit * bends[i] + e
            for m in range(j):
                total -= factor[i, m] * factor[j, m]
            if i > j:
                factor[i, j] = total / factor[j, j]
            elif total > 0.0:
                factor[i, i] = np.sqrt(total)
            else:
                return False
    return True


@compiled
def lack(hessian, bends, unit):
    """Return an e >= 0 such that Hessian, bends and e I are positive semidefinite; inf for none."""
    top, count = 0.0, len(hessian)
    for k in range(count):
        top = max(top, np.abs(hessian[k]).max() + unit * abs(bends[k]))
    if top == 0.0:
        return 0.0
    factor = np.empty(hessian.shape)
    rounding = SHIFT * count * top
    e = rounding
    while not _is_convex(hessian, bends, unit, e, factor):
        if not e < count * top:  # from where on the diagonal dominates, unless there are NaN
            return np.inf
        e *= GROWTH
    if e > rounding:
        least = e / GROWTH
        for _ in range(HALVINGS):
            middle = np.sqrt(least * e)
            if _is_convex(hessian, bends, unit, middle, factor):
                e = middle
            else:
                least = middle
    return e + rounding


@compiled
def stiffened(hessian, arrival, left, z, bends, pull):
    """Set a tangent up that is convex for all headings; return how stiff its arrival is.

    Turned so that a is the first axis, the matrix has a Schur complement there, which the weight
    makes up for. Bends are raised where the rest is next to singular.

    Args:
        hessian: of the cost, shape (N, N).
        arrival: a, shape (N,).
        left: b, shape (n,).
        z: where the tangent touches, shape (N, n), which is made to arrive.
        bends: shape (N,), raised as it takes.
        pull: multipliers of the arrival, shape (n,), less what stiffness pulls by itself.
    """
    (count, n), matrix, square = z.shape, hessian.copy(), (arrival**2).sum()
    for c in range(n):
        missed = (arrival * z[:, c]).sum() - left[c]
        z[:, c] -= missed / square * arrival
    for k in range(count):
        matrix[k, k] += bends[k]
    least, reflector = LEAST * np.abs(matrix).max(), np.empty(count)
    reflect(arrival.copy().reshape((count, 1)), count, 0, reflector)
    mirror(matrix, count, reflector)
    mirror(matrix.T, count, reflector)
    across, free = matrix[1:, 0].copy(), matrix[1:, 1:].copy()
    raised = lack(free, np.full(count - 1, -least), 1.0) if count > 1 else 0.0
    for k in range(count):
        bends[k] += raised
    for k in range(count - 1):
        free[k, k] += raised
    share = across.copy()
    if not solve_spd(free, share, count - 1):
        return 0.0
    stiffness = max(0.0, SPARE * (across @ share) - matrix[0, 0] - raised) / square
    for c in range(n):
        pull[c] -= stiffness * ((arrival * z[:, c]).sum() - left[c])
    return stiffness


class Tangent(NamedTuple):
    """A tangent to the cost with Shor multipliers, in natural units.

    Attributes:
        point: where it touches, shape (N, n).
        shor: curvature of the cost that each step keeps for itself, shape (N,).
        pull: multipliers of an arrival, shape (n,); (0,) without.
    """

    point: Array
    shor: Array
    pull: Array

    def proof(self) -> ProofTree:
        """Return the tree of a single leaf."""
        pull = {'pull': self.pull[None]} if len(self.pull) else {}
        return one(self.point, self.shor, **pull)


def tangent(
    hessian: Array, arrival: Array, left: Array, z: Array, bends: Array, pull: Array
) -> Tangent:
    """Return the tangent of multipliers, the cost being convex with what they add to it.

    Args:
        hessian: of the cost, shape (N, N).
        arrival: a, shape (N,): headings arrive where a z = b.
        left: b, shape (n,); (0,) where they need not.
        z: where it touches, shape (N, n).
        bends: multipliers of the moduli, shape (N,).
        pull: multipliers of the arrival, shape (n,).
    """
    if not (bends < 0.0).any():
        return Tangent(z.copy(), -bends, pull.copy())
    z, bends, pull = z.copy(), bends.copy(), pull.copy()
    if len(left):
        stiffness = float(stiffened(hessian, arrival, left, z, bends, pull))
        pull += stiffness * (arrival @ z - left)
    else:
        bends += lack(hessian, bends, 1.0)
    return Tangent(z, -bends - MARGIN * len(z) * max(1.0, float(np.abs(bends).max())), pull)
