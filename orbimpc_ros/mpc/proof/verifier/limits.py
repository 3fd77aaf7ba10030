# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What thrust axes and positions are subject to, but for walls: floors, cones, the glide slope."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any, NamedTuple

from .exact import NARROW, ONE, PI, TINY, UNIT, ZERO, Vector, direction, size_above, size_below
from .reading import Refused, fields, items, vector, weight, whole, word
from .regions import Speeds


class StatedFloor(NamedTuple):
    """The least speed as a share of the fastest, of a disk or of a polygon with so many faces."""

    exists: bool
    slowest: Fraction
    faces: int


class Cone(NamedTuple):
    """Where axes point: u . axis is at least so much of each unit vector u along them.

    Attributes:
        axis: of any length.
        least: at most the cosine of the cone's angle, times that length; in units of the axis, as
            is what follows.
        square: of that length.
        aside: at least the sine of the angle that this is, times that length.
        slowest: the least speed; at it the cone ends flat, at z . axis >= cosine x slowest.
    """

    axis: Vector
    least: int
    square: int
    aside: int
    slowest: Fraction = ZERO


def cone(axis: Vector, least: Fraction, slowest: Fraction = ZERO) -> Cone:
    """Return the cone of u . axis >= least."""
    fine = Vector([UNIT * each for each in axis.numbers], UNIT * axis.unit)
    low, square = math.floor(least * fine.unit), sum(each * each for each in fine.numbers)
    return Cone(fine, low, square, math.isqrt(max(0, square - low * low)) + 1, slowest)


class Tether(NamedTuple):
    """How far an axis moves in a step at most, and where the one before the first step is."""

    begin: Vector
    length: Fraction


class GlideSlope(NamedTuple):
    """The cone above the goal: its angle's cosine and sine, and by how much steps are eased."""

    cosine: Fraction
    sine: Fraction
    eased: Vector


def floor(stated: Any) -> StatedFloor:
    """Return a floor as it is stated."""
    fields(stated, 'floor', ('shape',), ('faces', 'fraction'))
    shape = word(stated['shape'], 'floor.shape', ('none', 'polygon', 'circle'))
    slowest = ZERO if shape == 'none' else weight(stated.get('fraction'), 'floor.fraction')
    faces = whole(stated.get('faces'), 'floor.faces', 3, 64) if shape == 'polygon' else 0
    return StatedFloor(shape != 'none', slowest, faces)


def cones(stated: Any, n: int, horizon: int) -> list[list[Cone]]:
    """Return the cones that each step's axis is in."""
    found: list[list[Cone]] = [[] for _ in range(horizon)]
    for each in items(stated, 'cones'):
        fields(each, 'a cone', ('axis', 'angle', 'least', 'steps'))
        angle = weight(each['angle'], 'angle')
        axis = vector(each['axis'], 'axis', n)
        if angle > PI / 2 or not axis:
            raise Refused('a cone is none, or wider than half of space')
        cosine, slowest = direction(angle)[0] - TINY, weight(each['least'], 'least')
        if slowest > 1:
            raise Refused('a least speed is above 1')
        size = size_above(axis) if cosine < 0 else size_below(axis)
        made = cone(axis, cosine * size, slowest)
        for step in items(each['steps'], 'steps'):
            found[whole(step, 'steps', 1, horizon) - 1].append(made)
    return found


def speeds(stated: Any, slowest: Fraction, horizon: int) -> tuple[tuple[Speeds, ...], Fraction]:
    """Return what each step's speed is within, and by how much one changes in a step at most."""
    fields(stated, 'speeds', ('entry', 'change'))
    entry, change = (weight(stated[name], name) for name in ('entry', 'change'))
    far = [k * change for k in range(1, horizon + 1)]
    return tuple(Speeds(max(slowest, entry - x), min(ONE, entry + x)) for x in far), change


def tether(turn: Fraction, limit: StatedFloor, begin: Vector) -> Tether | None:
    """Return how far turns move axes where they are limited as chords (3.6a): without a floor."""
    if not turn or limit.exists or turn > PI - NARROW:
        return None
    return Tether(begin, 2 * (direction(turn / 2)[1] + TINY))


def glide_slope(stated: Any, horizon: int) -> GlideSlope:
    """Return the cone above the goal."""
    fields(stated, 'glide_slope', ('angle', 'eased'))
    angle = weight(stated['angle'], 'angle')
    if not 0 < angle < PI / 2:
        raise Refused('the angle of glide_slope is none')
    eased = vector(stated['eased'], 'eased', horizon)
    if min(eased) < 0:
        raise Refused('eased is negative')
    return GlideSlope(*direction(angle), eased)
