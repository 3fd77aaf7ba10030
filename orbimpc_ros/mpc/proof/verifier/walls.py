# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bodies that positions are outside of, and what is known of positions beside them."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations_with_replacement
from typing import Any

from .exact import NARROW, PI, TINY, ZERO, Vector, direction, root_above, size_above
from .motion import Place, Step
from .reading import Refused, fields, rows, vector, weight, word
from .regions import Sector, Side


class Wall:
    """A body that vehicles are outside of, which may move and grow from step to step.

    Args:
        body: as stated. What is on one side of it is, ``of`` each step, its ``end``, both ``ends``,
            or all of the ``step``: its control points. Where it moves, ``shifts`` says how far by
            the ends of steps 0..N, and ``grown`` how much it grows in each.
        n: dimension.
        steps: the control points of each step.
    """

    shape: tuple[str, str]

    def __init__(self, body: Any, n: int, steps: list[Step]) -> None:
        fields(body, 'a wall', (*self.shape, 'of'), ('shifts', 'grown'))
        horizon = len(steps)
        self.of = word(body['of'], 'of', ('end', 'ends', 'step'))
        still = [[0.0] * n] * (horizon + 1), [0.0] * horizon
        self._shifts = rows(body.get('shifts', still[0]), 'shifts', horizon + 1, n)
        self._grown = vector(body.get('grown', still[1]), 'grown', horizon)
        self._steps = steps
        self._middle = Vector([0] * n)

    def told(self, k: int) -> list[tuple[Place, Vector]]:
        """Return the places of step k that are on one of its sides, and where its middle is then.

        Both ends are so from the second step on: how the first one begins is the state's.
        """
        places, begin = self._steps[k], self._middle + self._shifts[k]
        last, moved = len(places) - 1, self._shifts[k + 1] - self._shifts[k]
        both = [0, last] if k else [last]
        return [
            (places[i], begin + moved * Fraction(i, last))
            for i in {'end': [last], 'ends': both, 'step': range(last + 1)}[self.of]
        ]


class BoxWall(Wall):
    """A wall with corners ``min`` and ``max``."""

    shape = 'min', 'max'

    def __init__(self, body: Any, n: int, steps: list[Step]) -> None:
        super().__init__(body, n, steps)
        self._low, self._high = (vector(body[name], name, n) for name in self.shape)

    def side(self, i: int, k: int) -> list[Side]:
        """Return what is known of step k below (i < n) or above axis i."""
        n = len(self._low)
        axis, sign = i % n, -1 if i < n else 1
        face = self._low[axis] if i < n else self._high[axis]
        normal = Vector([sign * (j == axis) for j in range(n)])
        return [
            Side(place, normal, sign * (face + shift[axis]) + self._grown[k])
            for place, shift in self.told(k)
        ]


class DiscWall(Wall):
    """A wall with ``centre`` and ``radius``; only in the plane it has sides."""

    shape = 'centre', 'radius'

    def __init__(self, body: Any, n: int, steps: list[Step], fastest: Fraction) -> None:
        super().__init__(body, n, steps)
        self._middle = vector(body['centre'], 'centre', n)
        self._radius = weight(body['radius'], 'radius')
        self._fastest = fastest

    def spread(self, k: int) -> Fraction:
        """Return how far places of a step are apart at most, as seen from the disc."""
        return max(
            size_above(a.free - x - b.free + y)
            + self._fastest * sum(map(abs, a.reach - b.reach), ZERO)
            for (a, x), (b, y) in combinations_with_replacement(self.told(k), 2)
        )

    def radius(self, k: int) -> Fraction:
        """Return its radius in step k."""
        return self._radius + self._grown[k]

    def side(self, sector: Sector, k: int) -> list[Side]:
        """Return what is known where the nearest point Q of step k is in such a direction.

        With unit vectors u of the sector and any c, let c . u >= m > 0. Then c . Q >= m |Q|; other
        points P have u . (P - Q) >= 0, and what c has across u is at most sqrt(|c|^2 - m^2).
        """
        if len(self._middle) != 2 or self.of == 'ends':
            raise Refused('balls in space, and discs of both ends, have no sides')
        radius = self.radius(k)
        if sector.high - sector.low > PI - NARROW or radius <= 0:
            return []
        c = Vector.of(direction((sector.low + sector.high) / 2))
        edges = (direction(each) for each in sector)
        m = min(c[0] * x + c[1] * y for x, y in edges) - 4 * TINY
        if m <= 0:
            return []
        least = m * radius - self.spread(k) * root_above(max(ZERO, c @ c - m * m))
        return [Side(place, c, least + c @ middle) for place, middle in self.told(k)]


def wall(body: Any, n: int, steps: list[Step], fastest: Fraction) -> BoxWall | DiscWall:
    """Return a wall as it is stated; no z_1..z_N are longer than the fastest."""
    if isinstance(body, dict) and 'radius' in body:
        return DiscWall(body, n, steps, fastest)
    return BoxWall(body, n, steps)
