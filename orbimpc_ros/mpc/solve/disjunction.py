# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Choices that make a problem mixed-integer: at least one half-space of a list must hold.

The paper writes them with binaries and a big M; here they are kept as what they are, so there is
no M to leak. A floor is one choice of face per step, an obstacle one choice of side per step.

Mathematics: docs/mathematics.md, 3.8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.cells import STEEPEST_CAP, Cell, cap_cells
from orbimpc_ros.mpc.problem import Problem


@dataclass(frozen=True)
class Slot:
    """What a half-space can be put on: R_k e1 (``heading``) or s_k (``position``), k in 1..N."""

    on: Literal['heading', 'position']
    step: int


@dataclass(frozen=True)
class Disjunction:
    """One cell must hold for v_k at every k of ``steps``, or, for a round floor, |v_k| >= radius.

    Attributes:
        on: what v_k is: ``heading``, R_k e1, or ``position``, s_k.
        steps: the k (1..N) that must agree on a cell.
        cells: the alternatives; for a round floor they cover it and can be cut finer.
        radius: of a round floor; zero for one of flat faces.
        upright: the alternatives where v_k is within the tilt that is allowed; empty where those
            are no fewer.
    """

    on: Literal['heading', 'position']
    steps: tuple[int, ...]
    cells: tuple[Cell, ...]
    radius: float = 0.0
    upright: tuple[Cell, ...] = ()

    @property
    def slots(self) -> tuple[Slot, ...]:
        """Return what the cells are half-spaces of, one slot per step."""
        return tuple(Slot(self.on, k) for k in self.steps)

    def values(self, headings: Array, positions: Array) -> Array:
        """Return v_k for k in ``steps``, shape (len(steps), n), of a trajectory.

        Args:
            headings: R_0 e1..R_N e1, shape (N + 1, n).
            positions: s_0..s_N, shape (N + 1, n).
        """
        return (headings if self.on == 'heading' else positions)[list(self.steps)]

    def shortfall(self, cells: Sequence[Cell], values: Array) -> Array:
        """Return by how much values, shape (K, n), miss each cell, shape (cells, K)."""
        return shortfall(cells, values)

    @cached_property
    def _sides(self) -> tuple[Array, Array]:
        return _sides_of(self.cells)

    def missed_by(self, values: Array) -> float:
        """Return how far ``values``, shape (len(steps), n), are from satisfying it; <= 0 if so."""
        if self.radius:
            return float(self.radius - np.linalg.norm(values, axis=1).min())
        offsets, normals = self._sides
        return float((offsets - normals @ values.T).max(axis=1).min())


def shortfall(cells: Sequence[Cell], values: Array) -> Array:
    """Return by how much values, shape (K, n), miss each cell, shape (cells, K); <= 0 inside."""
    offsets, normals = _sides_of(cells)
    return np.asarray(offsets - normals @ values.T)


def _sides_of(cells: Sequence[Cell]) -> tuple[Array, Array]:
    """Return offsets, shape (cells, 1), and normals, shape (cells, n)."""
    offsets = np.array([[cell.offset] for cell in cells])
    return offsets, np.array([cell.normal for cell in cells])


def disjunctions_of(problem: Problem) -> tuple[Disjunction, ...]:
    """Return every choice of a problem: its floor's and its obstacles'."""
    return (*_floor(problem), *_obstacles(problem))


def _floor(problem: Problem) -> list[Disjunction]:
    cells, radius = problem.floor.cells(problem.dimension), problem.floor.radius
    steps = range(1, problem.horizon + 1) if cells else ()
    upright: tuple[Cell, ...] = ()
    if radius and 0.0 < problem.tilt <= STEEPEST_CAP:
        upright = cap_cells(problem.tilt, radius)
    return [Disjunction('heading', (k,), cells, radius, upright) for k in steps]


def _obstacles(problem: Problem) -> list[Disjunction]:
    last = problem.horizon
    if problem.no_corner_cutting and last > 1:
        # A segment whose ends share a free face cannot cut through the box.
        groups: list[tuple[int, ...]] = [(k, k + 1) for k in range(1, last)]
    else:
        groups = [(k,) for k in range(1, last + 1)]
    sides = [box.cells() for box in problem.boxes]
    return [Disjunction('position', steps, cells) for cells in sides for steps in groups]
