# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The state that a plan starts from.

Mathematics: docs/mathematics.md, 1.5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from orbimpc_ros.mpc.arrays import Array, ByContent, frozen, number, sealed
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import MEMBERSHIP_TOLERANCE, margin, nearest
from orbimpc_ros.mpc.problem.obstacle import MovingObstacle, tracked

T = TypeVar('T')


@dataclass(frozen=True, eq=False)
class State(ByContent):
    """The vehicle's state at the start of a plan; :meth:`at` makes and validates it.

    Attributes:
        position: s_0, shape (n,) [m].
        rotation: R_0 in conv SO(n), shape (n, n): the attitude scaled by the speed fraction.
        velocity: p_0, shape (n,) [m/s]; zero unless translation is of order 2.
        rotation_rate: W_0, shape (n, n) [1/s]; zero unless rotation is of order 2.
        attitude: Q_0, shape (n, n), the rotation R_0 was scaled from; by default the nearest one.
        coasted: the rotation, shape (n, n), that the present body rate turns the attitude into
            during the first step (rotation order 2). With it R_1 = rho * coasted, the thrust
            fraction rho in [0, 1] free, instead of R_1 = R_0 + h W_0, which is off the manifold.
        disturbance: w, constant over the horizon, shape (n,); at translation order 1 a wind in the
            world frame [m/s], at order 2 an acceleration, gravity included [m/s^2].
        commanded: the share of full speed last commanded, in [0, 1], from which the first change of
            speed is limited; by default |R_0 e1|.
        hazards: moving obstacles to stay clear of, with times from the start of the plan.
        wanted: R_g, the desired final rotation, shape (n, n); None if it is unconstrained.
    """

    position: Array
    rotation: Array
    velocity: Array
    rotation_rate: Array
    attitude: Array
    coasted: Array | None
    disturbance: Array
    commanded: float | None = None
    hazards: tuple[MovingObstacle, ...] = ()
    wanted: Array | None = None

    @classmethod
    def at(
        cls,
        position: ArrayLike,
        rotation: ArrayLike,
        *,
        velocity: ArrayLike | None = None,
        rotation_rate: ArrayLike | None = None,
        attitude: ArrayLike | None = None,
        coasted: ArrayLike | None = None,
        disturbance: ArrayLike | None = None,
        commanded: float | None = None,
        hazards: tuple[MovingObstacle, ...] = (),
        wanted: ArrayLike | None = None,
    ) -> State:
        """Return the state at a position and rotation, at rest by default.

        Raises:
            BadInput: an array of the wrong shape, not finite, or outside its set; too many hazards,
                or one of another dimension.
        """
        n = np.size(position)
        if n not in (2, 3):
            raise BadInput('state.position', n, '2 or 3 numbers')
        line, square, still = (n,), (n, n), _zeros((n,))
        given: dict[str, tuple[Any, tuple[int, ...], Array | None]] = {
            'position': (position, line, None),
            'rotation': (rotation, square, None),
            'velocity': (velocity, line, still),
            'rotation_rate': (rotation_rate, square, _zeros(square)),
            'attitude': (attitude, square, None),
            'coasted': (coasted, square, None),
            'disturbance': (disturbance, line, still),
            'wanted': (wanted, square, None),
        }
        made: dict[str, Any] = {
            name: absent if value is None else frozen(value, shape, f'state.{name}')
            for name, (value, shape, absent) in given.items()
        }
        if attitude is None:
            made['attitude'] = sealed(nearest(made['rotation']))
        for name in ('attitude', 'coasted', 'wanted'):
            if made[name] is not None:
                _require_rotation(made[name], f'state.{name}')
        for name in ('rotation', 'rotation_rate'):
            _require_structure(made[name], f'state.{name}')
        if margin(made['rotation']) < -MEMBERSHIP_TOLERANCE:
            allowed = f'a matrix in conv SO({n})'
            raise BadInput('state.rotation', made['rotation'].tolist(), allowed)
        if commanded is not None:
            number(commanded, 'state.commanded', 0.0, 1.0)
        bodies = tracked(hazards, n) if hazards else ()
        return cls(commanded=commanded, hazards=bodies, **made)

    @property
    def dimension(self) -> int:
        """Return n."""
        return len(self.position)

    @cached_property
    def _known(self) -> list[tuple[Any, Any]]:
        return []

    def once(self, asked: Any, work_out: Callable[[], T]) -> T:
        """Return the value cached for this state under a key; compute it at the first call."""
        for known, found in self._known:
            if known == asked:
                return cast('T', found)
        found = work_out()
        self._known.append((asked, found))
        return found


@lru_cache(maxsize=8)
def _zeros(shape: tuple[int, ...]) -> Array:
    """Return zeros shared by all states, since creating and checking arrays costs microseconds."""
    return sealed(np.zeros(shape))


def _require_rotation(matrix: Array, culprit: str) -> None:
    n = len(matrix)
    if np.abs(matrix.T @ matrix - np.eye(n)).max() > 1e-9 or np.linalg.det(matrix) < 0.0:
        raise BadInput(culprit, matrix.tolist(), f'a rotation in SO({n})')


def _require_structure(matrix: Array, culprit: str) -> None:
    if len(matrix) == 2:
        (a, b), (c, d) = matrix.tolist()
        if abs(a - d) > 1e-6 or abs(b + c) > 1e-6:
            raise BadInput(culprit, matrix.tolist(), '[[a, -b], [b, a]]')
