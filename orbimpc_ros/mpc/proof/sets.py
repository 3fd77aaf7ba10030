# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Support functions of stage sets: lower bounds on linear functions of one heading.

In either arithmetic, up to rounding, which the bound of a leaf subtracts.

Mathematics: docs/proofs.md, the table.
"""

from __future__ import annotations

import math

from orbimpc_ros.mpc.proof.arithmetic import (
    coarse,
    direction,
    generic,
    least_eigenvalue,
    root,
    slack,
)

TRIALS = 9  # steps of the search for the best bound around a patch and in a cone
TOLERANCE = 16  # slacks of a slope by which a direction may be outside


@generic
def over_speeds(slope, curve, slowest, fastest):
    """Return the least slope s + curve s^2 / 2 over speeds s from the slowest to the fastest."""
    if curve > 0:
        level = min(fastest, max(slowest, -slope / curve))
        return slope * level + curve * level * level / 2
    first = slope * slowest + curve * slowest * slowest / 2
    return min(first, slope * fastest + curve * fastest * fastest / 2)


@generic
def size_of(g, n):
    """Return the Euclidean norm of the first n numbers."""
    square = g[0] * g[0]
    for c in range(1, n):
        square = square + g[c] * g[c]
    return root(square)


@generic
def dot(a, b, n):
    """Return the inner product of the first n numbers."""
    total = a[0] * b[0]
    for c in range(1, n):
        total = total + a[c] * b[c]
    return total


@generic
def along_and_across(g, axis, n):
    """Return the component of a slope along a unit vector, and the squared norm of the rest."""
    along = dot(g, axis, n)
    square = (g[0] - along * axis[0]) ** 2
    for c in range(1, n):
        square = square + (g[c] - along * axis[c]) ** 2
    return along, square


@generic
def in_cone(g, axis, cosine, sine, n):
    """Return the least g . u over unit vectors u within an angle of an axis, a unit vector."""
    size, (along, square) = size_of(g, n), along_and_across(g, axis, n)
    if along <= TOLERANCE * slack(size) - cosine * size:  # downhill is within it
        return -size
    return cosine * along - sine * root(square)


@generic
def rim(share, faces, least, angle, end):
    """Set the end of a sector: its angle, cosine and sine; a polygonal floor's speed, and its face.

    Faces are counted from 0, at their middles. A sector often has an end in common with the one
    before, so that it is known.
    """
    if end[0] == angle and (end[1] != 0 or end[2] != 0):
        return
    end[0], (end[1], end[2]) = angle, direction(angle)
    if share > 0:
        end[4] = angle / share
        face = faces[math.floor((2 * end[4] + 1) / 2) % len(faces)]
        end[3] = least / (end[1] * face[0] + end[2] * face[1])


@generic
def in_sector(g, size, ends, full, narrow):
    """Return the least g . (cos, sin) over the directions of a sector; g has this size."""
    (low, a, b, _, _), (high, c, d, _, _) = ends
    off, width = -TOLERANCE * slack(size), high - low
    after, before = b * g[0] - a * g[1] >= off, c * g[1] - d * g[0] >= off  # downhill
    if 2 * width > full:
        inside = after or before or width >= full - narrow
    else:
        inside = after and before and (a + c) * g[0] + (b + d) * g[1] <= -off
    return -size if inside else min(g[0] * a + g[1] * b, g[0] * c + g[1] * d)


@generic
def nearest_floor(ends, least, share):
    """Return the least speed of a polygonal floor in a sector."""
    (low, _, _, first, begun), (high, _, _, last, ended) = ends
    if math.floor(ended) >= math.ceil(begun) or high - low >= share:
        return least
    return min(first, last)


@generic
def over_polygon(stated, g, along, ends, speeds, length, curve):
    """Return a bound over a sector beyond a polygonal floor; see :func:`over_stage`.

    A linear function that is positive on the rim, as it can be in narrow sectors or if a cone
    leaves only directions uphill, is least there, or at an end or a corner of the floor.
    """
    (low, _, _, _, begun), (high, _, _, _, ended) = ends
    faces, best = stated.faces, along * speeds[1]
    if length != 0 or curve != 0:
        best = over_speeds(along + length, curve, speeds[0], speeds[1])
        uphill = curve == 0 and along + length > 0 and 2 * (high - low) < stated.full
        return max(best, on_chord(g, ends, length)) if uphill else best
    for end in ends:
        best = min(best, (g[0] * end[1] + g[1] * end[2]) * end[3])
    for i in range(math.ceil((2 * begun - 1) / 2), math.floor((2 * ended + 1) / 2)):
        a, b = faces[i % len(faces)], faces[(i + 1) % len(faces)]
        along = g[0] * (a[0] + b[0]) + g[1] * (a[1] + b[1])
        best = min(best, along * stated.least / (1 + a[0] * b[0] + a[1] * b[1]))
    return best


@generic
def on_chord(g, ends, length):
    """Return the least g . z + length |z| over the chord between the ends of a polygon's sector.

    Along the whole line it is least where it is stationary, else at an end. The floor is beyond.
    """
    (_, a, b, first, _), (_, c, d, last, _) = ends
    x, y = last * d - first * b, first * a - last * c
    size = root(x * x + y * y)
    if size > 0:
        x, y = coarse(x / size), coarse(y / size)
        across, ahead, least = x * g[1] - y * g[0], x * g[0] + y * g[1], first * (x * a + y * b)
        left = length * length - across * across
        if left > 0:
            t = -across * least / root(left)
            if first * (x * b - y * a) <= t <= last * (x * d - y * c):
                return least * (ahead + root(left))
    return min(first * (g[0] * a + g[1] * b + length), last * (g[0] * c + g[1] * d + length))


@generic
def cross(a, b):
    """Return a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@generic
def about(corners):
    """Return the axis of the cone around a patch, and the least cosine and largest sine to it.

    The axis has the same angle to all three corners, whose lengths do not matter. Without a cone
    narrower than a half-space the cosine is -1.
    """
    x = y = z = zero = 0 * corners[0, 0]
    for i in range(3):
        b, c = corners[i], corners[(i + 1) % 3]
        across, long = cross(b, c), size_of(b, 3) * size_of(c, 3)
        x, y, z = x + across[0] / long, y + across[1] / long, z + across[2] / long
    axis, least, aside = (x, y, z), zero + 1, zero
    size = size_of(axis, 3) if dot(axis, corners[0], 3) > 0 else -size_of(axis, 3)
    if size == 0:
        return axis, zero - 1, zero
    axis = coarse(x / size), coarse(y / size), coarse(z / size)
    for i in range(3):
        long = size_of(corners[i], 3)
        least = min(least, dot(axis, corners[i], 3) / long)
        aside = max(aside, size_of(cross(axis, corners[i]), 3) / long)
    return axis, least if least > 0 else zero - 1, aside


@generic
def around(stated, part, corners, k):
    """Return the cone around the part of heading k in space, beyond a face or in a patch.

    Returns:
        Its axis, and cosine and sine of its angle.
    """
    if len(stated.faces) == 0:
        return about(corners[k])
    x, y, z = stated.faces[part]
    return (x, y, z), stated.least, root(1 - stated.least * stated.least)


@generic
def over_orbitope(g, matrix):
    """Return the least <G, R> over conv SO(3): the least eigenvalue of K(G).

    Args:
        g: G, column by column, shape (9,).
        matrix: to be set, shape (4, 4).
    """
    matrix[0, 0] = g[0] + g[4] + g[8]
    matrix[1, 1] = g[0] - g[4] - g[8]
    matrix[2, 2] = g[4] - g[0] - g[8]
    matrix[3, 3] = g[8] - g[0] - g[4]
    for c in range(3):
        i, j = (c + 1) % 3, (c + 2) % 3
        upper, lower = g[3 * j + i], g[3 * i + j]
        matrix[0, c + 1] = lower - upper
        matrix[c + 1, 0] = lower - upper
        matrix[i + 1, j + 1] = lower + upper
        matrix[j + 1, i + 1] = lower + upper
    return least_eigenvalue(matrix)


@generic
def in_both(g, size, cone, axis, cosine, sine):
    """Return a lower bound of g . u over unit vectors u in two cones; g has this size.

    For any t >= 0 this is t cos d plus the least (g - t a) . u in the second cone, concave in t,
    with the axis a and the angle d of the first. The search begins at the t for which the minimiser
    over all directions is on the rim of the first cone, if there is one.
    """
    along, square = along_and_across(g, cone, 3)
    t = along + root(square) * cone[3] / cone[4] if cone[4] > 0 else along
    t = step = t if t > 0 else size
    best = behind_rim(g, size, cone, axis, cosine, sine, t)
    for _ in range(TRIALS):
        above = behind_rim(g, size, cone, axis, cosine, sine, t + step)
        below = behind_rim(g, size, cone, axis, cosine, sine, max(t - step, 0 * t))
        if max(above, below) > best:
            t, best = (t + step, above) if above > below else (max(t - step, 0 * t), below)
            step = 2 * step
        else:
            step = step / 4
    return best


@generic
def behind_rim(g, size, cone, axis, cosine, sine, t):
    """Return t cos d plus the least (g - t a) . u in the second cone; see :func:`in_both`."""
    rest = g[0] - t * cone[0], g[1] - t * cone[1], g[2] - t * cone[2]
    return in_cone(rest, axis, cosine, sine, 3) + t * cone[3] - slack(size + t)


@generic
def over_stage(stated, region, k, g, length, curve):
    """Return a lower bound on g . z + length |z| + curve |z|^2 / 2 over z_{k+1}'s stage set.

    It is the best of several bounds. They are not combined, because a cone with its own least
    speed ends flat, and allows lower speeds there.

    Args:
        stated: the problem.
        region: parts, spans and corners of all choices; and the ends of the sector of each step, as
            :func:`rim` sets them.
        k: the step, from 0 on.
        g: shape (n,) at least.
        length: a weight.
        curve: a weight.
    """
    n, part, ends, axis = stated.n, region[0][k], region[3][k], (0 * length, 0 * length, 0 * length)
    flat, solid = n == 2 and part >= 0, n == 3 and len(stated.faces) > 0
    slowest, fastest = region[1][len(region[3]) + k]
    size, linear = size_of(g, n), length == 0 and curve == 0
    along, cosine, sine = -size, axis[0], axis[0]
    best = -(size + abs(length) + abs(curve)) * (1 + fastest * fastest)
    if flat:
        for i in range(2):
            rim(stated.share, stated.faces, stated.least, region[1][k, i], ends[i])
        along = in_sector(g, size, ends, stated.full, stated.narrow)
        if stated.share > 0:
            slowest = max(slowest, min(fastest, nearest_floor(ends, stated.least, stated.share)))
    restricted = n == 3 and part >= 0
    if restricted:
        axis, cosine, sine = around(stated, part, region[2], k)
        along = in_cone(g, axis, cosine, sine, 3)
    for q in range(len(stated.cone_step)):
        if stated.cone_step[q] == k:
            cone = stated.cones[q]
            within = in_cone(g, cone, cone[n], cone[n + 1], n)
            along = max(along, within)
            if restricted:
                along = max(along, in_both(g, size, cone, axis, cosine, sine))
            if linear:
                slow = min(fastest, max(slowest, cone[n + 2]))
                best = max(best, over_speeds(within, curve, slow, fastest))
    best = max(best, over_speeds(along + length, curve, slowest, fastest))
    speeds = slowest, fastest
    if restricted and solid:
        best = max(best, over_face(g, along, axis, stated.least, speeds, length, curve))
    if flat and stated.share > 0 and (along > 0 or not linear):
        best = max(best, over_polygon(stated, g, along, ends, speeds, length, curve))
    return best


@generic
def over_face(g, along, normal, least, speeds, length, curve):
    """Return a bound over the part of a ball beyond a face; see :func:`over_stage`.

    Args:
        g: shape (3,).
        along: the least g . u over the directions u of the step.
        normal: of the face.
        least: distance of the face.
        speeds: the least and the greatest.
        length: a weight.
        curve: a weight; without it, a positive function is least on the face or on the rim.
    """
    slowest, fastest = speeds
    best = over_speeds(along + length, curve, slowest, fastest)
    if curve != 0 or length < 0:
        return best
    ahead, square = along_and_across(g, normal, 3)
    widest, left = max(0 * least, fastest * fastest - least * least), length * length - square
    if left > 0 and square * least * least <= widest * left:  # stationary within the ball
        on_face = ahead * least + least * root(left)
    else:
        on_face = ahead * least + length * fastest - root(square) * root(widest)
    return max(best, min((along + length) * fastest, on_face))
