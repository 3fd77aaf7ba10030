# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Measurements of the vehicle and its wind."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array, ByContent, sealed

SOURCES = ('ground', 'air')  # of a measured velocity


@dataclass(frozen=True, eq=False)
class Odometry(ByContent):
    """A measurement of the vehicle's motion.

    Attributes:
        time: stamp [s].
        position: in the world frame, shape (n,) [m].
        attitude: body to world rotation, shape (n, n).
        body_velocity: in the body frame, over ground or through the air, shape (n,) [m/s].
        body_rate: in the body frame, shape (1,) or (3,) [rad/s].
    """

    time: float
    position: Array
    attitude: Array
    body_velocity: Array
    body_rate: Array

    def __post_init__(self) -> None:
        for array in (self.position, self.attitude, self.body_velocity, self.body_rate):
            array.setflags(write=False)


WINDOW = 20  # measurements
FITS_BETTER = 0.3  # times the error as given: that of the other frame, to be believed
TELLING = 0.3  # of the speed: an error as given that is no noise


@dataclass(frozen=True, eq=False)
class WindReport(ByContent):
    """A wind that somebody else has estimated."""

    time: float  # stamp [s]
    velocity: Array  # shape (n,) [m/s]
    variance: float = math.nan  # along each axis [m^2/s^2]; NaN where it is not known

    def __post_init__(self) -> None:
        sealed(self.velocity)


class VelocityFrameCheck:
    """Compares velocities, given in the ``body`` or ``world`` frame, with changes of position."""

    def __init__(self, given: str) -> None:
        self._given = given
        self._last: Odometry | None = None
        self._errors: deque[Array] = deque(maxlen=WINDOW)  # as given, otherwise, and the speed

    def note(self, odometry: Odometry) -> None:
        """Take in a measurement; one that is not newer starts afresh."""
        last, self._last = self._last, odometry
        if last is None or odometry.time <= last.time:
            self._errors.clear()
            return
        moved = (odometry.position - last.position) / (odometry.time - last.time)
        turned, velocity = odometry.attitude, odometry.body_velocity
        as_given = turned @ velocity
        # What was read as the body's had been the world's all along; or it was turned needlessly.
        otherwise = velocity if self._given == 'body' else turned @ as_given
        compared = np.array([moved - as_given, moved - otherwise, velocity])
        self._errors.append(np.linalg.norm(compared, axis=1))

    @property
    def doubt(self) -> str:
        """Return that velocities fit the other frame, in words; empty if they do not."""
        if len(self._errors) < WINDOW:
            return ''
        given, other, speed = np.sum(self._errors, axis=0)
        if other > FITS_BETTER * given or given <= TELLING * speed:  # equal: all are 0 at rest
            return ''
        frame = 'world' if self._given == 'body' else 'body'
        return f'velocities fit the way flown as those of the {frame} frame: see velocity_frame'
