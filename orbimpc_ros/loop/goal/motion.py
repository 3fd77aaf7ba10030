# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Motion of a goal, past and future: at stamped points, or along a path without times.

A path is followed as fast as the airspeed allows in the wind: the goal moves along it from the
point nearest to the vehicle. In the path's direction t, an airspeed V in a wind w gives

.. math::
    \dot s = t \cdot w + \sqrt{V^2 - |w - (t \cdot w) t|^2}

over ground. If that is not positive, or not real, the path cannot be followed: the goal stays,
and a vehicle near it heads into the wind.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np

from orbimpc_ros.mpc.arrays import Array, Sealed, sealed
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.plan import interpolated

FINE = 0.25  # [s] of flight between samples of the direction of the path
SHARP = 1.2  # ratio of the mean turn rate over a step to its limit, above which it is reported


@dataclass(frozen=True, eq=False)
class GoalObservation(Sealed):
    """An observed position of the goal."""

    time: float  # stamp [s]
    position: Array  # in the world frame, shape (n,) [m]
    attitude: Array | None = None  # shape (n, n); None if undefined in the plane


def slope(times: Array, places: Array) -> Array:
    """Return the velocity of the line fitted to places, shape (M, n) [m]; 0 at one time only."""
    past = times - times.mean()
    return np.asarray(past @ places / ((past @ past) or 1.0))


class GoalMotion(Protocol):
    """Future motion of a goal: a forecast, or a trajectory published by another node."""

    def at(self, times: Array) -> Array:
        """Return the positions at ``times``, shape (N,) [s], as shape (N, n) [m]."""


@dataclass(frozen=True, eq=False)
class GoalTrajectory(Sealed):
    """An external forecast: stamped future positions, interpolated in between."""

    times: Array  # increasing stamps, shape (M,) [s]
    positions: Array  # shape (M, n) [m]
    attitude: Array | None = None  # at the last of them, shape (n, n); None if undefined

    def __post_init__(self) -> None:
        if len(self.times) == 0 or np.any(np.diff(self.times) <= 0.0):
            raise BadInput('goal_path stamps', self.times.tolist(), 'one or more, increasing')
        super().__post_init__()

    def at(self, times: Array) -> Array:
        """Return the positions at ``times``, shape (N, n); both end points are held."""
        return interpolated(times, self.times, self.positions)


@dataclass(frozen=True)
class Route:
    """A path of straight lines between points, closed if the last point is the first.

    Attributes:
        positions: at least two, consecutive ones distinct, shape (M, n) [m].
    """

    positions: Array
    attitude: None = None  # as in other goals

    def __post_init__(self) -> None:
        if len(self.positions) < 2 or not np.diff(self.positions, axis=0).any(axis=1).all():
            raise BadInput('goal_path', self.positions.tolist(), '2 or more, none a repetition')
        sealed(self.positions)

    @cached_property
    def _lines(self) -> Array:
        return np.asarray(np.diff(self.positions, axis=0))

    @cached_property
    def _ends(self) -> Array:
        """Return the distance of each point along the path, shape (M,) [m]."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(self._lines, axis=1))])

    @property
    def length(self) -> float:
        """Return the length of the path [m]."""
        return float(self._ends[-1])

    @cached_property
    def closed(self) -> bool:
        """Return True if the path ends at its first point."""
        return bool(np.allclose(self.positions[0], self.positions[-1]))

    def place(self, along: Array) -> Array:
        """Return the points at distances along the path, shape (K,) [m], as shape (K, n) [m]."""
        along = along % self.length if self.closed else np.clip(along, 0.0, self.length)
        return interpolated(along, self._ends, self.positions)

    def direction(self, along: float) -> Array:
        """Return the path's direction at a distance along it [m], a unit vector, shape (n,)."""
        along = along % self.length if self.closed else along
        line = int(np.searchsorted(self._ends[1:-1], along, 'right'))
        return np.asarray(self._lines[line] / (self._ends[line + 1] - self._ends[line]))

    def nearest(self, position: Array, near: float | None = None, within: float = 0.0) -> float:
        """Return the distance along the path of its point nearest to a position [m].

        If there are points ``within`` a distance of ``near`` along the path, only those count [m].
        """
        away = position - self.positions[:-1]
        lengths = np.diff(self._ends)
        share = np.clip(np.sum(away * self._lines, axis=1) / lengths**2, 0.0, 1.0)
        along = self._ends[:-1] + share * lengths
        squared = np.sum((away - share[:, None] * self._lines) ** 2, axis=1)
        if near is not None:
            apart = np.abs(along - near)
            if self.closed:
                apart = np.minimum(apart % self.length, -apart % self.length)
            if (apart <= within).any():
                squared = np.where(apart <= within, squared, np.inf)
        return float(along[np.argmin(squared)])

    def at(self, times: Array) -> Array:
        """Return the end of the path for all times, shape (N, n) [m], as the final goal."""
        return np.repeat(self.positions[-1:], len(times), axis=0)

    def paced(self, begin: float, times: Array, airspeed: float, wind: Array) -> Array:
        """Return the distances [m] along the path of the goal at increasing times, shape (K,) [s].

        It is at ``begin`` at the first of them. The wind has shape (n,) [m/s].
        """
        distances = [begin]
        for now, end in pairwise(times.tolist()):
            along, count = distances[-1], max(1, math.ceil((end - now) / FINE))
            part = (end - now) / count
            for _ in range(count):
                middle = along + 0.5 * part * self._speed(along, airspeed, wind)
                along += part * self._speed(middle, airspeed, wind)
            distances.append(along)
        return np.array(distances)

    def _speed(self, along: float, airspeed: float, wind: Array) -> float:
        """Return the speed over ground [m/s]; 0 if progress along the path is impossible."""
        ahead = float(self.direction(along) @ wind)
        left = airspeed**2 - float(wind @ wind) + ahead**2
        return max(0.0, ahead + math.sqrt(left)) if left > 0.0 else 0.0

    def trouble(
        self, along: Array, times: Array, airspeed: float, wind: Array, max_rate: float
    ) -> str:
        """Return why the path cannot be followed as paced; otherwise an empty string.

        ``max_rate`` is the limit of the turn rate [rad/s]; 0 for no limit.
        """
        speeds = [self._speed(each, airspeed, wind) for each in along]
        if not all(speeds):
            where, strong = along[speeds.index(0.0)] - along[0], np.linalg.norm(wind)
            conditions = f'in a wind of {strong:.3g} m/s at {airspeed:.3g} m/s of airspeed'
            return f'the path cannot be followed {conditions}, from {where:.3g} m ahead on'
        if not max_rate or len(wind) != 2:
            return ''
        directions = np.array([self.direction(each) for each in along])
        through = np.array(speeds)[:, None] * directions - wind
        turns = np.abs(np.diff(np.unwrap(np.arctan2(*through.T[::-1])))) / np.diff(times)
        if turns.max() <= SHARP * max_rate:
            return ''
        where = along[int(np.argmax(turns))] - along[0]
        return f'the path turns by {turns.max():.3g} rad/s, {where:.3g} m ahead: rounded off'
