# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Least values of what is linear, in closed form: each at most what it stands for.

Slopes, bends and least values are whole numbers of units, 1 / UNIT each; the last rounded down.

Derivation: docs/proofs.md, the table.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from operator import mul

from .exact import NARROW, ONE, PI, SLIGHT, TINY, UNIT, Matrix, Vector, direction, heading, lacking
from .limits import Cone, StatedFloor, cone
from .regions import Sector

WIDEST = 2 * (PI - NARROW)  # [rad] of a sector that leaves anything out


def over_speeds(slope: int, bend: int, slowest: Fraction, fastest: Fraction) -> int:
    """Return the least slope s - bend s^2 / 2 over speeds s from the slowest to the fastest."""
    if bend < 0 and slowest * bend > slope > fastest * bend:  # convex, and least where it is level
        return slope * slope // (2 * bend)
    ends = (each.as_integer_ratio() for each in (slowest, fastest))
    return min((2 * slope * a * b - bend * a * a) // (2 * b * b) for a, b in ends)


def around(slope: Sequence[int]) -> int:
    """Return the least slope . u over unit vectors u."""
    return -math.isqrt(sum(x * x for x in slope)) - 1


def towards(slope: Sequence[int], cone: Cone) -> int:
    """Return the least slope . u over unit vectors u in a cone, of any width.

    On its rim u . d = c, along its axis d, and of what slope and u are across d the product is
    least where these are opposed.
    """
    (axis, least, square, aside, _), lowest = cone, around(slope)
    along = sum(map(mul, slope, axis.numbers))
    if along <= max(least * lowest, least * (lowest + 1)):  # downhill may be in it
        return lowest
    across = math.isqrt(square * sum(x * x for x in slope) - along * along) + 1
    return max(lowest, (along * least - across * aside) // square)


def within(slope: Sequence[int], sector: Sector) -> int:
    """Return the least slope . (cos, sin) over the directions of a sector.

    Those from a first one counterclockwise to a last one are to the left of the first and to the
    right of the last; in more than half a turn, they are either. Downhill, or else at an end.
    """
    width, (x, y), lowest = sector.high - sector.low, slope, around(slope)
    if width >= WIDEST:
        return lowest
    (c, s), (p, q) = (heading(each) for each in sector)
    off = -4 * SLIGHT * lowest
    sides = c * y - s * x <= off, x * q - y * p <= off
    if all(sides) if width <= PI else any(sides):
        return lowest
    return max(lowest, (min(x * c + y * s, x * p + y * q) - off) // UNIT)


def beyond(slope: Sequence[int], floor: StatedFloor, face: int) -> int:
    """Return the least slope . x over the part of the disk beyond a face n . x >= slowest.

    Straight as it is, that is least on its rim, where it is a cone.
    """
    return towards(slope, _face(floor, face))


@lru_cache(maxsize=64)
def _face(floor: StatedFloor, face: int) -> Cone:
    return _beyond(2 * PI * face / floor.faces, floor.slowest)


def _beyond(angle: Fraction, least: Fraction) -> Cone:
    """Return the unit vectors that are at least so far out in a direction, and hardly more."""
    return cone(Vector.of(direction(angle)), least - 4 * TINY)


def reached(slope: Sequence[int], floor: StatedFloor, sector: Sector) -> int:
    """Return the least slope . x over a sector, from a polygonal floor to the rim.

    Given the least at the rim, what is left is the floor: straight between the ends and its
    corners. Where these are downhill of the middle, the rim is lower.
    """
    best, off = within(slope, sector), 4 * SLIGHT * around(slope)
    if sector.high - sector.low >= PI - NARROW:
        return over_speeds(best, 0, floor.slowest, ONE)
    share = 2 * PI / floor.faces
    first, last = (each / share - Fraction(1, 2) for each in (sector.low, sector.high))
    corners = range(math.ceil(first), math.floor(last) + 1)
    for angle in (sector.low, sector.high, *((i + Fraction(1, 2)) * share for i in corners)):
        x, y, reach = _on_floor(floor, angle)
        along = (slope[0] * x + slope[1] * y + off) // UNIT
        if along > 0:
            best = min(best, along * reach // UNIT)
    return best


@lru_cache(maxsize=4096)
def _on_floor(floor: StatedFloor, angle: Fraction) -> list[int]:
    """Return a direction, and at most how far out a polygonal floor is there."""
    share = 2 * PI / floor.faces
    (x, y), (nx, ny) = direction(angle), direction(round(angle / share) * share)
    reach = floor.slowest / (nx * x + ny * y + 4 * TINY)
    return [math.floor(each * UNIT) for each in (x, y, reach)]


def over_orbitope(slope: Sequence[int], top: int) -> int:
    """Return the least <G, R> over conv SO(3): -top, where top I + K(G) is semidefinite."""
    g11, g21, g31, g12, g22, g32, g13, g23, g33 = slope
    matrix = [
        [top + g11 + g22 + g33, g32 - g23, g13 - g31, g21 - g12],
        [g32 - g23, top + g11 - g22 - g33, g21 + g12, g13 + g31],
        [g13 - g31, g21 + g12, top - g11 + g22 - g33, g32 + g23],
        [g21 - g12, g13 + g31, g32 + g23, top - g11 - g22 + g33],
    ]
    return math.floor(-top - UNIT * lacking(Matrix(matrix, UNIT)))
