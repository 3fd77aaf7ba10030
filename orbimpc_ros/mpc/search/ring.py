# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Stage sets in the plane: the part of a ring within a sector of headings and a range of speeds.

A heading z = t (cos a, sin a) belongs to the set if low <= a <= high and max(slow,
rho(a)) <= t <= fast, where rho is the least speed of the floor along a. Without a floor and a
sector the set is the disk. The search needs only three functions of the set:

- ``prox``: the minimiser of h |z|^2 / 2 + c . z + l |z| over its convex hull;
- ``support``: the minimum of g . z + l |z| over the set itself;
- the face of the hull that contains such a minimiser, which can move along it.

Mathematics: docs/mathematics.md, 4.3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.kernels import compiled

TURN, HALF = 2.0 * np.pi, np.pi - 1e-9
ALL = TURN - 1e-9  # [rad], wider sectors are whole circles
FREE, RIM, EDGE, CHORD, POINT = range(5)  # faces: interior, fastest arc, edge, chord, corner
# Columns of a sector, and of its outline: its kind; the unit vectors of its edges; the least speeds
# along them; the least and the greatest speed; the chord n . z >= b between the slowest points.
LOW, HIGH, SLOW, FAST = range(4)
KIND, LX, LY, UX, UY, LEAST_L, LEAST_U, INNER, OUTER, NX, NY, NB = range(12)
SECTOR, OUTLINE = 4, 12
WHOLE, WIDE, NARROW = 0.0, 1.0, 2.0
ON = 1e-15  # tolerance for points on a chord
TINY = 1e-300
MARGIN = 0.15  # least width of a part, as a share of the sector
NEWTON = 4  # Newton steps along a chord if lengths have a weight


class Ring(NamedTuple):
    """A planar floor and the limits that couple headings to their neighbours.

    Attributes:
        fraction: the least |z|: radius of the circle, or of the circle inside the polygon; 0
            without a floor.
        faces: number of faces of the polygon, 0 for the circle.
        widest: the largest turn in a step [rad]; at least pi if unlimited.
        first: the heading at the start, and of the decided steps [rad].
        entry: the speed that the first change starts from.
        change: the largest change of speed in a step; inf if unlimited.
        last: desired direction of the last heading [rad].
        within: largest deviation from it [rad]; pi if unconstrained.
        decided: number of first steps whose headings the state decides, but for their speeds.
    """

    fraction: float
    faces: int
    widest: float
    first: float
    entry: float
    change: float
    last: float
    within: float
    decided: int


@compiled
def cut_near(angle, low, high):
    """Return where to cut a sector: as near to an angle as possible without a narrow part."""
    middle, margin = 0.5 * (low + high), MARGIN * (high - low)
    angle += TURN * np.round((middle - angle) / TURN)
    return min(high - margin, max(low + margin, angle))


@compiled
def take_part(sector, k, low, high, cut, parts, i):
    """Narrow a step's range, in columns low and high, to one of two parts or of many arcs."""
    if parts > 2:
        sector[k, low], sector[k, high] = cut + i * TURN / parts, cut + (i + 1) * TURN / parts
    elif i == 0:
        sector[k, high] = cut
    else:
        sector[k, low] = cut


@compiled
def least_speed(fraction, faces, angle):
    """Return the least speed of a floor along an angle [rad]."""
    if faces == 0:
        return fraction
    share = TURN / faces
    return fraction / np.cos(angle - share * np.round(angle / share))


@compiled
def nearest_speed(fraction, faces, low, high):
    """Return the least speed of a polygon over a sector [rad]."""
    share = TURN / faces
    normal = share * np.round(0.5 * (low + high) / share)
    return least_speed(fraction, faces, min(high, max(low, normal)))


@compiled
def outline(ring, sector, shape):
    """Set the outline of a sector.

    A polygon is used only if all of it within the sector is above the lower limit of speeds, and
    ignored otherwise: the error vanishes as sectors become narrow.

    Args:
        ring: gives the floor.
        sector: shape (4,).
        shape: its outline, shape (12,), set.
    """
    low, high, slow, fast = sector[LOW], sector[HIGH], sector[SLOW], sector[FAST]
    shape[INNER], shape[OUTER] = slow, fast
    shape[KIND] = WHOLE if high - low >= ALL else WIDE if high - low >= HALF else NARROW
    if shape[KIND] == WHOLE:
        return
    lx, ly, ux, uy = np.cos(low), np.sin(low), np.cos(high), np.sin(high)
    a, b = slow, slow
    if ring.faces > 0 and slow <= nearest_speed(ring.fraction, ring.faces, low, high):
        a = min(fast, least_speed(ring.fraction, ring.faces, low))
        b = min(fast, least_speed(ring.fraction, ring.faces, high))
    shape[LX], shape[LY], shape[UX], shape[UY] = lx, ly, ux, uy
    shape[LEAST_L], shape[LEAST_U] = a, b
    nx, ny = b * uy - a * ly, a * lx - b * ux
    size = np.sqrt(nx * nx + ny * ny)
    if size > 1e-9:
        nx, ny = nx / size, ny / size
    else:
        nx, ny = lx, ly
    shape[NX], shape[NY] = nx, ny
    shape[NB] = min(a * (nx * lx + ny * ly), b * (nx * ux + ny * uy))


@compiled
def is_within(shape, x, y):
    """Return True if a point's direction is within the sector."""
    if shape[KIND] == WHOLE:
        return True
    after, before = shape[LX] * y - shape[LY] * x, x * shape[UY] - y * shape[UX]
    if shape[KIND] == WIDE:
        return after >= 0.0 or before >= 0.0
    return after >= 0.0 and before >= 0.0


@compiled
def support(shape, length, gx, gy):
    """Return a tight lower bound on g . z + l |z| over the set: mostly its minimum.

    Where it is positive along all directions, the minimum is at the least speeds: on the floor of a
    circle, or on the chord of a polygon.

    Args:
        shape: its outline, shape (12,).
        length: l >= 0.
        gx: first component of g.
        gy: second component of g.
    """
    inner, outer = shape[INNER], shape[OUTER]
    if is_within(shape, -gx, -gy):
        slope = first = last = length - np.sqrt(gx * gx + gy * gy)
    else:
        first = gx * shape[LX] + gy * shape[LY] + length
        last = gx * shape[UX] + gy * shape[UY] + length
        slope = min(first, last)
    if slope <= 0.0:
        return slope * outer
    if length == 0.0:
        return min(first * shape[LEAST_L], last * shape[LEAST_U])
    if shape[KIND] < NARROW or shape[LEAST_L] + shape[LEAST_U] == 2.0 * inner:
        return slope * inner
    return _on_chord(shape, length, gx, gy)


@compiled
def _on_chord(shape, length, gx, gy):
    """Return the minimum of g . z + l |z| over the chord."""
    nx, ny, nb = shape[NX], shape[NY], shape[NB]
    a, b = shape[LEAST_L], shape[LEAST_U]
    along = ny * gx - nx * gy  # across the normal, towards the first edge
    start, end = b * (ny * shape[UX] - nx * shape[UY]), a * (ny * shape[LX] - nx * shape[LY])
    t, left = end if along < 0.0 else start, length * length - along * along
    if left > 0.0:
        t = min(end, max(start, -along * nb / np.sqrt(left)))
    return nb * (gx * nx + gy * ny) + t * along + length * np.sqrt(nb * nb + t * t)


@compiled
def prox(shape, h, length, cx, cy):
    """Return the minimiser of h |z|^2 / 2 + c . z + l |z| over the hull, its face and direction.

    As on the set itself, |z| counts as at least the least speed.

    Args:
        shape: the outline, shape (12,).
        h: > 0.
        length: l >= 0.
        cx: first component of c.
        cy: second component of c.
    """
    inner, outer, size = shape[INNER], shape[OUTER], max(TINY, np.sqrt(cx * cx + cy * cy))
    r, face = size / h, FREE
    if length > 0.0 and r > inner:
        r = (size - length) / h
        if r <= inner:
            r, face = inner, RIM
    if r > outer:
        r, face = outer, RIM
    x, y = -cx / size * r, -cy / size * r
    if shape[KIND] < NARROW:
        return x, y, face, -y, x
    lx, ly, ux, uy = shape[LX], shape[LY], shape[UX], shape[UY]
    turned = lx * y - ly * x >= 0.0 and x * uy - y * ux >= 0.0
    if turned and shape[NX] * x + shape[NY] * y >= shape[NB] - ON:
        return x, y, face, -y, x
    best, dx, dy, a, b = np.inf, 0.0, 0.0, shape[LEAST_L], shape[LEAST_U]
    if turned and r == outer:
        best, dx, dy = (0.5 * h * r + length) * r + cx * x + cy * y, -y, x
    for side in range(2):
        vx, vy, least = (lx, ly, a) if side == 0 else (ux, uy, b)
        value, t, at = _onto_edge(h, cx * vx + cy * vy + length, least, outer)
        if value < best:
            best, face, x, y, dx, dy = value, at, t * vx, t * vy, vx, vy
    value, px, py, ex, ey = _onto_chord(shape, h, length, cx, cy)
    if value < best:
        best, face, x, y, dx, dy = value, CHORD, px, py, ex, ey
    return x, y, face, dx, dy


@compiled
def _onto_edge(h, slope, least, outer):
    """Return the least h t^2 / 2 + slope t from least to outer, where it is, and its face."""
    t = -slope / h
    at = POINT if t <= least or t >= outer else EDGE
    t = min(outer, max(least, t))
    return (0.5 * h * t + slope) * t, t, at


@compiled
def _onto_chord(shape, h, length, cx, cy):
    """Return the least value of :func:`prox` within the chord, where it is, and its direction.

    The value is infinity if an end of the chord is better; the direction is zero where the least
    speed holds the minimiser.
    """
    a, lx, ly = shape[LEAST_L], shape[LX], shape[LY]
    ex, ey = shape[LEAST_U] * shape[UX] - a * lx, shape[LEAST_U] * shape[UY] - a * ly
    across = np.sqrt(ex * ex + ey * ey)
    if across <= 1e-12:
        return np.inf, 0.0, 0.0, ex, ey
    ex, ey = ex / across, ey / across
    start, slope = a * (lx * ex + ly * ey), cx * ex + cy * ey
    t = -slope / h  # measured from the foot of the perpendicular
    inner, square, held = shape[INNER], a * a - start * start, False
    if length > 0.0 and square + t * t > inner * inner:
        t, held = _along_chord(h, length, slope, square, inner, t)
    if not start < t < start + across:
        return np.inf, 0.0, 0.0, ex, ey
    px, py = a * lx + (t - start) * ex, a * ly + (t - start) * ey
    value = 0.5 * h * (px * px + py * py) + cx * px + cy * py
    value += length * max(inner, np.sqrt(px * px + py * py))
    return (value, px, py, 0.0, 0.0) if held else (value, px, py, ex, ey)


@compiled
def _along_chord(h, length, slope, square, inner, t):
    """Return the minimiser of h t^2 / 2 + slope t + l max(inner, sqrt(square + t^2)).

    By Newton's method, from the minimiser without lengths; and whether the least speed holds it.
    """
    sign = np.copysign(1.0, t)
    t *= h / (h + length / np.sqrt(max(TINY, square) + t * t))
    for _ in range(NEWTON):
        size = np.sqrt(max(TINY, square) + t * t)
        t -= (h * t + slope + length * t / size) / (h + length * square / size**3)
    if square + t * t < inner * inner:
        return sign * np.sqrt(inner * inner - square), True
    return t, False
