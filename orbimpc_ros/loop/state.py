# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Measurements of the vehicle, and the states of the planning problem that they mean.

Mathematics: docs/mathematics.md, 7.1.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array, ByContent, sealed
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Problem, State

SOURCES = ('ground', 'air')  # of a measured velocity
NOISE = 0.05  # of full speed: by so much a speed may be out of range unsaid


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
            sealed(array)


def along_the_air(odometry: Odometry) -> Odometry:
    """Return the measurement of a wing with its axis along its velocity through the air.

    A gust from the side turns the nose of a wing into it, and leaves its way over ground nearly as
    it is: what goes on is the velocity, and the nose is turned back to it.
    """
    ahead, aside = odometry.body_velocity.tolist()
    slip = np.array([math.atan2(aside, ahead)])
    velocity = np.array([math.hypot(ahead, aside), 0.0])
    return replace(odometry, attitude=odometry.attitude @ exp(slip), body_velocity=velocity)


def airspeed(odometry: Odometry, wind: Array | None, velocity_source: str = 'ground') -> float:
    """Return the speed through the air along the thrust axis [m/s]; across it only wind moves."""
    speed = float(odometry.body_velocity[0])
    if wind is None or velocity_source == 'air':
        return speed
    return speed - float(wind @ odometry.attitude[:, 0])


def state_of(
    problem: Problem,
    odometry: Odometry,
    applied: float | None,
    disturbance: Array | None = None,
    velocity_source: str = 'ground',
    reached: float | None = None,
    wanted: Array | None = None,
) -> State:
    """Return the state that a plan starts from: R_0 = sigma_0 Q_0, always in conv SO(n).

    At translation order 1 sigma_0 is the measured share of full speed, but for one case: where
    ``max_rate`` limits changes of speed, from what was commanded. A vehicle in a dead band, in a
    drift or uphill would never be told more than a step from the speed that it has.

    Args:
        problem: gives the orders, the step and the full speed.
        odometry: the measurement.
        applied: the share of thrust or speed that is commanded now, in [0, 1]; None before the
            first command.
        disturbance: a wind or an acceleration, shape (n,); None for none.
        velocity_source: what odometry measures: velocity over ``ground`` or through the ``air``.
        reached: the share of full speed that changes of speed count from, where they are limited;
            None before the first command: from the measured one.
        wanted: the rotation wanted at the end, shape (n, n); None for any.
    """
    if problem.inertial:
        fraction = applied or 0.0
        velocity = odometry.attitude @ odometry.body_velocity
    else:
        speed = airspeed(odometry, disturbance, velocity_source)
        fraction = min(1.0, max(0.0, speed / problem.forward))
        velocity = None
        if applied is not None and problem.max_rate and not problem.turns_are_angles:
            fraction = applied
    coasted = None
    if problem.rotation_order == 2:
        coasted = odometry.attitude @ exp(problem.step * odometry.body_rate)
    return State.at(
        position=odometry.position,
        rotation=fraction * odometry.attitude,
        velocity=velocity,
        attitude=odometry.attitude,
        coasted=coasted,
        disturbance=disturbance,
        commanded=reached,
        wanted=wanted,
    )


def odd_speed(
    problem: Problem,
    odometry: Odometry,
    disturbance: Array | None = None,
    velocity_source: str = 'ground',
) -> str:
    """Return that the measured speed is not one that the model knows, in words; else empty.

    Such a speed counts as the nearest that it does: none, or full speed.
    """
    speed, full = airspeed(odometry, disturbance, velocity_source), problem.forward
    if problem.inertial or -NOISE * full <= speed <= (1.0 + NOISE) * full:
        return ''
    taken = full if speed > 0.0 else 0.0
    return f'measured a forward speed of {speed:.3g} m/s, taken as {taken:g} m/s'


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
