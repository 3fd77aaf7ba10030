# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Trees of splits: whatever a trajectory does, it is in one of the parts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from typing import Any

from .exact import TINY, TURN, ZERO, direction
from .reading import Refused, fields, items, number, vector, whole
from .regions import Region, Sector
from .stated import StatedProblem
from .walls import BoxWall

DEEPEST = 100_000
ROTATED = Fraction(1, 10**6)  # by which columns of rotations may be off
Ranges = tuple[Any, ...]  # a sector of each step, or its speeds


def leaves(
    posed: StatedProblem, tree: Any, root: Region, spend: Callable[[int], None] = lambda _: None
) -> Iterator[tuple[Any, Region]]:
    """Yield the leaves of a tree of splits, each with its region; the tree must be complete."""
    waiting = [(tree, root)]
    for _ in range(DEEPEST):
        if not waiting:
            return
        node, region = waiting.pop()
        if isinstance(node, dict) and 'split' in node:
            spend((100 if 'wall' in node else 5) * posed.horizon)
            waiting += _parts(posed, node, region)
        else:
            yield node, region
    raise Refused(f'the tree has more than {DEEPEST} nodes')


def _parts(posed: StatedProblem, node: dict[str, Any], region: Region) -> list[tuple[Any, Region]]:
    fields(node, 'a split', ('split', 'parts'), ('at', 'wall', 'speed'))
    k = whole(node['split'], 'split', 1, posed.horizon) - 1
    regions: Sequence[Region | None]
    if 'wall' in node:
        regions = beside(posed, region, k, node['wall'], node.get('at'))
    elif 'at' in node:
        regions = halves(posed, region, k, number(node['at'], 'at'))
    elif 'speed' in node:
        regions = slower(posed, region, k, number(node['speed'], 'speed'))
    else:
        regions = beyond(posed, region, k)
    both = zip(items(node['parts'], 'parts', len(regions)), regions, strict=True)
    return [(part, made) for part, made in both if made is not None]


def root(posed: StatedProblem, origins: Any) -> Region:
    """Return what is known of all trajectories.

    A turn limit says how far directions can be from that of the attitude. Without one, they
    are all directions, counted from an angle of the certificate's choice.
    """
    free: tuple[Any, ...] = (None,) * posed.horizon
    sectors = free
    if posed.turn:
        if origins is not None:
            raise Refused('origins have no use where the attitude is one')
        low, high = _heading(posed)
        turns = [k * posed.turn for k in range(1, posed.horizon + 1)]
        sectors = tuple(Sector(low - each, high + each) for each in turns)
    elif origins is not None:
        if posed.n != 2:
            raise Refused('origins have no use in space')
        starts = vector(origins, 'origins', posed.horizon)
        sectors = tuple(Sector(each, each + TURN) for each in starts)
    return Region(free, sectors, posed.limits.speeds)


def _heading(posed: StatedProblem) -> tuple[Fraction, Fraction]:
    """Return angles just below and above the direction of the attitude."""
    x, y = posed.state.ahead
    angle = Fraction(math.atan2(y, x))
    cosine, sine = direction(angle)
    across, along = abs(cosine * y - sine * x) + 4 * TINY, cosine * x + sine * y
    if along <= 2 * across or abs(x * x + y * y - 1) > ROTATED:
        raise Refused('state.attitude is no rotation')
    off = across / along  # the tangent of an angle, that is more than the angle
    return angle - off, angle + off


def halves(posed: StatedProblem, region: Region, k: int, angle: Fraction) -> list[Region | None]:
    """Return what is known below and above an angle; None where nothing is left."""
    known = region.sectors
    parts = [_narrowed(known, k, each, posed.turn) for each in _cut(known[k], angle)]
    return [None if each is None else region._replace(sectors=each) for each in parts]


def slower(posed: StatedProblem, region: Region, k: int, speed: Fraction) -> list[Region | None]:
    """Return what is known below and above a speed; None where nothing is left."""
    known = region.speeds
    parts = [_narrowed(known, k, each, posed.limits.change) for each in _cut(known[k], speed)]
    return [None if each is None else region._replace(speeds=each) for each in parts]


def _cut(known: Any, at: Fraction) -> tuple[Any, Any]:
    """Return a sector, or a range of speeds, below and above a number."""
    if known is None or not known.low <= at <= known.high:
        raise Refused('a split is not within what it splits')
    return known._replace(high=at), known._replace(low=at)


def _narrowed(known: Ranges, k: int, part: Any, most: Fraction) -> Ranges | None:
    """Put in what is known of a step, and what a limit of changes makes of the others' for it.

    Steps change what it is about by so much at most; where that is 0, there is no such limit.
    """
    made = list(known)
    made[k] = part
    for way in (range(k + 1, len(made)), range(k - 1, -1, -1)) if most else ():
        near = part
        for j in way:
            own = made[j]
            near = own._replace(low=max(own.low, near.low - most),
                                high=min(own.high, near.high + most))  # fmt: skip
            if near.low > near.high:
                return None
            if near == own:  # and so are those beyond
                break
            made[j] = near
    return tuple(made)


def beyond(posed: StatedProblem, region: Region, k: int) -> list[Region | None]:
    """Return what is known beyond each face of a polygonal floor."""
    if not posed.floor.faces or region.faces[k] is not None:
        raise Refused('a split by faces has none to split by')
    before, after = region.faces[:k], region.faces[k + 1 :]
    return [region._replace(faces=(*before, i, *after)) for i in range(posed.floor.faces)]


def beside(posed: StatedProblem, region: Region, k: int, wall: Any, at: Any) -> list[Region]:
    """Return what is known on each side of a wall that s_{k+1} can be on."""
    j = whole(wall, 'wall', 0, len(posed.limits.walls) - 1)
    body = posed.limits.walls[j]
    if isinstance(body, BoxWall):
        if at is not None:
            raise Refused('a split beside a box has no angle')
        sides = range(2 * posed.n)
        return [region._replace(rows=(*region.rows, *body.side(i, k))) for i in sides]
    return [
        region._replace(
            rows=(*region.rows, *body.side(each, k)), passed=(*region.passed, (j, k, each))
        )
        for each in _cut(side_of(region, k, j), number(at, 'at'))
    ]


def side_of(region: Region, k: int, wall: int) -> Sector:
    """Return the directions in which s_{k+1} can be from a disc."""
    told = [each for j, step, each in region.passed if (j, step) == (wall, k)]
    return told[-1] if told else Sector(ZERO, TURN)
