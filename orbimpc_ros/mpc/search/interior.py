# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The relaxation of a node by an interior-point method, for costs that couple steps stiffly.

If curvatures of the cost differ by factors of a million, as for a catch whose weights are almost
all terminal, methods that move or project headings one by one make hardly any progress. This one
moves all headings at once, through the interior of the sets.

Mathematics: docs/mathematics.md, 4.3.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.search.ring import KIND, LX, LY, NARROW, NB, NX, NY, OUTER, UX, UY

STEPS = 25
CENTRED, BLOCKED = 0.1, 0.5  # shares of the gap to aim for, after a long step and a short one
LONG = 0.9
INSIDE = 0.99  # share of the way to a limit that a step may take
THIN = 1e-9  # least size of a set with an interior
SHORT = 1e-4  # smoothing of the length of headings near zero
HELD = 1e12  # factor on the curvature, to hold headings whose sets have no interior
TINIEST = 1e-300
LIMITS = 4  # limits of a set: speed, both edges, chord


@compiled
def _depths(shape, x, y, depths, normals):
    """Set a point's depths inside of the limits, and the inward normals; return their number."""
    depths[0] = 0.5 * (shape[OUTER] ** 2 - x * x - y * y)
    normals[0, 0], normals[0, 1] = -x, -y
    if shape[KIND] < NARROW:
        return 1
    normals[1, 0], normals[1, 1] = -shape[LY], shape[LX]
    normals[2, 0], normals[2, 1] = shape[UY], -shape[UX]
    normals[3, 0], normals[3, 1] = shape[NX], shape[NY]
    for i in range(1, LIMITS):
        depths[i] = normals[i, 0] * x + normals[i, 1] * y
    depths[3] -= shape[NB]
    return LIMITS


@compiled
def set_inside(shapes, z):
    """Move headings to the middle of sets that have an interior; return the number of limits."""
    count = 0
    for k in range(len(z)):
        shape, nearest = shapes[k], 0.0
        if shape[KIND] < NARROW:
            z[k, 0], z[k, 1] = 0.5 * z[k, 0], 0.5 * z[k, 1]
            count += 1
            continue
        x, y = shape[LX] + shape[UX], shape[LY] + shape[UY]
        size = max(THIN, np.sqrt(x * x + y * y))
        x, y = x / size, y / size
        across = shape[LX] * y - shape[LY] * x
        nearest = shape[NB] / max(THIN, shape[NX] * x + shape[NY] * y)
        if across > THIN and shape[OUTER] - nearest > THIN:
            size = 0.5 * (nearest + shape[OUTER])
            z[k, 0], z[k, 1] = size * x, size * y
            count += LIMITS
    return count


@compiled
def set_system(posed, shapes, z, slope, multipliers, aim, system, right):
    """Set Newton's system: stationarity of the cost, and depths times multipliers equal to ``aim``.

    Args:
        posed: the problem.
        shapes: outlines, shape (N, 12).
        z: points inside of them, shape (N, 2).
        slope: H z + q, shape (N, 2).
        multipliers: > 0, shape (N, 4).
        aim: target of depths times multipliers.
        system: its lower triangle is set, shape (2N, 2N).
        right: shape (2N,), set.
    """
    depths, normals = np.empty(LIMITS), np.empty((LIMITS, 2))
    for k in range(len(z)):
        for j in range(k + 1):
            system[2 * k, 2 * j] = system[2 * k + 1, 2 * j + 1] = posed.hessian[k, j]
            system[2 * k, 2 * j + 1] = system[2 * k + 1, 2 * j] = 0.0
        x, y, length = z[k, 0], z[k, 1], posed.lengths[k]
        right[2 * k], right[2 * k + 1] = -slope[k, 0], -slope[k, 1]
        if length > 0.0:
            size = np.sqrt(x * x + y * y + SHORT * SHORT)
            right[2 * k] -= length * x / size
            right[2 * k + 1] -= length * y / size
            bent = length / size**3
            system[2 * k, 2 * k] += bent * y * y
            system[2 * k + 1, 2 * k] -= bent * x * y
            system[2 * k + 1, 2 * k + 1] += bent * x * x
        count = _depths(shapes[k], x, y, depths, normals)
        for i in range(count):
            if depths[i] <= 0.0:  # no interior
                system[2 * k, 2 * k] += HELD * posed.hessian[k, k]
                system[2 * k + 1, 2 * k + 1] += HELD * posed.hessian[k, k]
                right[2 * k] = right[2 * k + 1] = 0.0
                break
            a, b, push = normals[i, 0], normals[i, 1], multipliers[k, i] / depths[i]
            right[2 * k] += aim / depths[i] * a
            right[2 * k + 1] += aim / depths[i] * b
            system[2 * k, 2 * k] += push * a * a
            system[2 * k + 1, 2 * k] += push * a * b
            system[2 * k + 1, 2 * k + 1] += push * b * b
            if i == 0:
                system[2 * k, 2 * k] += multipliers[k, 0]
                system[2 * k + 1, 2 * k + 1] += multipliers[k, 0]


@compiled
def move_inside(shapes, z, step, multipliers, aim):
    """Move headings and multipliers along Newton's step, as far as they stay inside all limits.

    Args:
        shapes: outlines, shape (N, 12).
        z: shape (N, 2), updated.
        step: shape (2N,).
        multipliers: shape (N, 4), updated.
        aim: target of depths times multipliers.

    Returns:
        The share of the step that was taken.
    """
    depths, normals = np.empty(LIMITS), np.empty((LIMITS, 2))
    share, dual = 1.0, 1.0
    changes = np.zeros_like(multipliers)
    for k in range(len(z)):
        x, y, dx, dy = z[k, 0], z[k, 1], step[2 * k], step[2 * k + 1]
        count = _depths(shapes[k], x, y, depths, normals)
        for i in range(count):
            if depths[i] <= 0.0:
                break
            toward = normals[i, 0] * dx + normals[i, 1] * dy
            change = (aim - multipliers[k, i] * toward) / depths[i] - multipliers[k, i]
            changes[k, i] = change
            if change < 0.0:
                dual = min(dual, -INSIDE * multipliers[k, i] / change)
            if i == 0:
                a, c = 0.5 * (dx * dx + dy * dy), INSIDE * depths[0]
                root = np.sqrt(toward * toward + 4.0 * a * c)
                if root - toward > 0.0:  # root of depth + toward t - a t^2
                    share = min(share, 2.0 * c / (root - toward))
            elif toward < 0.0:
                share = min(share, -INSIDE * depths[i] / toward)
    for k in range(len(z)):
        z[k, 0] += share * step[2 * k]
        z[k, 1] += share * step[2 * k + 1]
        for i in range(LIMITS):
            multipliers[k, i] += dual * changes[k, i]
    return min(share, dual)


@compiled
def set_multipliers(shapes, z, aim, multipliers):
    """Set the multipliers such that their products with the depths are ``aim``."""
    depths, normals = np.empty(LIMITS), np.empty((LIMITS, 2))
    for k in range(len(z)):
        count = _depths(shapes[k], z[k, 0], z[k, 1], depths, normals)
        for i in range(LIMITS):
            multipliers[k, i] = aim / max(TINIEST, depths[i]) if i < count else 0.0


@compiled
def gap_inside(shapes, z, multipliers):
    """Return the sum of depths times multipliers, and the number of terms."""
    depths, normals = np.empty(LIMITS), np.empty((LIMITS, 2))
    gap, limits = 0.0, 0
    for k in range(len(z)):
        count = _depths(shapes[k], z[k, 0], z[k, 1], depths, normals)
        for i in range(count):
            if depths[i] > 0.0:
                gap += depths[i] * multipliers[k, i]
                limits += 1
    return gap, limits
