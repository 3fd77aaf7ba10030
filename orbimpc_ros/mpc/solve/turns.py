# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The angle of each turn, for a search whose relaxations know it as a chord.

With a floor f, headings that turn by an angle a at most are up to a chord apart that depends on
their speeds. A relaxation allows the longest. To find a trajectory, headings are held beyond cells
that keep them at least as fast as some r_k, and so close to each other that no angle is too wide:
the distance of two arcs of radii r_k and r_{k+1}, a apart.

Mathematics: docs/mathematics.md, 3.6.
"""

from __future__ import annotations

import math

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.faces import Cell
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.relaxation import Row

WITHIN = 1.0 - 1e-6  # of the widest turn
ACCURATE = 5e-7  # [rad], half of what the plan's check allows
KEPT = 0.9  # of a speed, from one trajectory to the next


class Turns:
    """The turns of a problem with a floor and a ``max_rate``.

    Args:
        problem: gives both.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, floor, n = problem, problem.floor, problem.dimension
        self._widest, self._least = WITHIN * problem.widest_turn, floor.clearance(n)
        self._cells = () if floor.radius else floor.cells(n)
        # At this speed every heading is allowed; its turns are no longer than the slowest ones'.
        self._speed = floor.circling(n)
        half = self._least * math.sin(0.5 * self._widest) / self._speed
        self._turn = 2.0 * math.asin(min(1.0, half))
        first = 2 if problem.first_turn_is_a_cone else 1
        most = min(problem.horizon, math.ceil(math.pi / problem.widest_turn) - 1)
        self._steps = range(first, most + 1) if problem.rotation_order == 1 else range(0)

    def hold(self, state: State, headings: Array) -> bool:
        """Return whether no turn of headings R_0 e1..R_N e1, shape (N + 1, n), is too wide."""
        units = headings / np.maximum(np.linalg.norm(headings, axis=1), HEADING_UNDEFINED)[:, None]
        units[0] = state.attitude[:, 0]
        chords = np.linalg.norm(np.diff(units, axis=0), axis=1)
        decided = int(self._problem.first_turn_is_decided)
        widest = self._problem.widest_turn + ACCURATE
        return bool((2.0 * np.arcsin(np.minimum(1.0, 0.5 * chords[decided:])) <= widest).all())

    def rows(self, state: State, *, narrow: bool = False) -> tuple[Row, ...]:
        """Return half-spaces that hold for all that the vehicle can have turned by a step.

        None at rotation order 2, nor for a first turn within a cone.

        Args:
            state: where plans start.
            narrow: whether the first turn is to be surely in time.
        """
        axis, units, found = state.attitude[:, 0], np.eye(self._problem.horizon), list[Row]()
        for k in self._steps:
            share = math.cos(k * self._problem.widest_turn)
            least = self._narrow if narrow and k == 1 else min(share, self._least * share)
            found.append(Row(k - 1, units[k - 1], axis, least))
        return tuple(found)

    @property
    def _narrow(self) -> float:
        """Return a value of Q_0 e1 . R_1 e1 from which on no first turn is too wide."""
        share = math.cos(self._widest)
        return max(share, self._least * share)

    def reached(self, state: State, headings: Array) -> list[Cell]:
        """Return a cell for each step around headings that can be reached from the present one.

        Args:
            state: where the plan starts.
            headings: R_0 e1..R_N e1, shape (N + 1, n), to be followed as turns allow.
        """
        cells, unit = [], state.attitude[:, 0]
        for k, heading in enumerate(headings[1:], 1):
            widest = self._turn if k > 1 else self._first()
            size = float(np.linalg.norm(heading))
            wanted = heading / size if size > HEADING_UNDEFINED else unit
            given = k == 1 and self._problem.rotation_order == 2
            unit = wanted if given else _towards(unit, wanted, widest)
            cells.append(self._cell(unit))
        return cells

    def kept(self, headings: Array) -> list[Cell]:
        """Return a cell for each step that headings R_0 e1..R_N e1 are in, nearly as fast."""
        cells = []
        for heading in headings[1:]:
            cell = self._cell(heading / max(float(np.linalg.norm(heading)), HEADING_UNDEFINED))
            fast = KEPT * float(cell.normal @ heading)
            cells.append(Cell(cell.normal, max(cell.offset, fast)))
        return cells

    def close(self, cells: list[Cell]) -> Array:
        """Return the chords within which headings of these cells turn by no wider an angle."""
        speeds = np.array([cell.offset for cell in cells])
        slow, fast = np.minimum(speeds[1:], speeds[:-1]), np.maximum(speeds[1:], speeds[:-1])
        share = math.cos(self._widest)
        slow = np.maximum(slow, fast * share)
        return np.sqrt(slow * slow + fast * fast - 2.0 * slow * fast * share)

    def _first(self) -> float:
        """Return a first turn that the cone, or the half-space of a wider one, allows."""
        if self._problem.first_turn_is_a_cone:
            return self._turn
        return min(self._turn, math.acos(max(-1.0, min(1.0, self._narrow / self._speed))))

    def _cell(self, unit: Array) -> Cell:
        """Return the tangent of a round floor, or the face nearest to a direction, shape (n,)."""
        if not self._cells:
            return Cell(unit, self._least)
        return max(self._cells, key=lambda cell: float(cell.normal @ unit) - cell.offset)


def _towards(unit: Array, wanted: Array, widest: float) -> Array:
    """Return a direction, shape (n,), turned towards another by an angle at most."""
    along = float(unit @ wanted)
    aside = wanted - along * unit
    size = float(np.linalg.norm(aside))
    angle = math.atan2(size, along)
    if angle <= widest:
        return wanted
    if size <= HEADING_UNDEFINED:
        other = np.eye(len(unit))[np.argmin(np.abs(unit))]
        aside = other - unit * (unit @ other)
        size = float(np.linalg.norm(aside))
    turned: Array = math.cos(widest) * unit + math.sin(widest) * aside / size
    return turned
