# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bodies that positions are outside of, and what is known of positions beside them."""

from __future__ import annotations

from fractions import Fraction
from typing import Any, NamedTuple

from .exact import NARROW, PI, TINY, ZERO, Vector, direction, dot, less, root_above, size_above
from .reading import Refused, fields, rows, vector, weight
from .regions import Sector, Side


class Lead(NamedTuple):
    """Where a step leads: from its begin, to at most so far from what is known."""

    known: Vector
    far: Fraction


class Wall:
    """A body that positions are outside of, which may move and grow from step to step.

    Args:
        body: as stated: where it moves, its ``shifts`` by the ends of steps 0..N, and by how much
            it is ``grown`` in each; ``shared`` says whether the ends of a step are outside of it
            on one side.
        n: dimension.
        horizon: N.
    """

    shape: tuple[str, str]

    def __init__(self, body: Any, n: int, horizon: int) -> None:
        fields(body, 'a wall', (*self.shape, 'shared'), ('shifts', 'grown'))
        self.shared = body['shared'] is True
        still = [[0.0] * n] * (horizon + 1), [0.0] * horizon
        self._shifts = rows(body.get('shifts', still[0]), 'shifts', horizon + 1, n)
        self._grown = vector(body.get('grown', still[1]), 'grown', horizon)

    def _ends(self, k: int) -> range:
        """Return which positions are on its sides in a step: s_{k+1}, and s_k where shared."""
        return range(max(k - 1, 0) if self.shared else k, k + 1)


class BoxWall(Wall):
    """A wall with corners ``min`` and ``max``."""

    shape = 'min', 'max'

    def __init__(self, body: Any, n: int, horizon: int) -> None:
        super().__init__(body, n, horizon)
        self._low, self._high = (vector(body[name], name, n) for name in self.shape)

    def side(self, i: int, k: int) -> list[Side]:
        """Return what is known of s_{k+1}, and s_k where shared, below (i < n) or above axis i."""
        n = len(self._low)
        axis, sign = i % n, -1 if i < n else 1
        face = self._low[axis] if i < n else self._high[axis]
        normal = [Fraction(sign * (j == axis)) for j in range(n)]
        return [
            Side(j, normal, sign * (face + self._shifts[j + 1][axis]) + self._grown[k])
            for j in self._ends(k)
        ]


class DiscWall(Wall):
    """A wall in the plane with ``centre`` and ``radius``.

    Where the ends of a step are shared, so is the line between them: it is outside.

    Args:
        body: as stated.
        n: dimension.
        leads: where each step leads; none where steps are no lines.
    """

    shape = 'centre', 'radius'

    def __init__(self, body: Any, n: int, horizon: int, leads: list[Lead]) -> None:
        super().__init__(body, n, horizon)
        if n != 2:
            raise Refused('balls in space are beyond this format')
        if self.shared and not leads:
            raise Refused('a disc is shared by the ends of steps that are no lines')
        self._centre = vector(body['centre'], 'centre', 2)
        self._radius = weight(body['radius'], 'radius')
        self._leads = leads

    def _spread(self, k: int) -> Fraction:
        """Return how far the ends of a step are apart at most, as seen from the disc."""
        if not self.shared:
            return ZERO
        moved = less(self._shifts[k + 1], self._shifts[k])
        return self._leads[k].far + size_above(less(self._leads[k].known, moved))

    def place(self, end: int, k: int) -> tuple[Vector, Fraction]:
        """Return its centre by the end of a step, and its radius in step k."""
        both = zip(self._centre, self._shifts[end], strict=True)
        return [x + y for x, y in both], self._radius + self._grown[k]

    def side(self, sector: Sector, k: int) -> list[Side]:
        """Return what is known where the nearest point Q of a step is in such a direction.

        With unit vectors u of the sector and any c, let c . u >= m > 0. Then c . Q >= m |Q|; other
        points P have u . (P - Q) >= 0, and what c has across u is at most sqrt(|c|^2 - m^2).
        """
        radius = self.place(k, k)[1]
        if sector.high - sector.low > PI - NARROW or radius <= 0:
            return []
        c = list(direction((sector.low + sector.high) / 2))
        edges = (direction(each) for each in sector)
        m = min(c[0] * x + c[1] * y for x, y in edges) - 4 * TINY
        if m <= 0:
            return []
        least = m * radius - self._spread(k) * root_above(max(ZERO, dot(c, c) - m * m))
        return [Side(j, c, least + dot(c, self.place(j + 1, k)[0])) for j in self._ends(k)]


def wall(body: Any, n: int, horizon: int, leads: list[Lead]) -> BoxWall | DiscWall:
    """Return a wall as it is stated."""
    if isinstance(body, dict) and 'radius' in body:
        return DiscWall(body, n, horizon, leads)
    return BoxWall(body, n, horizon)
