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
from orbimpc_ros.mpc.search.ring import INNER, KIND, LX, LY, NARROW, NB, NX, NY, OUTER, TINY, UX, UY

STEPS = 25
CENTRED, BLOCKED = 0.1, 0.5  # shares of the gap to aim for, after a long step and a short one
LONG = 0.9
INSIDE = 0.99  # share of the way to a limit that a step may take
THIN = 1e-9  # least size of a set with an interior
HELD = 1e12  # factor on the curvature, to hold headings whose sets have no interior
LIMITS = 4  # limits of a set: speed, both edges, chord


@compiled
def set_depths(shapes, z, limits):
    """Set the depths of points inside of the limits of their sets, and the inward normals.

    Args:
        shapes: outlines, shape (N, 12).
        z: points, shape (N, 2).
        limits: set: depths, shape (N, 4), 0 where there is no limit, or the set has no interior;
            normals, shape (N, 4, 2).
    """
    depths, normals = limits
    for k in range(len(z)):
        shape, x, y = shapes[k], z[k, 0], z[k, 1]
        normals[k, 0, 0], normals[k, 0, 1] = -x, -y
        normals[k, 1, 0], normals[k, 1, 1] = -shape[LY], shape[LX]
        normals[k, 2, 0], normals[k, 2, 1] = shape[UY], -shape[UX]
        normals[k, 3, 0], normals[k, 3, 1] = shape[NX], shape[NY]
        depths[k, 0] = least = 0.5 * (shape[OUTER] ** 2 - x * x - y * y)
        count = 1 if shape[KIND] < NARROW else LIMITS
        for i in range(1, count):
            depth = normals[k, i, 0] * x + normals[k, i, 1] * y
            depths[k, i] = depth - shape[NB] if i == 3 else depth
            least = min(least, depths[k, i])
        for i in range(0 if least <= 0.0 else count, LIMITS):
            depths[k, i] = 0.0


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
def set_system(posed, shapes, z, slope, limits, multipliers, aim, system, right):
    """Set Newton's system: stationarity of the cost, and depths times multipliers equal to ``aim``.

    Args:
        posed: the problem.
        shapes: outlines, shape (N, 12).
        z: points, shape (N, 2).
        slope: H z + q, shape (N, 2).
        limits: depths and normals of the points; see :func:`set_depths`.
        multipliers: > 0, shape (N, 4).
        aim: target of depths times multipliers.
        system: its lower triangle is set, shape (2N, 2N).
        right: shape (2N,), set.
    """
    depths, normals = limits
    for k in range(len(z)):
        for j in range(k + 1):
            system[2 * k, 2 * j] = system[2 * k + 1, 2 * j + 1] = posed.hessian[k, j]
            system[2 * k, 2 * j + 1] = system[2 * k + 1, 2 * j] = 0.0
        x, y, length = z[k, 0], z[k, 1], posed.lengths[k]
        right[2 * k], right[2 * k + 1] = -slope[k, 0], -slope[k, 1]
        if length > 0.0:
            size = np.sqrt(x * x + y * y) + TINY
            push, steep = _pull(length, size - shapes[k, INNER], aim)
            x, y, bent = x / size, y / size, push / size
            right[2 * k] -= push * x
            right[2 * k + 1] -= push * y
            system[2 * k, 2 * k] += bent * y * y + steep * x * x
            system[2 * k + 1, 2 * k] += (steep - bent) * x * y
            system[2 * k + 1, 2 * k + 1] += bent * x * x + steep * y * y
        if depths[k, 0] == 0.0:  # no interior
            system[2 * k, 2 * k] += HELD * posed.hessian[k, k]
            system[2 * k + 1, 2 * k + 1] += HELD * posed.hessian[k, k]
            right[2 * k] = right[2 * k + 1] = 0.0
        for i in range(LIMITS):
            if depths[k, i] == 0.0:
                continue
            a, b, push = normals[k, i, 0], normals[k, i, 1], multipliers[k, i] / depths[k, i]
            right[2 * k] += aim / depths[k, i] * a
            right[2 * k + 1] += aim / depths[k, i] * b
            bent = multipliers[k, 0] if i == 0 else 0.0
            system[2 * k, 2 * k] += push * a * a + bent
            system[2 * k + 1, 2 * k] += push * a * b
            system[2 * k + 1, 2 * k + 1] += push * b * b + bent


@compiled
def _pull(length, above, aim):
    """Return the slope and the curvature of a length above the least speed, smoothed by barriers.

    It is the least l t - aim log (t - |z|) - aim log (t - least) over t.
    """
    steep = length * above
    root = np.sqrt(steep * steep + 4.0 * aim * aim)
    more = 4.0 * aim * aim / (root + steep) if steep > 0.0 else root - steep
    left = (2.0 * aim + more) / (2.0 * length)  # t - |z|
    return aim / left, 0.5 * aim / (left * left) * more / root


@compiled
def move_inside(z, step, limits, multipliers, aim):
    """Move headings and multipliers along Newton's step, as far as they stay inside all limits.

    Args:
        z: shape (N, 2), updated.
        step: shape (2N,).
        limits: depths and normals of the points; see :func:`set_depths`.
        multipliers: shape (N, 4), updated.
        aim: target of depths times multipliers.

    Returns:
        The share of the step that was taken.
    """
    (depths, normals), share, dual = limits, 1.0, 1.0
    changes = np.zeros_like(multipliers)
    for k in range(len(z)):
        dx, dy = step[2 * k], step[2 * k + 1]
        for i in range(LIMITS):
            depth = depths[k, i]
            if depth == 0.0:
                continue
            toward = normals[k, i, 0] * dx + normals[k, i, 1] * dy
            change = (aim - multipliers[k, i] * toward) / depth - multipliers[k, i]
            changes[k, i] = change
            if change < 0.0:
                dual = min(dual, -INSIDE * multipliers[k, i] / change)
            if i == 0:
                a, c = 0.5 * (dx * dx + dy * dy), INSIDE * depth
                root = np.sqrt(toward * toward + 4.0 * a * c)
                if root - toward > 0.0:  # root of depth + toward t - a t^2
                    share = min(share, 2.0 * c / (root - toward))
            elif toward < 0.0:
                share = min(share, -INSIDE * depth / toward)
    for k in range(len(z)):
        z[k, 0] += share * step[2 * k]
        z[k, 1] += share * step[2 * k + 1]
        for i in range(LIMITS):
            multipliers[k, i] += dual * changes[k, i]
    return min(share, dual)
