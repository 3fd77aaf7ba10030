# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Convexity of a cost less the curvature that single steps keep for themselves.

In either arithmetic.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from orbimpc_ros.mpc.proof.arithmetic import coarse, generic, slack
from orbimpc_ros.mpc.proof.flight import set_arrival


@generic
def set_hessian(order, motion, costs, squares):
    """Set the Hessian of the cost in z_1..z_N along an axis, in the first rows of (2 N + 2, N)."""
    count = squares.shape[1]
    h, arrival, twice = squares[:count], squares[2 * count :], 2 * costs.turned
    set_arrival(motion, arrival)
    for i in range(count):
        for j in range(i + 1):
            entry = 2 * costs.braked * arrival[1, i] * arrival[1, j]
            for k in range(i, count):  # s_{k+1} sees z_{i+1} as s_N that of as many steps before
                own = arrival[0, count - 1 - k + i] * arrival[0, count - 1 - k + j]
                entry = entry + 2 * costs.weights[0, k + 1] * own
            h[i, j] = entry
    for k in range(count + 1 - order):
        last = k + order - 1  # of the differences' 1, -1 or 1, -2, 1
        for a in range(order + 1):
            for b in range(a, order + 1):
                share = (1 if a != 1 else -order) * (1 if b != 1 else -order)
                if last - b >= 0:
                    h[last - a, last - b] = h[last - a, last - b] + share * twice
    h[count - 1, count - 1] = h[count - 1, count - 1] + 2 * costs.aimed


@generic
def is_bent(shor):
    """Return whether any step of one leaf, or of all, keeps curvature for itself."""
    bent = False
    for each in shor.ravel():
        bent = bent or each > 0
    return bent


@generic
def lost(motion, ends, shor, point, work):
    """Return whether the cost less a leaf's curvature is convex, and what its tangent may lose.

    Where plans have to arrive, convex on the null space of the arrival's rows, which variables are
    eliminated by. The point may miss the arrival by rounding.

    Args:
        motion: a step's.
        ends: what is said of the end.
        shor: curvature that steps keep, shape (N,).
        point: where the tangent touches, shape (N, d).
        work: positions and velocities there, the Hessian, and what is to be written.
    """
    flown, squares, gone = work.flown, work.squares, work.gone
    count, n = squares.shape[1], flown.shape[2]
    m, arrival, zero = squares[count : 2 * count], squares[2 * count :], 0 * ends.radius
    top = zero
    if not is_bent(shor):
        return True, zero
    for i in range(count):
        for j in range(i + 1):
            m[i, j] = squares[i, j] - (shor[i] if i == j else zero)
            m[j, i] = m[i, j]
            top = max(top, abs(m[i, j]))
    gone[:] = False
    off, longest, ratio = zero, zero + 1, zero
    if ends.arrives > 0:
        set_arrival(motion, arrival)
    for r in range(ends.arrives):
        a, pivot = arrival[r], -1
        for j in range(count):
            if not gone[j] and (pivot < 0 or abs(a[j]) > abs(a[pivot])):
                pivot = j
        if pivot < 0 or a[pivot] == 0:
            continue
        for c in range(n):
            missed = flown[0, count, c] - ends.goals[count - 1, c]
            if r == 1:
                missed = flown[1, count, c] - ratio * missed
            off = off + 4 * abs(missed / a[pivot])
        ratio = arrival[1, pivot] / a[pivot]
        _eliminate(m, arrival, r, pivot, gone)
        gone[pivot] = True
    for k in range(count):
        for c in range(n):
            longest = max(longest, abs(point[k, c]))
    taken = top * count * off * (2 * n * count * (1 + longest) + off)
    return _is_convex(m, gone, slack(top) * 4 * count), taken


@generic
def _eliminate(m, arrival, r, pivot, gone):
    """Eliminate a variable from a quadratic, and from the next row of an arrival, by row r."""
    a, count = arrival[r], len(m)
    for i in range(count):
        share = a[i] / a[pivot]
        if i == pivot or gone[i]:
            continue
        for j in range(count):
            if j != pivot and not gone[j]:
                other = a[j] / a[pivot]
                both = share * m[pivot, j] + other * m[i, pivot] - share * other * m[pivot, pivot]
                m[i, j] = m[i, j] - both
    if r == 0:
        lead = arrival[1, pivot] / a[pivot]
        for i in range(count):
            if i != pivot and not gone[i]:
                arrival[1, i] = arrival[1, i] - a[i] * lead


@generic
def _is_convex(m, gone, margin):
    """Return whether a matrix without some rows is positive definite, by Cholesky's method."""
    for i in range(len(m)):
        for j in range(0 if gone[i] else i + 1):
            if gone[j]:
                continue
            entry = m[i, j] - (margin if i == j else 0 * margin)
            for k in range(j):
                if not gone[k]:
                    entry = entry - m[i, k] * m[j, k] * m[k, k]
            if i == j and not entry > 0:
                return False
            m[i, j] = coarse(entry if i == j else entry / m[j, j])
    return True
