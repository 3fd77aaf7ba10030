# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Capture of a goal: the closest approach within a step, and what odometry shows of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Approach

STAY = 1.0  # [s] within the radius, after which the vehicle has arrived


def closest_approach(flown: tuple[Array, Array], swung: tuple[Array, Array]) -> tuple[float, float]:
    """Return the least distance [m] during a step and when, as a share of the step in [0, 1].

    Args:
        flown: the vehicle's positions at the ends of the step, each of shape (n,) [m].
        swung: the goal's.
    """
    apart = flown[0] - swung[0]
    drift = (flown[1] - swung[1]) - apart
    speed = float(drift @ drift)
    share = float(np.clip(-(apart @ drift) / speed, 0.0, 1.0)) if speed > 0.0 else 0.0
    nearest = apart + share * drift
    return math.sqrt(nearest @ nearest), share


def is_headed(approach: Approach, headings: tuple[Array, Array], share: float) -> bool:
    """Return whether a vehicle is within the cone of approach at some moment of a step.

    Args:
        approach: the cone, with its direction.
        headings: where its pushing axis points at the ends of the step, each of shape (n,).
        share: the moment, as a share of the step; headings turn evenly, but for half a turn.
    """
    if not approach.exists:
        return True
    heading = (1.0 - share) * headings[0] + share * headings[1]
    axis = np.array(approach.direction)
    along = float(heading @ axis) / math.hypot(*approach.direction)
    return along >= math.cos(approach.cone) * math.sqrt(heading @ heading)


@dataclass
class Events:
    """Whether a goal has been caught or reached.

    Attributes:
        caught: whether the vehicle has come within the radius since there is this goal, in
            between two measurements too.
        arrived: whether it has stayed within the radius for a while, up to now.
    """

    caught: bool = False
    arrived: bool = False
    _goal: Array | None = field(default=None, init=False)  # as it was sent last
    _moves: bool = field(default=False, init=False)  # whether that was elsewhere than before
    _last: tuple[Odometry, Array] | None = field(default=None, init=False)
    _entered: float | None = field(default=None, init=False)  # the radius [s]

    def begin(self) -> None:
        """Begin anew: nothing is caught or reached."""
        self.caught = self.arrived = False
        self._last = self._entered = None

    def send(self, goal: Array, *, streams: bool) -> None:
        """Take in a goal, shape (n,) [m]; one that goes on moving in a stream is no new one."""
        moves = self._goal is None or not np.array_equal(goal, self._goal)
        if moves and not (streams and self._moves):
            self.begin()
        self._goal, self._moves = goal, moves

    def note(
        self,
        odometry: Odometry,
        goal: Array,
        radius: float,
        patience: float,
        approach: Approach | None = None,
    ) -> None:
        """Take in a measurement.

        Args:
            odometry: where the vehicle is.
            goal: at that time, shape (n,) [m].
            radius: within which it counts [m].
            patience: of measurements further apart nothing is known in between [s].
            approach: the cone, with its direction, within which a catch counts; any if left out.
        """
        before, then = self._last or (odometry, goal)
        if not 0.0 <= odometry.time - before.time <= patience:
            before, then, self._entered = odometry, goal, None
        self._last = odometry, goal
        ways = (before.position, odometry.position), (then, goal)
        nearest, share = closest_approach(*ways)
        headings = before.attitude[:, 0], odometry.attitude[:, 0]
        headed = approach is None or is_headed(approach, headings, share)
        self.caught = self.caught or (nearest <= radius and headed)
        if np.linalg.norm(odometry.position - goal) > radius:
            self._entered = None
        elif self._entered is None:
            self._entered = odometry.time
        self.arrived = self._entered is not None and odometry.time - self._entered >= STAY
