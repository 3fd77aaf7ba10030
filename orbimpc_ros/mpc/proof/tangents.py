# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The bound of one tangent: over SO(3), from a body rate on, and where plans have to arrive.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.proof.slopes import ROUNDING, lack, lack_arriving, least_along, set_slopes

STEPS = 40  # of Newton's method
DOUBLE = 1e-3  # of a cube: a root whose polynomial rises so slowly is nearly a double one
FLAT = 1e-15  # of a fourth power, that is no more than rounding


@compiled
def tangents_bound(terms, curvature, start, goals, leaf, coasting):
    """Return what a tangent proves; -inf where it proves nothing.

    Args:
        terms: the problem.
        curvature: of its cost over one coordinate: see :func:`lack_arriving`.
        start: p_0, the disturbance, R_0, R_g and, at order 2, what decides R_1, shape (5, d).
        goals: g_1..g_N less s_0, shape (N, n).
        leaf: the tangent.
        coasting: whether R_1 is what decides it, or any share of that.
    """
    point, bends, curved, reach = leaf.point, leaf.bends, False, 0.0
    count, n, slopes = len(point), goals.shape[1], np.empty(point.shape)
    arrival = leaf.pull, leaf.stiffness
    value, size = set_slopes(terms, start, goals, arrival, point, slopes)
    for k in range(count):
        bend, square, along = bends[k], 0.0, 0.0
        for c in range(point.shape[1]):
            slopes[k, c] += bend * point[k, c]
            along += slopes[k, c] * point[k, c]
            square += point[k, c] * point[k, c]
        if k == 0 and terms.order == 2:
            decided = start[4], terms.floor[0], coasting
            least = least_decided(slopes[0], terms.lengths[1], n, decided)
        elif point.shape[1] == 9:
            rest = share_length(slopes[k], leaf.ways[k], terms.lengths[k + 1], terms.floor[0])
            least = rest + least_over_orbitope(slopes[k], leaf.tops[k])
            size += rest
        else:
            rise = terms.lengths[k + 1] - vector_size(slopes[k], n)
            least = least_along(rise, bend, terms.floor[0])
        value += 0.5 * bend * square - along + least
        size += abs(bend) * square + abs(along) + abs(least)
        curved |= bend < 0.0
        reach += 1.0 + square
        if bend != 0.0 and (point.shape[1] == 9 or terms.order == 2):
            return -np.inf  # beyond what is known
    if curved:
        value -= lack_arriving(curvature, bends, 1.0, leaf.stiffness) * reach
    value += terms.lengths[0] * vector_size(start[2], n)
    value -= ROUNDING * count * size
    return value if value > -np.inf else -np.inf  # or no number


@compiled
def vector_size(vector, n):
    """Return the size of the first n coordinates."""
    square = 0.0
    for c in range(n):
        square += vector[c] * vector[c]
    return np.sqrt(square)


@compiled
def least_decided(slope, length, n, decided):
    """Return the least slope . x + l |x e1| where x is decided, or any share of what is.

    Args:
        slope: shape (d,), or shape (n,) of what is along x e1 alone.
        length: l.
        n: dimension.
        decided: x; the floor's speed, that no share is slower than; whether shares are allowed.
    """
    x, floor, coasting = decided
    speed = vector_size(x, n)
    most = length * speed
    for c in range(len(slope)):
        most += slope[c] * x[c]
    if not coasting or speed <= floor:
        return most
    return min(most, floor / speed * most)


@compiled
def share_length(slope, way, length, least):
    """Add to a slope that of l way . R e1, and return what l |R e1| comes to beyond that.

    That is l (1 - |way|) |R e1|, of no less than the floor's speed.
    """
    size = vector_size(way, len(way))
    share = length / max(1.0, size)
    for c in range(len(way)):
        slope[c] += share * way[c]
    return (length - share * size) * least


@compiled
def least_over_orbitope(slope, top):
    """Return the least <G, R> over conv SO(3): -top, where top I + K(G) is semidefinite."""
    return -top - lack(_turned(slope, top), np.zeros(4), 0.0)


@compiled
def top_of(slope):
    """Return a top for which top I + K(G) is all but semidefinite: no less is any use.

    It is the largest root of the polynomial of -K(G), that for B = -G is
    t^4 - 2 |B|^2 t^2 - 8 det(B) t + |B|^4 - 4 |cof B|^2: Newton's method comes down to it from
    above. Where it is nearly a double one, that is slow.
    """
    square, cofactors, volume = 0.0, 0.0, 0.0
    for i in range(9):
        square += slope[i] * slope[i]
    for c in range(3):
        i, j = 3 * ((c + 1) % 3), 3 * ((c + 2) % 3)
        for r in range(3):
            at, after = (r + 1) % 3, (r + 2) % 3
            each = slope[i + at] * slope[j + after] - slope[i + after] * slope[j + at]
            cofactors += each * each
            volume -= slope[3 * c + r] * each / 3.0
    top = np.sqrt(3.0 * square)
    for _ in range(STEPS):
        rise = 4.0 * (top * (top * top - square) - 2.0 * volume)
        if rise <= DOUBLE * top * top * top:
            break
        value = (top * top - square) ** 2 - 8.0 * volume * top - 4.0 * cofactors
        if value <= FLAT * square * square:
            return top
        top -= value / rise
    return -np.linalg.eigvalsh(_turned(slope, 0.0))[0]


@compiled
def _turned(slope, top):
    """Return top I + K(G), shape (4, 4)."""
    matrix = np.empty((4, 4))
    for i in range(4):
        matrix[i, i] = top
        for c in range(3):  # of x11, x22, x33: 0 and the one after it have their sign
            matrix[i, i] += slope[4 * c] if i in (0, c + 1) else -slope[4 * c]
    for c in range(3):
        i, j = (c + 1) % 3, (c + 2) % 3
        upper, lower = slope[3 * j + i], slope[3 * i + j]  # x_ij and x_ji
        matrix[0, c + 1] = matrix[c + 1, 0] = lower - upper
        matrix[i + 1, j + 1] = matrix[j + 1, i + 1] = lower + upper
    return matrix
