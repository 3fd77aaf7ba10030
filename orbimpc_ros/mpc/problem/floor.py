# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Floors: the least speed of a vehicle, as the set of thrust axes R e1 that it may fly.

A shape of floor is one class, in one file, registered under the word that selects it. It covers
the axes that it allows by half-spaces; methods, the check, safe commands, parameters and pictures
know a floor by nothing else. Methods that are faster for some shapes say so themselves.

Mathematics: docs/mathematics.md, 3.3 and 3.4.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array, number, whole
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.faces import Cell, Lines, edges, normals, sphere

SOLID_FACES = (6, 12, 20)  # cube, dodecahedron, icosahedron
MAX_FACES = 64


@dataclass(frozen=True)
class Floor:
    """Minimum speed: which thrust axes v = R_k e1, k = 1..N, are allowed.

    Attributes:
        shape: ``none``; ``polygon``, the paper's: v beyond one of the faces of a regular polygon
            (n = 2) or solid (n = 3); ``circle``, the true floor |v| >= fraction; or the word of
            another registered :class:`Shape`.
        faces: of the polygon, >= 3, or of the solid, 6, 12 or 20.
        fraction: of full speed, in (0, 1]. The paper's det R > 0.3 is sqrt(0.3) for n = 2.
    """

    shape: str = 'none'
    faces: int = 4
    fraction: float = math.sqrt(0.3)

    def __post_init__(self) -> None:
        if not isinstance(self.shape, str) or self.shape not in SHAPES:
            raise BadInput.choice('floor.shape', self.shape, tuple(SHAPES))
        whole(self.faces, 'floor.faces', 3, MAX_FACES)
        number(self.fraction, 'floor.fraction', 0.0, 1.0, above=True)

    def validate(self, dimension: int) -> None:
        """Refuse what vehicles of a dimension cannot have.

        Raises:
            BadInput: naming the parameter at fault.
        """
        SHAPES[self.shape].validate(self, dimension)

    def clearance(self, dimension: int) -> float:
        """Return what every allowed |v| is at least, in [0, 1]; 0 without a floor."""
        return SHAPES[self.shape].clearance(self, dimension)

    @cached_property
    def exists(self) -> bool:
        """Return whether any speed is forbidden."""
        return self.shape != 'none'

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the fields that the shape has a use for."""
        return SHAPES[self.shape].parameters

    @property
    def radius(self) -> float:
        """Return the radius of a round floor; 0 for one whose cells are flat, and without one."""
        return SHAPES[self.shape].radius(self)

    def cells(self, dimension: int) -> tuple[Cell, ...]:
        """Return the half-spaces whose union is all that is allowed; none of a round floor."""
        return SHAPES[self.shape].cells(self, dimension)

    def margin(self, axes: Array) -> Array:
        """Return by how much axes, shape (K, n), clear the floor, shape (K,); < 0 below it."""
        return SHAPES[self.shape].margin(self, axes)

    def least(self, axes: Array) -> Array:
        """Return the least speed fraction allowed along unit vectors, shape (..., n): (...)."""
        return SHAPES[self.shape].least(self, axes)

    def circling(self, dimension: int) -> float:
        """Return a speed fraction that is allowed in every heading: the least, or full speed."""
        return SHAPES[self.shape].circling(self, dimension)

    def outline(self, dimension: int) -> Lines:
        """Return lines, shape (K, 3) each, along the boundary of what is forbidden."""
        return _outline(self, dimension)

    def __str__(self) -> str:
        return SHAPES[self.shape].described(self)


class Shape(ABC):
    """A kind of floor; by its ``cells`` alone a union of half-spaces.

    Attributes:
        parameters: names of the fields of :class:`Floor` that it has a use for.
    """

    parameters: tuple[str, ...] = ('fraction',)

    @abstractmethod
    def cells(self, floor: Floor, dimension: int) -> tuple[Cell, ...]:
        """See :meth:`Floor.cells`."""

    def validate(self, floor: Floor, dimension: int) -> None:
        """Refuse a floor that no speed satisfies."""
        if not any(cell.offset <= 1.0 for cell in self.cells(floor, dimension)):
            raise BadInput('floor.fraction', floor.fraction, 'a floor that full speed satisfies')

    def clearance(self, floor: Floor, dimension: int) -> float:
        """See :meth:`Floor.clearance`."""
        return max(0.0, min(cell.offset for cell in self.cells(floor, dimension)))

    def radius(self, floor: Floor) -> float:
        """See :attr:`Floor.radius`."""
        return 0.0

    def margin(self, floor: Floor, axes: Array) -> Array:
        """See :meth:`Floor.margin`."""
        cells = self.cells(floor, axes.shape[1])
        outward = np.array([cell.normal for cell in cells])
        return (axes @ outward.T - [cell.offset for cell in cells]).max(axis=1)

    def least(self, floor: Floor, axes: Array) -> Array:
        """See :meth:`Floor.least`; full speed where no speed is allowed."""
        cells = self.cells(floor, axes.shape[-1])
        slopes = axes @ np.array([cell.normal for cell in cells]).T
        offsets = np.array([cell.offset for cell in cells])
        least = np.where(slopes > 0.0, offsets / np.where(slopes > 0.0, slopes, 1.0), np.inf)
        least = least.min(axis=-1)
        return np.where(np.isfinite(least), least, 1.0)[()]

    def circling(self, floor: Floor, dimension: int) -> float:
        """See :meth:`Floor.circling`."""
        return 1.0

    def lines(self, floor: Floor, dimension: int) -> Lines:
        """See :meth:`Floor.outline`."""
        cells = self.cells(floor, dimension)
        outward = np.array([cell.normal for cell in cells])
        return edges(outward, np.array([cell.offset for cell in cells]))

    def described(self, floor: Floor) -> str:
        """Return the floor in words."""
        return floor.shape


class Free(Shape):
    """No floor: any speed, standing still included."""

    parameters = ()

    def cells(self, floor: Floor, dimension: int) -> tuple[Cell, ...]:
        """Return none."""
        return ()

    def validate(self, floor: Floor, dimension: int) -> None:
        """Refuse nothing."""

    def clearance(self, floor: Floor, dimension: int) -> float:
        """Return zero."""
        return 0.0

    def margin(self, floor: Floor, axes: Array) -> Array:
        """Return infinities."""
        return np.full(len(axes), np.inf)

    def least(self, floor: Floor, axes: Array) -> Array:
        """Return zeros."""
        return np.zeros(axes.shape[:-1])[()]

    def lines(self, floor: Floor, dimension: int) -> Lines:
        """Return none."""
        return ()


class Polygon(Shape):
    """The paper's floor: v beyond one of the faces of a regular polygon or solid."""

    parameters = ('faces', 'fraction')

    def validate(self, floor: Floor, dimension: int) -> None:
        """Refuse solids that do not exist, and faces that leave gaps."""
        if dimension == 3 and floor.faces not in SOLID_FACES:
            raise BadInput('floor.faces', floor.faces, '6, 12 or 20 when dimension is 3')
        limit = largest_fraction(dimension, floor.faces)
        if floor.fraction > limit:
            allowed = f'at most {limit:.6g} with floor.faces {floor.faces}'
            raise BadInput('floor.fraction', floor.fraction, allowed)

    def cells(self, floor: Floor, dimension: int) -> tuple[Cell, ...]:
        """Return a half-space per face."""
        return tuple(Cell(normal, floor.fraction) for normal in normals(dimension, floor.faces))

    def margin(self, floor: Floor, axes: Array) -> Array:
        """Return how far axes are beyond the face that they are farthest beyond."""
        return (axes @ normals(axes.shape[1], floor.faces).T).max(axis=1) - floor.fraction

    def least(self, floor: Floor, axes: Array) -> Array:
        """Return where rays meet the polygon."""
        return floor.fraction / (axes @ normals(axes.shape[-1], floor.faces).T).max(axis=-1)

    def circling(self, floor: Floor, dimension: int) -> float:
        """Return the distance of the corners, half-way between two faces: fraction / cos(pi/m)."""
        return min(1.0, floor.fraction / largest_fraction(dimension, floor.faces))

    def described(self, floor: Floor) -> str:
        """Return shape and faces."""
        return f'polygon of {floor.faces} faces'


class Circle(Shape):
    """The true floor: |v| >= fraction."""

    def radius(self, floor: Floor) -> float:
        """Return the fraction."""
        return floor.fraction

    def clearance(self, floor: Floor, dimension: int) -> float:
        """Return the fraction."""
        return floor.fraction

    def cells(self, floor: Floor, dimension: int) -> tuple[Cell, ...]:
        """Return none: it is round."""
        return ()

    def validate(self, floor: Floor, dimension: int) -> None:
        """Refuse nothing: full speed satisfies it."""

    def margin(self, floor: Floor, axes: Array) -> Array:
        """Return |v| - fraction."""
        return np.linalg.norm(axes, axis=1) - floor.fraction

    def least(self, floor: Floor, axes: Array) -> Array:
        """Return the fraction."""
        return np.full(axes.shape[:-1], floor.fraction)[()]

    def circling(self, floor: Floor, dimension: int) -> float:
        """Return the fraction."""
        return floor.fraction

    def lines(self, floor: Floor, dimension: int) -> Lines:
        """Return a circle, or three around a ball."""
        return sphere(dimension, floor.fraction)


SHAPES: dict[str, Shape] = {'none': Free(), 'polygon': Polygon(), 'circle': Circle()}


@lru_cache(maxsize=64)
def _outline(floor: Floor, dimension: int) -> Lines:
    return SHAPES[floor.shape].lines(floor, dimension)


def largest_fraction(dimension: int, faces: int) -> float:
    """Return the largest fraction whose polygon or solid still lies inside the unit ball.

    The ratio of inscribed to circumscribed sphere: cos(pi/m) for a polygon of m faces. Above it
    the faces leave gaps and the union of half-spaces no longer surrounds the forbidden region.
    """
    if dimension == 2:
        return math.cos(math.pi / faces)
    return 1.0 / math.sqrt(3.0) if faces == 6 else math.sqrt((5.0 + 2.0 * math.sqrt(5.0)) / 15.0)
