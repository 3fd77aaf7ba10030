# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""The estimated disturbance: what moves a vehicle besides its commands, by a Kalman filter.

The model of the loop with a constant disturbance w for a state, which makes the loop offset-free:

.. math::
    \dot s = v + w + \xi, \quad \dot w = \zeta \qquad\text{(order 1)}, \qquad
    \dot s = p, \quad \dot p = a + w + \xi, \quad \dot w = \zeta \qquad\text{(order 2)}

with v or a what was commanded, along the measured attitude. Measured is the position, and at order
2 the velocity. Every axis has the same covariance, so that one filter does for all of them.

At order 1 the speed follows its commands from an airspeed that nobody measures who measures the
velocity over ground: a wind along the axis looks like it. By how much it is off at the start is a
state, too, which fades with the lag of the speed.

Mathematics: docs/mathematics.md, 7.9.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.loop.delay import CommandHistory, turned
from orbimpc_ros.loop.odometry import Odometry, airspeed
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import log
from orbimpc_ros.mpc.problem import Problem

GIVEN, ESTIMATED = 'given', 'estimated'
DISTURBANCES = (GIVEN, ESTIMATED)
GATE = 5.0  # standard deviations: what is farther off is no measurement of the model
PATIENCE = 2  # measurements in a row that are refused, after which the position is believed
SHIFT = 3.0  # standard deviations: measurements that lean to one side by more show another wind
RECENT = 0.5  # [s] over which they are looked at
GAP = 2.0  # [s] without odometry, over which nothing is learnt
LARGEST = 0.8  # of full speed or thrust: what is left steers


@dataclass(frozen=True)
class Deviations:
    """Standard deviations of the model, as shares of full speed or thrust z.

    Attributes:
        position: of a measured position, of z s (order 1) or z s^2 (order 2).
        velocity: of a measured velocity (order 2), of z s.
        model: of what commands do, over a second: gusts, gains, discretisation; of z.
        drift: by how much the disturbance changes in a second, of z.
        prior: of the disturbance before anything is known, of z.
    """

    position: float = 0.01
    velocity: float = 0.01
    model: float = 0.05
    drift: float = 0.03
    prior: float = 0.3


MEASURED = Deviations(model=0.01)  # gusts are seen in the velocity, and commands have no part


class Estimator:
    """Learns a disturbance from odometry and the commands that were in force.

    Args:
        problem: gives the orders and the full speed or thrust.
        lag: of speed or thrust [s]; see :class:`orbimpc_ros.loop.response.Response`.
        velocity_source: what odometry measures: velocity over ``ground`` or through the ``air``.
        noise: of the model.
        measured: whether the measured speed is believed, through the air, not the commanded one.

    Attributes:
        innovation: how far the last measurement was from what was expected, in standard
            deviations; 0 before the second.
        refused: measurements in a row that were too far off to be believed.
    """

    def __init__(
        self,
        problem: Problem,
        lag: float = 0.0,
        velocity_source: str = 'ground',
        noise: Deviations | None = None,
        *,
        measured: bool = False,
    ) -> None:
        self._noise = noise or (MEASURED if measured else Deviations())
        self._problem, self._lag, self._as_measured = problem, lag, measured
        self._velocity_source = velocity_source
        self.reset()

    def reset(self) -> None:
        """Forget everything, the disturbance too."""
        self._estimate = np.zeros((3, self._problem.dimension))
        self._covariance = np.diag([0.0, 0.0, self._noise.prior**2])
        self.start_afresh()

    def start_afresh(self) -> None:
        """Forget where the vehicle was, for instance because the clock jumped."""
        self._last: Odometry | None = None
        self._begun = 0.0  # share of full speed with which the first command found the vehicle
        self._leaning = np.zeros(self._problem.dimension)  # innovations of late, as if only noise
        self.innovation, self.refused = 0.0, 0

    def continue_from(self, other: Estimator) -> None:
        """Take over what another estimator of the same vehicle knows."""
        self._estimate, self._covariance = other._estimate, other._covariance
        self._last, self._begun = other._last, other._begun
        self._leaning = other._leaning
        self.innovation, self.refused = other.innovation, other.refused

    @property
    def disturbance(self) -> Array:
        """Return the wind [m/s] or acceleration [m/s^2] beyond the given one, shape (n,)."""
        return np.array(self._estimate[-1])

    @property
    def _measured(self) -> tuple[float, ...]:
        """Return the variances of what is measured."""
        noise = self._noise
        return (noise.position**2, noise.velocity**2)[: 1 + self._problem.inertial]

    def observe(self, odometry: Odometry, history: CommandHistory, given: Array) -> None:
        """Take in a measurement; stamps that do not increase are passed over.

        Args:
            odometry: as it was measured.
            history: the commands, with the times when they were sent.
            given: the disturbance that is known, shape (n,).
        """
        last = self._last
        if last is not None and odometry.time <= last.time:
            return
        self._last = odometry
        if history.is_empty and not self._problem.inertial:
            self._begin(odometry, given)
        moved = None if last is None else self._moved(last, odometry, history, given)
        if moved is None:
            self._believe(odometry)
        else:
            time = odometry.time - last.time  # type: ignore[union-attr]
            self._predict(moved, time)
            self._correct(odometry, time)

    def limit(self, given: Array) -> str:
        """Keep the whole disturbance within what the vehicle can work against; tell it if needed.

        Args:
            given: the disturbance that is known, shape (n,).
        """
        problem, whole = self._problem, given + self._estimate[-1]
        size, most = float(np.linalg.norm(whole)), LARGEST * problem.forward
        most = max(most, float(np.linalg.norm(given)))
        if size <= most:
            return ''
        self._estimate[-1] = whole * (most / size) - given
        unit = 'm/s^2' if problem.inertial else 'm/s'
        return f'the disturbance is estimated to be {size:.3g} {unit}, taken as {most:.3g} {unit}'

    def _begin(self, odometry: Odometry, given: Array) -> None:
        """Take the measured airspeed for that with which the first command finds the vehicle.

        Over ground it is known as well as the wind is, or as what the vehicle can fly.
        """
        least = self._problem.floor.clearance(self._problem.dimension)
        source, noise = self._velocity_source, self._noise.velocity
        speed = airspeed(odometry, given + self._estimate[-1], source)
        self._begun = min(1.0, max(least, speed / self._problem.forward))
        if source == 'ground':
            noise = min(1.0 - least, math.sqrt(self._covariance[-1, -1]))
        self._forget(1, noise**2)
        self._estimate[1] = 0.0

    def _doubt(self) -> None:
        """Forget how well the disturbance is known: it has shifted."""
        self._forget(2, self._noise.prior**2)
        self._leaning = np.zeros_like(self._leaning)

    def _forget(self, row: int, variance: float) -> None:
        """Let a part of the state be known by no more than its variance."""
        self._covariance[row] = self._covariance[:, row] = 0.0
        self._covariance[row, row] = variance

    def _seen(self, odometry: Odometry) -> Array:
        """Return what is measured: the position, and at order 2 the velocity; shape (1 or 2, n)."""
        if not self._problem.inertial:
            return odometry.position[None]
        return np.array([odometry.position, odometry.attitude @ odometry.body_velocity])

    def _believe(self, odometry: Odometry) -> None:
        """Take the measurement for the state, which says nothing about the disturbance."""
        seen = self._seen(odometry)
        self._estimate[: len(seen)] = seen
        for row, variance in enumerate(self._measured):
            self._forget(row, variance)
        self.innovation, self.refused = 0.0, 0

    def _moved(
        self, last: Odometry, now: Odometry, history: CommandHistory, given: Array
    ) -> Array | None:
        """Return what commands and the given disturbance did since, shape (1 or 2, n); or None."""
        time = now.time - last.time
        share = self._mean_share(last, now, history)
        if time > GAP or share is None:
            return None
        ahead = np.zeros(self._problem.dimension)
        ahead[0] = self._problem.forward * share
        once, twice = turned(log(last.attitude.T @ now.attitude), ahead)
        if not self._problem.inertial:
            return np.array([time * (last.attitude @ once + given)])
        place = time * time * (last.attitude @ twice + 0.5 * given)
        return np.array([place, time * (last.attitude @ once + given)])

    def _mean_share(self, last: Odometry, now: Odometry, history: CommandHistory) -> float | None:
        """Return the mean share of full speed, or thrust, in between; None if it is unknown."""
        if self._as_measured:
            return 0.5 * float(last.body_velocity[0] + now.body_velocity[0]) / self._problem.forward
        return history.mean(last.time, now.time, self._lag, self._begun)

    def _predict(self, moved: Array, time: float) -> None:
        """Move the state on by so much, and by itself for a time [s]."""
        step, driven = np.eye(3), np.array([0.0, 1.0, 0.0])
        step[:2, 2] = 0.5 * time * time, time
        step[0, 1] = driven[0] = time
        if not self._problem.inertial:
            fading = math.exp(-time / self._lag) if self._lag else 0.0
            step[:2, 1:] = [[self._lag * (1.0 - fading), time], [fading, 0.0]]
            driven = np.array([1.0, 0.0, 0.0])
        self._estimate = step @ self._estimate
        self._estimate[: len(moved)] += moved
        drift = step[:, -1] * self._noise.drift
        spread = time * (self._noise.model**2 * np.outer(driven, driven) + np.outer(drift, drift))
        self._covariance = step @ self._covariance @ step.T + spread

    def _correct(self, odometry: Odometry, time: float) -> None:
        """Learn from a measurement a time [s] after the last, unless it is out of the question."""
        seen = self._seen(odometry)
        count, unit = len(seen), self._problem.forward
        missed = seen - self._estimate[:count]
        spread = self._covariance[:count, :count] + np.diag(self._measured)
        off = np.einsum('in,ij,jn->n', missed, np.linalg.inv(spread), missed) / unit**2
        self.innovation = float(np.sqrt(off.max() / count))
        if self.innovation > GATE:
            self.refused += 1
            if self.refused >= PATIENCE:  # the wind may have shifted as well
                self._believe(odometry)
                self._doubt()
            return
        self.refused, kept = 0, math.exp(-time / RECENT)
        latest = missed[-1] / (unit * math.sqrt(spread[-1, -1]))
        self._leaning = kept * self._leaning + math.sqrt(1.0 - kept**2) * latest
        gain = self._covariance[:, :count] @ np.linalg.inv(spread)
        self._estimate = self._estimate + gain @ missed
        left = np.eye(len(gain)) - gain @ np.eye(count, len(gain))
        # Joseph's form: symmetric and positive whatever is rounded.
        self._covariance = left @ self._covariance @ left.T + gain * self._measured @ gain.T
        if np.abs(self._leaning).max() > SHIFT:
            self._doubt()
