# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Turn limits as angles, for a search whose relaxations bound only chords.

With a floor, the chord of a turn by the widest angle a depends on the speeds before and after it; a
relaxation allows the longest chord. To find a trajectory, headings are confined to *cells*, beyond
tangents or faces of the floor, in which their speeds are at least r_k, and the chord between
consecutive headings to the distance between two points at the radii r_k and r_{k+1} with the angle
a between them: then no turn is too wide.

Mathematics: docs/mathematics.md, 3.6.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import turn_margin
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED, turned_within
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.relaxation import Row

WITHIN = 1.0 - 1e-6  # share of the widest turn
KEPT = 0.9  # share of its speed that a heading keeps in the next solve
THIN, WIDEST = 1e-9, 1.5  # [rad] least half-angle of a cone; largest, since tan grows without limit


class Turns:
    """The turns of a problem with a floor and a ``max_rate``.

    Args:
        problem: what to solve.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, floor, n = problem, problem.floor, problem.dimension
        self._widest, self._least = WITHIN * problem.widest_turn, problem.least_speed
        self._shares = np.eye(problem.horizon)
        # A speed allowed in every heading, and a turn with no longer a chord than at least speed.
        self._speed = floor.circling(n)
        half = self._least * math.sin(0.5 * self._widest) / self._speed
        self._turn = 2.0 * math.asin(min(1.0, half))
        first = 2 if problem.first_turn_is_a_cone else 1
        most = min(problem.horizon, math.ceil(math.pi / problem.widest_turn) - 1)
        self._steps = range(first, most + 1) if problem.rotation_order == 1 else range(0)

    def rows(self, state: State, *, narrow: bool = False) -> tuple[Row, ...]:
        """Return half-spaces that hold for all headings the vehicle can have reached by a step.

        There are none at rotation order 2, nor for a first turn bounded by a cone.

        Args:
            state: initial state of plans.
            narrow: whether the half-space of the first turn has to imply its angle limit.
        """
        axis, found = state.attitude[:, 0], list[Row]()
        for k in self._steps:
            share = math.cos(k * self._problem.widest_turn)
            least = self._narrow if narrow and k == 1 else min(share, self._least * share)
            found.append(Row(k - 1, self._shares[k - 1], axis, least))
        return tuple(found)

    @property
    def _narrow(self) -> float:
        """Return a lower limit on Q_0 e1 . R_1 e1 within which no first turn is too wide."""
        share = math.cos(self._widest)
        return max(share, self._least * share)

    def reached(self, state: State, headings: Array) -> tuple[Row, ...]:
        """Return a cell for each step around headings that follow given ones as turns allow.

        Args:
            state: initial state of the plan.
            headings: the given ones, R_0 e1..R_N e1, shape (N + 1, n).
        """
        cells, unit = [], state.attitude[:, 0]
        for k, heading in enumerate(headings[1:], 1):
            widest = self._turn if k > 1 else self._first()
            size = float(np.linalg.norm(heading))
            wanted = heading / size if size > HEADING_UNDEFINED else unit
            given = k == 1 and self._problem.rotation_order == 2
            unit = wanted if given else turned_within(unit, wanted, widest)
            cells.append(self._cell(k - 1, unit))
        return tuple(cells)

    def kept(self, headings: Array) -> tuple[Row, ...]:
        """Return the cells of headings R_1 e1..R_N e1, raised to nearly their speeds.

        Args:
            headings: R_0 e1..R_N e1, shape (N + 1, n).
        """
        cells = []
        for k, heading in enumerate(headings[1:]):
            cell = self._cell(k, heading / max(float(np.linalg.norm(heading)), HEADING_UNDEFINED))
            fast = KEPT * float(cell.normal @ heading)
            cells.append(cell._replace(offset=max(cell.offset, fast)))
        return tuple(cells)

    def cones(self, state: State, headings: Array) -> tuple[Row, ...]:
        """Return half-spaces about headings R_0 e1..R_N e1 in which any speeds turn in time."""
        sizes = np.maximum(np.linalg.norm(headings, axis=1, keepdims=True), HEADING_UNDEFINED)
        halves = np.maximum(spared(self._problem, state, headings), THIN).tolist()
        units, first = (headings / sizes)[1:], self._problem.rotation_order - 1
        return tuple(row for k, half in enumerate(halves, first) for row in cone(k, units, half))

    def close(self, cells: Sequence[Row]) -> Array:
        """Return limits on chords that imply the angle limit for headings in these cells."""
        speeds = np.array([cell.offset for cell in cells])
        slow, fast = np.minimum(speeds[1:], speeds[:-1]), np.maximum(speeds[1:], speeds[:-1])
        share = math.cos(self._widest)
        slow = np.maximum(slow, fast * share)
        return np.sqrt(slow * slow + fast * fast - 2.0 * slow * fast * share)

    def _first(self) -> float:
        """Return a first turn [rad] allowed by its cone, or by its half-space if it has none."""
        if self._problem.first_turn_is_a_cone:
            return self._turn
        return min(self._turn, math.acos(max(-1.0, min(1.0, self._narrow / self._speed))))

    def _cell(self, k: int, unit: Array) -> Row:
        """Return the tangent of a round floor, or the face nearest to a direction, (n,)."""
        return Row(k, self._shares[k], self._problem.floor.tangent(unit), self._least)


def spared(problem: Problem, state: State, headings: Array, leeway: float = 0.0) -> Array:
    """Return the angle that each free direction can deviate by, whatever others do [rad].

    Negative where a turn is already too wide by more than ``leeway``.
    """
    left = leeway + turn_margin(problem, state, headings)[problem.rotation_order - 1 :]
    left[1:] *= 0.5  # shared by both directions; the first turn is from a fixed one
    return np.asarray(np.minimum(left, np.append(left[1:], np.inf)))


def cone(k: int, units: Array, half: float) -> list[Row]:
    """Return half-spaces whose intersection is within a cone about direction k.

    Args:
        k: the step, from 0.
        units: directions, shape (N, n).
        half: half-angle of the cone [rad]; 0 for planes that intersect in its axis.
    """
    _, _, across = np.linalg.svd(units[k : k + 1])
    sides = np.vstack([across[1:], -across[1:]]) if half else across[1:]
    wide = math.tan(min(half, WIDEST)) / math.sqrt(len(across) - 1)
    return [Row(k, np.eye(len(units))[k], wide * units[k] + side, 0.0) for side in sides]
