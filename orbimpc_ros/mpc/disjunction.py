"""Choices that make a problem mixed-integer: at least one half-space of a list must hold.

The paper writes them with binaries and a big M; here they are kept as what they are, so there is
no M to leak. A floor is one choice of face per step, an obstacle one choice of side per step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.floors.faces import normals
from orbimpc_ros.mpc.problem import Box, Problem


@dataclass(frozen=True)
class Disjunction:
    """For one alternative i, normals[i] . v_k >= offsets[i] at every k of ``steps``.

    Attributes:
        on: what v_k is: ``heading``, R_k e1, or ``position``, s_k.
        steps: the k (1..N) that must agree on the alternative.
        normals: shape (m, n).
        offsets: shape (m,).
    """

    on: Literal['heading', 'position']
    steps: tuple[int, ...]
    normals: Array
    offsets: Array

    def __post_init__(self) -> None:
        sealed(self.normals)
        sealed(self.offsets)

    def shortfall(self, headings: Array, positions: Array) -> Array:
        """Return by how much each alternative is missed, shape (m, len(steps)); <= 0 if it holds.

        Args:
            headings: R_0 e1..R_N e1, shape (N + 1, n).
            positions: s_0..s_N, shape (N + 1, n).
        """
        values = (headings if self.on == 'heading' else positions)[list(self.steps)]
        return self.offsets[:, None] - self.normals @ values.T


def disjunctions_of(problem: Problem) -> tuple[Disjunction, ...]:
    """Return every choice of a problem: its polygonal floor's and its obstacles'."""
    return (*_floor(problem), *_obstacles(problem))


def _floor(problem: Problem) -> list[Disjunction]:
    if problem.floor.shape != 'polygon':
        return []
    faces = normals(problem.dimension, problem.floor.faces)
    offsets = np.full(len(faces), problem.floor.fraction)
    return [Disjunction('heading', (k,), faces, offsets) for k in range(1, problem.horizon + 1)]


def _obstacles(problem: Problem) -> list[Disjunction]:
    last = problem.horizon
    if problem.no_corner_cutting and last > 1:
        # A segment whose ends share a free face cannot cut through the box.
        groups: list[tuple[int, ...]] = [(k, k + 1) for k in range(1, last)]
    else:
        groups = [(k,) for k in range(1, last + 1)]
    return [_sides(box, steps) for box in problem.obstacles for steps in groups]


def _sides(box: Box, steps: tuple[int, ...]) -> Disjunction:
    n = len(box.minimum)
    return Disjunction(
        'position',
        steps,
        np.concatenate([-np.eye(n), np.eye(n)]),
        np.concatenate([-box.minimum, box.maximum]),
    )
