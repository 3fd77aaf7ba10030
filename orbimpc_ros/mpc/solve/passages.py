# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The choices that bodies which are round or move leave: on which side each is passed.

A step stays clear of a convex body that moves evenly just if some plane separates all of the step
from it: for its control points P_i, relative to the body, and a unit normal n,

    n . P_i >= the body's extent along n,    all i.

A ball of radius rho has the extent rho along any n, and n may be the direction of the point Q of
the step's hull that is nearest to its centre. Normals are chosen from patches of the sphere that
are cut ever finer. With n within an angle d of the middle c of a patch, n . (P_i - Q) >= 0 and
|P_i - Q| <= D, the points are beyond

    c . P_i >= rho cos d - D sin d,

and a single point is beyond rho cos d. Both ends of every step are therefore choices of their own
as well: those bound more. Of a box, the faces are the normals.

Mathematics: docs/mathematics.md, 3.7.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.cells import Cell, round_cells
from orbimpc_ros.mpc.geometry.separation import separation
from orbimpc_ros.mpc.model.motion import coasting_controls, control_maps
from orbimpc_ros.mpc.problem import Ball, Box, Problem, State
from orbimpc_ros.mpc.problem.traffic import Traffic
from orbimpc_ros.mpc.solve.relaxation import Halfspace, Point

SATISFIED = 1e-7  # a tenth of what the plan's check allows
REFUTED = 1e-6  # what is decided by so much on the wrong side is no way


@dataclass(frozen=True, eq=False)
class Passage:
    """The choice of a side for the control points of a step, or for the end of one.

    Attributes:
        rows: what R_1 e1..R_N e1 add to the points, shape (m, N).
        free: where the points are without, relative to the body, shape (m, n).
        radius: of a ball; zero for a box.
        cells: the alternatives: of a ball, for radius one.
        first: number of the first control point.
        grown: by how much a box counts as larger.
        spread: D, how far apart the points get at most.
    """

    rows: Array
    free: Array
    radius: float
    cells: tuple[Cell, ...]
    first: int
    grown: float = 0.0
    spread: float = 0.0

    def offsets(self, cells: Sequence[Cell]) -> Array:
        """Return what n . P_i is at least beyond cells, shape (cells, m)."""
        shares = np.array([cell.offset for cell in cells])[:, None]
        least = shares + self.grown
        if self.radius:
            least = self.radius * shares - self.spread * np.sqrt(np.maximum(1.0 - shares**2, 0.0))
        return np.repeat(least, len(self.free), axis=1)

    def shortfall(self, cells: Sequence[Cell], values: Array) -> Array:
        """Return by how much points, shape (m, n), miss each cell, shape (cells, m)."""
        return self.offsets(cells) - _normals(cells) @ values.T

    def possible(self, cells: Sequence[Cell]) -> list[Cell]:
        """Return the cells that the points can get beyond."""
        most = _normals(cells) @ self.free.T + np.abs(self.rows).sum(axis=1)
        within = (self.offsets(cells) <= most + REFUTED).all(axis=1)
        return [cell for cell, each in zip(cells, within, strict=True) if each]

    def halfspaces(self, cell: Cell) -> Iterator[Halfspace]:
        """Yield what a cell asks of R_1 e1..R_N e1, for every point that they move."""
        offsets = self.offsets([cell])[0] - self.free @ cell.normal
        for i in np.flatnonzero(self.moved):
            yield Point(self.first + int(i), self.rows[i]), cell.normal, float(offsets[i])

    @cached_property
    def moved(self) -> np.ndarray:
        """Return whether each point is moved at all, shape (m,)."""
        return np.asarray(self.rows.any(axis=1))

    def nearest(self, values: Array) -> Cell:
        """Return the cell that points, shape (m, n), miss least; of a ball, a tangent plane."""
        if self.radius:
            return Cell(separation(values)[0], 1.0)
        short = self.shortfall(self.cells, values).max(axis=1)
        return self.cells[int(np.argmin(short))]


def _normals(cells: Sequence[Cell]) -> Array:
    return np.array([cell.normal for cell in cells])


class Passages:
    """All choices of a request, and which of them a trajectory misses.

    Args:
        problem: what to solve.
        state: where the plan starts.
        traffic: what is to be stayed clear of.

    Attributes:
        choices: the passages: of each body and step the whole step, then its end.
    """

    def __init__(self, problem: Problem, state: State, traffic: Traffic) -> None:
        maps = control_maps(problem)
        self._maps, free = maps[:, :, 1:], coasting_controls(problem, state)
        free = free + maps[:, :, :1] * state.rotation[:, 0]
        weights = np.linspace(0.0, 1.0, maps.shape[1])[:, None]
        begin, end = traffic.shifts[:, :-1, None], traffic.shifts[:, 1:, None]
        centres = np.array([_centre(each) for each in traffic.bodies])
        moved = begin + weights * (end - begin) + centres[:, None, None]
        self._free = free - moved  # (J, N, m, n)
        self._spread = _spread(self._maps, self._free)
        sizes = np.array(
            [each.radius if isinstance(each, Ball) else 0.0 for each in traffic.bodies]
        )
        self._round = sizes > 0.0
        # A body shrunk to nothing, as it may be for who leaves it, is passed anywhere.
        radii = np.maximum(sizes[:, None] + traffic.grown, 0.0)
        self._radii = np.where(self._round[:, None], radii, 0.0)
        self._active = (~self._round)[:, None] | (self._radii > 0.0)
        self._larger = traffic.grown
        self.choices = list(self._made(traffic))

    def _made(self, traffic: Traffic) -> Iterator[Passage]:
        last = self._maps.shape[1] - 1
        steps = [(k * (last + 1), rows, rows[last:]) for k, rows in enumerate(self._maps)]
        sizes = np.stack([self._radii, self._larger, self._spread], axis=-1).tolist()
        for body, every, known in zip(traffic.bodies, self._free, sizes, strict=True):
            cells = body.cells() if isinstance(body, Box) else round_cells(body.dimension, 1.0)
            for (first, rows, end), free, (radius, grown, spread) in zip(
                steps, every, known, strict=True
            ):
                yield Passage(rows, free, radius, cells, first, grown, spread)
                yield Passage(end, free[last:], radius, cells, first + last, grown)

    def near(self, headings: Array, within: float) -> dict[int, tuple[float, Array]]:
        """Return, by choice that is missed or nearly so, by how much and where the points are.

        Args:
            headings: R_1 e1..R_N e1, shape (N, n).
            within: what a body is nearer than, in excess of where it may be.
        """
        points = self._free + self._maps @ headings
        short = np.full((*self._radii.shape, 2), -np.inf)
        if self._round.any():
            _, apart = separation(points[self._round])
            ends = np.linalg.norm(points[self._round][:, :, -1], axis=-1)
            radii = self._radii[self._round]
            short[self._round] = np.stack([radii - apart, radii - ends], axis=-1)
        for j in np.flatnonzero(~self._round).tolist():
            short[j] = self._beside(self.choices[2 * j * len(self._maps)].cells, j, points[j])
        found = np.argwhere((short > -within) & self._active[:, :, None])
        steps = points.shape[1]
        return {
            int(2 * (j * steps + k) + i): (
                float(short[j, k, i]),
                points[j, k] if i == 0 else points[j, k, -1:],
            )
            for j, k, i in found
        }

    def _beside(self, faces: Sequence[Cell], j: int, points: Array) -> Array:
        """Return by how much steps, shape (N, m, n), and their ends are inside a box, (N, 2)."""
        offsets = np.array([face.offset for face in faces])
        beyond = points @ _normals(faces).T - offsets - self._larger[j][:, None, None]
        return np.stack([-beyond.min(axis=1).max(axis=1), -beyond[:, -1].max(axis=1)], axis=1)

    def tangents(self, headings: Array, within: float) -> Iterator[tuple[int, Cell]]:
        """Yield, by choice of a whole step, the cell on whose side a way passes what is near it.

        Args:
            headings: R_1 e1..R_N e1 of the way, shape (N, n).
            within: what a body is nearer than.
        """
        points = self._free + self._maps @ headings
        normals, apart = separation(points)
        near = self._active & ((apart - self._radii < within) | ~self._round[:, None])
        for j, k in np.argwhere(near):
            number = int(2 * (j * points.shape[1] + k))
            if self._round[j]:
                yield number, Cell(normals[j, k], 1.0)
            else:
                yield number, self.choices[number].nearest(points[j, k])

    def curvatures(self, inverse: Array) -> list[Array]:
        """Return a.H^-1 a of each choice's points, shapes (m,); infinite where all is decided.

        Args:
            inverse: H^-1, shape (N, N).
        """
        if not np.isfinite(inverse).all():
            return [np.full(len(each.free), np.inf) for each in self.choices]
        along = np.einsum('kmi,ij,kmj->km', self._maps, inverse, self._maps)
        along = np.where(along > 0.0, along, np.inf)
        each = [part for row in along for part in (row, row[-1:])]
        return each * len(self._radii)


def _centre(body: Box | Ball) -> Array:
    """Return what a body's cells are relative to: of a box, the origin."""
    return body.centre if isinstance(body, Ball) else np.zeros(body.dimension)


def _spread(maps: Array, free: Array) -> Array:
    """Return how far apart the control points of each step get at most, shape (J, N)."""
    moved = np.abs(maps[:, :, None] - maps[:, None]).sum(axis=-1)
    apart = np.linalg.norm(free[:, :, :, None] - free[:, :, None], axis=-1)
    return np.asarray((moved + apart).max(axis=(-1, -2)))
