# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Obstacles: boxes, balls and moving bodies that positions stay outside of.

Mathematics: docs/mathematics.md, 3.7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array, ByContent, frozen, number
from orbimpc_ros.mpc.errors import BadInput

MAX_HAZARDS = 64
SOON = 1e-6  # [s] points of a track that are due sooner are skipped
RESERVE_STEPS = 4  # until a reserve applies in full and an obstacle seen only once is seen again


@dataclass(frozen=True, eq=False)
class Box(ByContent):
    """An axis-aligned obstacle that every s_k, k = 1..N, stays outside of.

    Attributes:
        minimum: lower corner, shape (n,) [m].
        maximum: upper corner, shape (n,) [m], above ``minimum`` in every axis.
    """

    minimum: Array
    maximum: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, 'minimum', frozen(self.minimum, (-1,), 'obstacles.min'))
        shape = self.minimum.shape
        object.__setattr__(self, 'maximum', frozen(self.maximum, shape, 'obstacles.max'))
        if not np.all(self.minimum < self.maximum):
            raise BadInput('obstacles.max', self.maximum.tolist(), f'above {self.minimum.tolist()}')

    @property
    def dimension(self) -> int:
        """Return n."""
        return len(self.minimum)

    @property
    def centre(self) -> Array:
        """Return the centre, shape (n,) [m]."""
        return np.asarray(0.5 * (self.minimum + self.maximum))

    def shifted(self, way: Array) -> Box:
        """Return the box moved by a way, shape (n,) [m]."""
        return Box(self.minimum + way, self.maximum + way)

    def scaled(self, factor: float) -> Box:
        """Return the box in units in which lengths are ``factor`` times as large."""
        return Box(self.minimum * factor, self.maximum * factor)

    def clearances(self, points: Array) -> Array:
        """Return how far points, shape (K, n), are beyond each face, shape (K, 2 n) [m]."""
        return np.concatenate([self.minimum - points, points - self.maximum], axis=1)

    def depth(self, points: Array) -> Array:
        """Return how deep points, shape (K, n), are inside [m]; <= 0 outside."""
        return -self.clearances(points).max(axis=1)


@dataclass(frozen=True, eq=False)
class Ball(ByContent):
    """A disc (n = 2) or a sphere (n = 3) that every s_k, k = 1..N, stays outside of.

    Attributes:
        centre: shape (n,) [m].
        radius: above 0 [m].
    """

    centre: Array
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, 'centre', frozen(self.centre, (-1,), 'obstacles.centre'))
        number(self.radius, 'obstacles.radius', 0.0, above=True)

    @property
    def dimension(self) -> int:
        """Return n."""
        return len(self.centre)

    def shifted(self, way: Array) -> Ball:
        """Return the ball moved by a way, shape (n,) [m]."""
        return Ball(self.centre + way, self.radius)

    def scaled(self, factor: float) -> Ball:
        """Return the ball in units in which lengths are ``factor`` times as large."""
        return Ball(self.centre * factor, self.radius * factor)

    def depth(self, points: Array) -> Array:
        """Return how deep points, shape (K, n), are inside [m]; <= 0 outside."""
        return self.radius - np.linalg.norm(points - self.centre, axis=1)


@dataclass(frozen=True, eq=False)
class MovingObstacle(ByContent):
    """An obstacle that moves: other traffic, or another vehicle that flies its plan.

    Attributes:
        body: its shape and its place at the start of the plan.
        times: after the start of the plan, increasing from 0, shape (K,), K >= 2 [s].
        shifts: displacements at these times, shape (K, n), the first zero [m]; interpolated
            linearly, and extrapolated with the last velocity.
        reserve: margin around it [m], which grows linearly from zero in the first step of a plan to
            its full value after ``RESERVE_STEPS``.
        unsure: largest error of its velocity [m/s]: in the first ``RESERVE_STEPS`` its margin grows
            by this times the time since the start of the plan.
    """

    body: Box | Ball
    times: Array
    shifts: Array
    reserve: float = 0.0
    unsure: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, 'times', frozen(self.times, (-1,), 'obstacles.times'))
        count = len(self.times)
        shape = count, self.body.dimension
        object.__setattr__(self, 'shifts', frozen(self.shifts, shape, 'obstacles.shifts'))
        if count < 2 or self.times[0] != 0.0 or not (np.diff(self.times) > 0.0).all():
            allowed = 'two or more times that increase from 0'
            raise BadInput('obstacles.times', self.times.tolist(), allowed)
        if self.shifts[0].any():
            raise BadInput('obstacles.shifts', self.shifts[0].tolist(), 'zeros at the start')
        number(self.reserve, 'obstacles.reserve', 0.0)
        number(self.unsure, 'obstacles.unsure', 0.0)

    @classmethod
    def drifting(cls, body: Box | Ball, velocity: Array | None = None) -> MovingObstacle:
        """Return a body that moves at a constant velocity, shape (n,) [m/s]; None: at rest."""
        still = np.zeros(body.dimension)
        moved = still if velocity is None else velocity
        return cls(body, np.array([0.0, 1.0]), np.array([still, moved]))

    def scaled(self, length: float, time: float) -> MovingObstacle:
        """Return it in units in which lengths and times are larger by these factors."""
        return MovingObstacle(
            self.body.scaled(length),
            self.times * time,
            self.shifts * length,
            self.reserve * length,
            self.unsure * length / time,
        )

    def after(self, time: float) -> MovingObstacle:
        """Return it from a time [s] on, which may be before the start of the plan."""
        (start,) = self.moved(np.array([time]))
        ends = self.times[1:][self.times[1:] > time + SOON]
        ends = ends if len(ends) else np.array([time + 1.0])
        times, shifts = np.append(0.0, ends - time), self.moved(ends) - start
        shifts = np.concatenate([np.zeros((1, self.body.dimension)), shifts])
        return replace(self, body=self.body.shifted(start), times=times, shifts=shifts)

    def depth(self, points: Array, times: Array) -> Array:
        """Return how deep points, (M, n) or (1, n), are inside at times, (M,) [m]; <= 0 outside."""
        return self.body.depth(points - self.moved(times))

    def moved(self, times: Array) -> Array:
        """Return the displacements, shape (M, n) [m], at times, shape (M,) [s]."""
        at = np.searchsorted(self.turns, times, side='right')
        share = (times - self.times[at]) / (self.times[at + 1] - self.times[at])
        begin = self.shifts[at]
        return np.asarray(begin + share[:, None] * (self.shifts[at + 1] - begin))

    @property
    def turns(self) -> Array:
        """Return the times at which its velocity may change, shape (K - 2,) [s]."""
        return self.times[1:-1]


def reserves(hazards: Sequence[MovingObstacle], horizon: int, step: float) -> Array:
    """Return the margins around hazards in each step of length ``step`` [s], shape (J, N) [m]."""
    begun = np.arange(horizon)
    shares = np.minimum(begun / RESERVE_STEPS, 1.0)
    strayed = np.where(begun < RESERVE_STEPS, step * begun, 0.0)
    kept: Array = np.outer([each.reserve for each in hazards], shares)
    kept += np.outer([each.unsure for each in hazards], strayed)
    return kept
