# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Delay compensation: the motion of a vehicle from its measurement to its next command.

Mathematics: docs/mathematics.md, 7.3.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from orbimpc_ros.loop.odometry import Odometry
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.command import Command
from orbimpc_ros.mpc.geometry.rotations import exp, skew
from orbimpc_ros.mpc.problem import Problem

MEMORY = 32  # commands; whatever was sent before them is taken as measured
SMALL = 1e-2  # [rad] below it series are more exact than the closed forms


class Interval(NamedTuple):
    """An interval of time with one command in force.

    Attributes:
        duration: [s].
        command: in force all the while; None if none is known.
        before: the command before it, whose speed or thrust was taken over when it ended.
    """

    duration: float
    command: Command | None
    before: Command | None


class CommandHistory:
    """The commands of late, and since when each is in force.

    Attributes:
        last: the last command, sent or about to be; None before the first.
    """

    def __init__(self) -> None:
        self.last: Command | None = None
        self._sent: deque[tuple[float, Command]] = deque(maxlen=MEMORY)

    @property
    def fraction(self) -> float:
        """Return the share of full speed or thrust commanded last; 0 before the first command."""
        return 0.0 if self.last is None else self.last.speed_fraction

    @property
    def is_empty(self) -> bool:
        """Return whether it is unknown of every command when it was sent."""
        return not self._sent

    def applied(self, time: float, lag: float, begun: float = 0.0) -> float:
        """Return the share of speed or thrust at a time [s], behind commands by a lag [s].

        Where nobody said when commands were sent, the last one counts as reached. ``begun`` is the
        share before the first of them.
        """
        if not self._sent or lag == 0.0:
            return self.fraction
        since, first = self._sent[0]
        reached = begun if len(self._sent) < MEMORY else first.speed_fraction
        for interval in self.intervals(since, time):
            assert interval.command is not None
            reached, _ = _followed(reached, interval.command, interval.duration, lag)
        return reached

    def mean(self, begin: float, end: float, lag: float, begun: float = 0.0) -> float | None:
        """Return the mean share of speed or thrust from ``begin`` to ``end`` [s]; None if unknown.

        Without a lag a command's speed or thrust is taken over when the next command comes.
        ``begun`` is the share before the first command.
        """
        flown, reached = 0.0, self.applied(begin, lag, begun)
        for interval in self.intervals(begin, end):
            given = interval.before if lag == 0.0 else interval.command
            if given is None:
                return None
            reached, covered = _followed(reached, given, interval.duration, lag)
            flown += covered
        return flown / (end - begin)

    def add(self, command: Command, at: float) -> None:
        """Note a command sent at a time [s]; times do not decrease."""
        self.last = command
        self._sent.append((at, command))

    def forget(self) -> None:
        """Forget since when commands are in force, for instance because the clock jumped."""
        self._sent.clear()

    def intervals(self, begin: float, end: float) -> list[Interval]:
        """Return what was in force from ``begin`` to ``end`` [s]; nothing if that is no time."""
        found, before, command, since = [], None, None, begin
        for at, following in self._sent:
            if since < at < end:
                found.append(Interval(at - since, command, before))
                since = at
            if at < end:
                before, command = command, following
        if end > since:
            found.append(Interval(end - since, command, before))
        return found


def _followed(reached: float, command: Command, duration: float, lag: float) -> tuple[float, float]:
    """Return the share reached after a command was in force for a time [s], and its integral."""
    wanted = command.speed_fraction
    if lag == 0.0:
        return wanted, wanted * duration
    left = (reached - wanted) * math.exp(-duration / lag)
    return wanted + left, wanted * duration + lag * (reached - wanted - left)


def advanced(
    problem: Problem,
    odometry: Odometry,
    intervals: Sequence[Interval],
    disturbance: Array | None = None,
    velocity_source: str = 'ground',
) -> Odometry:
    """Return the measurement as it would be after the intervals; the same one without any.

    Within an interval body rate and forward speed (or thrust) are constant, so that the vehicle
    flies an arc, integrated exactly. As in the discrete model, a commanded rate applies at once at
    rotation order 1; everything else that a command says is taken over when the next command comes.
    Until then the vehicle goes on as it was measured. Meanwhile the disturbance acts on it: speeds
    through the air turn with the body, the wind does not.

    Args:
        problem: gives the orders and the full speed or thrust.
        odometry: the measurement.
        intervals: in order of time, since the measurement.
        disturbance: a wind or an acceleration, shape (n,); None for none.
        velocity_source: what odometry measures: velocity over ``ground`` or through the ``air``.
    """
    if not intervals:
        return odometry
    attitude, body_velocity = odometry.attitude, odometry.body_velocity
    blown = np.zeros(problem.dimension) if disturbance is None else disturbance
    # Of a vehicle without inertia, what turns with the body is its velocity through the air.
    still = velocity_source == 'air' or problem.inertial
    carrying = np.zeros(problem.dimension) if still else blown
    through_air, velocity = body_velocity - attitude.T @ carrying, attitude @ body_velocity
    motion = _Motion(odometry.position, attitude, velocity, through_air, odometry.body_rate)
    for k, interval in enumerate(intervals):
        if k and interval.before is not None:
            taken_over = _forward(problem, interval.before.speed_fraction)
            motion = motion._replace(through_air=taken_over, rate=interval.before.body_rate)
        motion = _flown(problem, motion, interval, blown)
    body_velocity = motion.through_air + motion.attitude.T @ carrying
    if problem.inertial:
        body_velocity = motion.attitude.T @ motion.velocity
    later = odometry.time + sum(interval.duration for interval in intervals)
    place = motion.position, motion.attitude
    return Odometry(later, *place, np.array(body_velocity), np.array(motion.rate))


class _Motion(NamedTuple):
    """A vehicle's motion: over ground, but for its velocity through the air in the body frame."""

    position: Array
    attitude: Array
    velocity: Array
    through_air: Array
    rate: Array


def _flown(problem: Problem, motion: _Motion, interval: Interval, blown: Array) -> _Motion:
    """Return the motion after an interval, flown along an arc."""
    time, command, before = interval
    turning = motion.rate
    if command is not None and problem.rotation_order == 1:
        turning = command.body_rate
    angle = time * turning
    attitude, position, velocity = motion.attitude, motion.position, motion.velocity
    if problem.inertial:
        push = _forward(problem, 0.0 if before is None else before.speed_fraction)
        once, twice = turned(angle, push)
        position = position + time * velocity + time * time * (attitude @ twice + 0.5 * blown)
        velocity = velocity + time * (attitude @ once + blown)
    else:
        flown, _ = turned(angle, motion.through_air)
        position = position + time * (attitude @ flown + blown)
    return _Motion(position, attitude @ exp(angle), velocity, motion.through_air, motion.rate)


def _forward(problem: Problem, fraction: float) -> Array:
    """Return a share of full speed or thrust along the body's x axis, shape (n,)."""
    vector = np.zeros(problem.dimension)
    vector[0] = problem.forward * fraction
    return vector


def turned(phi: Array, vector: Array) -> tuple[Array, Array]:
    r"""Return a vector that turns with the body, averaged over an interval, and averaged twice.

    :math:`\int_0^1 e^{s\hat\phi} v\, ds` and :math:`\int_0^1 (1-s) e^{s\hat\phi} v\, ds`.

    Args:
        phi: tangent vector, shape (1,) or (3,) [rad].
        vector: v, shape (n,).
    """
    hat = skew(phi)
    across = hat @ vector
    back = hat @ across
    angle = math.sqrt(phi @ phi)
    if angle < SMALL:
        a = angle * angle
        first, second, third = 0.5 - a / 24.0, 1.0 / 6.0 - a / 120.0, 1.0 / 24.0 - a / 720.0
    else:
        first = (1.0 - math.cos(angle)) / angle**2
        second = (angle - math.sin(angle)) / angle**3
        third = (0.5 - first) / angle**2
    return vector + first * across + second * back, 0.5 * vector + second * across + third * back
