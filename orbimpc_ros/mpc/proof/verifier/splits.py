# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Trees of splits: whatever a trajectory does, it is in one of the parts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

from .exact import TINY, TURN, ZERO, direction
from .reading import Refused, fields, items, number, vector, whole
from .regions import Region, Sector
from .stated import StatedProblem
from .walls import BoxWall

DEEPEST = 100_000


def leaves(posed: StatedProblem, tree: Any, root: Region) -> Iterator[tuple[Any, Region]]:
    """Yield the leaves of a tree of splits, each with its region; the tree must be complete."""
    waiting = [(tree, root)]
    for _ in range(DEEPEST):
        if not waiting:
            return
        node, region = waiting.pop()
        if isinstance(node, dict) and 'split' in node:
            waiting += _parts(posed, node, region)
        else:
            yield node, region
    raise Refused(f'the tree has more than {DEEPEST} nodes')


def _parts(posed: StatedProblem, node: dict[str, Any], region: Region) -> list[tuple[Any, Region]]:
    fields(node, 'a split', ('split', 'parts'), ('at', 'wall'))
    k = whole(node['split'], 'split', 1, posed.horizon) - 1
    regions: Sequence[Region | None]
    if 'wall' in node:
        regions = beside(posed, region, k, node['wall'], node.get('at'))
    elif 'at' in node:
        regions = halves(posed, region, k, number(node['at'], 'at'))
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
    if posed.turn:
        if origins is not None:
            raise Refused('origins have no use where the attitude is one')
        low, high = _heading(posed)
        turns = [k * posed.turn for k in range(1, posed.horizon + 1)]
        return Region(free, tuple(Sector(low - each, high + each) for each in turns))
    if origins is None:
        return Region(free, free)
    starts = vector(origins, 'origins', posed.horizon)
    return Region(free, tuple(Sector(each, each + TURN) for each in starts))


def _heading(posed: StatedProblem) -> tuple[Fraction, Fraction]:
    """Return angles just below and above the direction of the attitude."""
    x, y = posed.state.ahead
    angle = Fraction(math.atan2(y, x))
    cosine, sine = direction(angle)
    across, along = abs(cosine * y - sine * x) + 4 * TINY, cosine * x + sine * y
    if along <= 2 * across:
        raise Refused('state.attitude is no rotation')
    off = across / along  # the tangent of an angle, that is more than the angle
    return angle - off, angle + off


def halves(posed: StatedProblem, region: Region, k: int, angle: Fraction) -> list[Region | None]:
    """Return what is known below and above an angle; None where nothing is left."""
    return [_narrowed(posed, region, k, each) for each in _cut(region.sectors[k], angle)]


def _cut(sector: Sector | None, angle: Fraction) -> tuple[Sector, Sector]:
    if sector is None or not sector.low <= angle <= sector.high:
        raise Refused('a split is not within the directions that it splits')
    return Sector(sector.low, angle), Sector(angle, sector.high)


def _narrowed(posed: StatedProblem, region: Region, k: int, sector: Sector) -> Region | None:
    """Put a sector in, and what a turn limit makes of the others' for it."""
    sectors = list(region.sectors)
    sectors[k] = sector
    for way in (range(k + 1, posed.horizon), range(k - 1, -1, -1)) if posed.turn else ():
        near = sector
        for j in way:
            own = sectors[j]
            assert own is not None
            near = Sector(max(own.low, near.low - posed.turn),
                          min(own.high, near.high + posed.turn))  # fmt: skip
            if near.low > near.high:
                return None
            if near == own:  # and so are those beyond
                break
            sectors[j] = near
    return region._replace(sectors=tuple(sectors))


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
