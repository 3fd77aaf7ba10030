# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Measured velocities held against the way flown: are they in the frame that they should be?

A velocity in the body's frame that is taken for one in the world's, or the other way round, is
right while the vehicle looks along x, and the plan starts from ever wrong states as it turns.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from orbimpc_ros.loop.odometry import Odometry
from orbimpc_ros.mpc.arrays import Array

WINDOW = 20  # measurements
FITS_BETTER = 0.3  # times the error as given: that of the other frame, to be believed
TELLING = 0.3  # of the speed: an error as given that is no noise


class Witness:
    """Compares velocities with the change of positions, over the last measurements.

    Args:
        given: what velocities are said to be in, ``body`` or ``world``.
    """

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
