# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Least values of what is linear, in closed form: each at most what it stands for.

Derivation: docs/proofs.md, the table.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import lru_cache

from .exact import (
    NARROW,
    ONE,
    PI,
    TINY,
    ZERO,
    Vector,
    direction,
    dot,
    lacking_whole,
    root_above,
    size_above,
    whole,
)  # fmt: skip
from .limits import Cone, StatedFloor, cone
from .regions import Sector


def least_along(
    slope: Fraction, bend: Fraction, slowest: Fraction, fastest: Fraction = ONE
) -> Fraction:
    """Return the least slope s - bend s^2 / 2 over speeds s from the slowest to the fastest."""
    ends = min(slope * s - bend * s * s / 2 for s in (slowest, fastest))
    if bend < 0 and slowest * bend > slope > fastest * bend:  # convex, and least where it is level
        return slope * slope / (2 * bend)
    return ends


def least_towards(slope: Vector, within: Cone) -> Fraction:
    """Return the least slope . u over unit vectors u in a cone, of any width."""
    squared, along = dot(slope, slope), dot(slope, within.axis)
    size = root_above(squared)
    if -along >= within.least * size - 4 * TINY * (1 + size):
        return -size
    across = root_above(max(ZERO, squared - along * along / within.square))
    return max(-size, along * within.least / within.square - across * within.aside)


def least_within(slope: Vector, sector: Sector) -> Fraction:
    """Return the least slope . (cos, sin) over the directions of a sector: a cone of the plane."""
    if sector.high - sector.low >= 2 * (PI - NARROW):
        return -size_above(slope)
    return least_towards(slope, _around(sector))


@lru_cache(maxsize=4096)
def _around(sector: Sector) -> Cone:
    half = (sector.high - sector.low) / 2
    return _beyond(sector.low + half, direction(half)[0])


def least_beyond(slope: Vector, floor: StatedFloor, face: int) -> Fraction:
    """Return the least slope . x over the part of the disk beyond a face n . x >= slowest.

    Straight as it is, that is least on its rim, where it is a cone.
    """
    return least_towards(slope, _face(floor, face))


@lru_cache(maxsize=64)
def _face(floor: StatedFloor, face: int) -> Cone:
    return _beyond(2 * PI * face / floor.faces, floor.slowest)


def _beyond(angle: Fraction, least: Fraction) -> Cone:
    """Return the unit vectors that are at least so far out in a direction, and hardly more."""
    return cone(list(direction(angle)), least - 4 * TINY)


def least_reached(slope: Vector, floor: StatedFloor, sector: Sector) -> Fraction:
    """Return the least slope . x over a sector, from a polygonal floor to the rim.

    Given the least at the rim, what is left is the floor: straight between the ends and its
    corners. Where these are downhill of the middle, the rim is lower.
    """
    rim = least_within(slope, sector)
    if sector.high - sector.low >= PI - NARROW:
        return least_along(rim, ZERO, floor.slowest)
    share = 2 * PI / floor.faces
    first, last = (each / share - Fraction(1, 2) for each in (sector.low, sector.high))
    corners = range(math.ceil(first), math.floor(last) + 1)
    best, off = rim, 4 * TINY * (1 + size_above(slope))
    for angle in (sector.low, sector.high, *((i + Fraction(1, 2)) * share for i in corners)):
        (x, y), nearest = direction(angle), round(angle / share)
        nx, ny = direction(nearest * share)
        along = slope[0] * x + slope[1] * y - off
        if along > 0:
            best = min(best, along * floor.slowest / (nx * x + ny * y + 4 * TINY))
    return best


def least_over_orbitope(slope: Vector, top: Fraction) -> Fraction:
    """Return the least <G, R> over conv SO(3): -top, where top I + K(G) is semidefinite."""
    (most, g11, g21, g31, g12, g22, g32, g13, g23, g33), unit = whole([top, *slope])
    matrix = [
        [most + g11 + g22 + g33, g32 - g23, g13 - g31, g21 - g12],
        [g32 - g23, most + g11 - g22 - g33, g21 + g12, g13 + g31],
        [g13 - g31, g21 + g12, most - g11 + g22 - g33, g32 + g23],
        [g21 - g12, g13 + g31, g32 + g23, most - g11 - g22 + g33],
    ]
    return -top - lacking_whole(matrix, unit)
