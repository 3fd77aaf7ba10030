# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Events inferred from odometry: capture of a goal, and velocities in another frame than stated."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Approach

TINY = 1e-300  # [m^2] lower bound of a squared drift, against division by zero
STAY = 1.0  # [s] within the radius, after which the vehicle has arrived
WINDOW = 20  # measurements
SHORTEST = 0.005  # [s] between measurements compared: within less, noise outweighs motion
FITS_BETTER = 0.3  # ratio of errors, other frame to stated one, below which the other is assumed
TELLING = 0.3  # of the speed: larger errors of the stated frame are not noise


def closest_approach(flown: tuple[Array, Array], swung: tuple[Array, Array]) -> tuple[Any, Any]:
    """Return the least distance [m] during a step and its time, as a share of the step in [0, 1].

    Args:
        flown: positions of the vehicle at both ends of the step, or of K steps, (n,) or (K, n) [m].
        swung: positions of the goal.
    """
    apart = flown[0] - swung[0]
    drift = (flown[1] - swung[1]) - apart
    speed = np.maximum((drift * drift).sum(axis=-1), TINY)
    share = np.clip(-(apart * drift).sum(axis=-1) / speed, 0.0, 1.0)
    return np.linalg.norm(apart + share[..., None] * drift, axis=-1), share


def is_headed(approach: Approach, headings: tuple[Array, Array], share: float) -> bool:
    """Return True if a vehicle is inside the approach cone at a moment of a step.

    Args:
        approach: the cone, with its direction.
        headings: thrust axis at both ends of the step, each of shape (n,).
        share: the moment, as a share of the step; headings turn evenly by less than half a turn.
    """
    if not approach.exists or not approach.direction:
        return not approach.exists  # False for the goal's axis, while that is unknown
    heading = (1.0 - share) * headings[0] + share * headings[1]
    axis = np.array(approach.direction)
    along = float(heading @ axis) / math.hypot(*approach.direction)
    return along >= math.cos(approach.cone) * math.sqrt(heading @ heading)


class Events:
    """Whether a goal has been caught or reached.

    Attributes:
        caught: whether the vehicle has come within the radius of the present goal, including
            between two measurements.
        arrived: whether it has stayed within the radius for a while, up to now.
    """

    def __init__(self) -> None:
        self._goal: Array | None = None  # last goal sent
        self._moves = False  # whether it differed from the one before
        self.begin()

    def begin(self) -> None:
        """Start anew, with nothing caught or reached."""
        self.caught = self.arrived = False
        self._last: tuple[Odometry, Array] | None = None
        self._entered: float | None = None  # time of entry into the radius [s]

    def send(self, goal: Array, *, streams: bool) -> None:
        """Take in a goal, shape (n,) [m]; one that keeps moving in a stream is not a new one."""
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
            odometry: measured motion of the vehicle.
            goal: its position at that time, shape (n,) [m].
            radius: distance that counts as a catch or an arrival [m].
            patience: longest interval between measurements that is interpolated [s].
            approach: the cone, with its direction, in which a catch counts; by default no cone.
        """
        before, then = self._last or (odometry, goal)
        if not 0.0 <= odometry.time - before.time <= patience:
            before, then, self._entered = odometry, goal, None
        self._last = odometry, goal
        paths = (before.position, odometry.position), (then, goal)
        nearest, share = map(float, closest_approach(*paths))
        headings = before.attitude[:, 0], odometry.attitude[:, 0]
        headed = approach is None or is_headed(approach, headings, share)
        self.caught = self.caught or (nearest <= radius and headed)
        if np.linalg.norm(odometry.position - goal) > radius:
            self._entered = None
        elif self._entered is None:
            self._entered = odometry.time
        self.arrived = self._entered is not None and odometry.time - self._entered >= STAY


class VelocityFrameCheck:
    """Compares velocities, given in the ``body`` or ``world`` frame, with changes of position."""

    def __init__(self, frame: str) -> None:
        self._frame = frame
        self._last: Odometry | None = None
        self._errors: deque[Array] = deque(maxlen=WINDOW)  # errors by frame; the speed

    def note(self, odometry: Odometry) -> None:
        """Take in a measurement; one that is not newer than the last restarts the comparison."""
        last = self._last
        if last is not None and 0.0 < odometry.time - last.time < SHORTEST:
            return
        self._last = odometry
        if last is None or odometry.time <= last.time:
            self._errors.clear()
            return
        moved = (odometry.position - last.position) / (odometry.time - last.time)
        turned, velocity = odometry.attitude, odometry.body_velocity
        as_stated = turned @ velocity
        # If wrong, body velocities are world ones already, and world ones still to be rotated.
        otherwise = velocity if self._frame == 'body' else turned @ as_stated
        compared = np.array([moved - as_stated, moved - otherwise, velocity])
        self._errors.append(np.linalg.norm(compared, axis=1))

    @property
    def doubt(self) -> str:
        """Return a message if velocities fit the other frame better; otherwise an empty string."""
        if len(self._errors) < WINDOW:
            return ''
        stated, other, speed = np.sum(self._errors, axis=0)
        if other > FITS_BETTER * stated or stated <= TELLING * speed:  # equal: all are 0 at rest
            return ''
        better = 'world' if self._frame == 'body' else 'body'
        return f'velocities fit the flown path better in the {better} frame: see velocity_frame'
