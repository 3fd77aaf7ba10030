# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A vehicle in continuous time, with lags and limits, in gusty air."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp, nearest
from orbimpc_ros.sim.vehicle import Continuous, Vehicle

SUBSTEP = 0.02  # [s] longest piece of the integration
SAMPLE = 0.02  # [s] between samples of gusts; straight lines between them
BLOCK = 1024  # samples drawn at a time
USE = 2  # what of a seed is used; faults use 0 and 1


@dataclass(frozen=True)
class Gusts:
    """A first-order Gauss-Markov process along each axis, the same everywhere.

    Its correlation after t is exp(-t/memory). It depends on the time since the start alone: a seed
    brings the same gusts to whatever flies.
    """

    deviation: float = 0.0  # standard, along each axis [m/s], or [m/s^2] at translation order 2
    memory: float = 3.0  # correlation time [s]
    seed: int = 0

    def at(self, elapsed: float, dimension: int) -> Array:
        """Return the gust, shape (n,), at a time since the start [s]."""
        index = elapsed / SAMPLE
        before = math.floor(index)
        share = index - before
        earlier, later = (
            _block(self.seed, dimension, self.memory, k // BLOCK)[k % BLOCK]
            for k in (before, before + 1)
        )
        return np.asarray(self.deviation * ((1.0 - share) * earlier + share * later))


@lru_cache(maxsize=64)
def _block(seed: int, dimension: int, memory: float, number: int) -> Array:
    """Return gusts of unit deviation, shape (BLOCK, n), that go on from the block before."""
    rng = np.random.default_rng((seed, USE, number))
    kept = math.exp(-SAMPLE / memory)
    fresh = math.sqrt(1.0 - kept * kept)
    samples = rng.normal(size=(BLOCK, dimension))  # the very first is a stationary one
    if number:
        before = _block(seed, dimension, memory, number - 1)[-1]
        samples[0] = kept * before + fresh * samples[0]
    for k in range(1, BLOCK):
        samples[k] = kept * samples[k - 1] + fresh * samples[k]
    return sealed(samples)


CALM = Gusts()


@dataclass(frozen=True)
class Plant(Continuous):
    """A vehicle in continuous time, pushed along its x axis.

    Commands of all orders are taken at once and followed with first-order lags: the orders of a
    :class:`Model` define what a command means in the steps of a planner.
    """

    speed_lag: float = 0.0  # time constant of the speed (translation order 1) or thrust (2) [s]
    rate_lag: float = 0.0  # time constant of the body rate [s]
    max_rate: float = 0.0  # it turns no faster [rad/s]; 0 for no limit
    max_acceleration: float = 0.0  # its speed changes no faster (order 1) [m/s^2]; 0 for no limit
    gain: float = 1.0  # speed or thrust that it reaches, a share of what is commanded
    drag: float = 0.0  # deceleration by its own velocity (order 2) [1/s]
    gusts: Gusts = CALM  # on top of the steady wind (order 1) or acceleration (2)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.translation_order == 1 and self.drag:
            raise BadInput('drag', self.drag, '0 at translation_order 1, which commands airspeed')
        if self.translation_order == 2 and self.max_acceleration:
            allowed = '0 at translation_order 2, whose thrust is limited by forward'
            raise BadInput('max_acceleration', self.max_acceleration, allowed)

    def begun(self, vehicle: Vehicle) -> Vehicle:
        """Return a vehicle at its start, moving as it does in the air that there is then."""
        wind = self._wind(0.0)
        if self.translation_order == 2:
            return vehicle
        return replace(vehicle, velocity=self._pushed(vehicle) + wind, wind=wind)

    def flown(
        self, vehicle: Vehicle, span: float, fraction: float, body_rate: Array, elapsed: float
    ) -> tuple[Vehicle, ...]:
        """Return the vehicle at short intervals; see :meth:`Model.flown`."""
        wanted = float(np.clip(fraction, 0.0, 1.0)), self._limited(body_rate)
        count = max(1, math.ceil(span / SUBSTEP - 1e-9))
        trail, piece = [], span / count
        for k in range(count):
            vehicle = self._moved(vehicle, piece, *wanted, elapsed + k * piece)
            trail.append(vehicle)
        return tuple(trail)

    def _wind(self, elapsed: float) -> Array:
        """Return the wind [m/s] or acceleration [m/s^2], shape (n,), at a time since the start."""
        if not self.gusts.deviation:
            return self.blown
        return self.blown + self.gusts.at(elapsed, self.dimension)

    def _limited(self, body_rate: Array) -> Array:
        size = float(np.linalg.norm(body_rate))
        if self.max_rate and size > self.max_rate:
            return body_rate * (self.max_rate / size)
        return np.array(body_rate, dtype=float)

    def _moved(
        self, vehicle: Vehicle, dt: float, fraction: float, body_rate: Array, elapsed: float
    ) -> Vehicle:
        """Return the vehicle after a short time [s], by Simpson's rule."""
        now = _Actuated(vehicle.attitude, vehicle.body_rate, vehicle.fraction)
        pushes, wind, end = list[Array](), vehicle.wind, now
        for after in (0.0, 0.5 * dt, dt):
            end, wind = self._actuated(now, after, fraction, body_rate), self._wind(elapsed + after)
            pushes.append(self._pushed(end) + wind)
        if self.translation_order == 1:
            way, velocity = dt / 6.0 * (pushes[0] + 4.0 * pushes[1] + pushes[2]), pushes[2]
        else:
            way, velocity = self._accelerated(vehicle.velocity, pushes, dt)
            wind = vehicle.wind
        return Vehicle(
            vehicle.time + dt,
            vehicle.position + way,
            velocity,
            nearest(end.attitude),  # nearest: no drift off SO(n)
            end.body_rate,
            end.fraction,
            wind,
        )

    def _actuated(self, now: _Actuated, dt: float, fraction: float, body_rate: Array) -> _Actuated:
        """Return attitude and actuators after a time [s]; the attitude by the mean rate."""
        lag, apart = self.rate_lag, now.body_rate - body_rate
        left = math.exp(-dt / lag) if lag else 0.0
        turned = dt * body_rate + lag * (1.0 - left) * apart
        limit = self.max_acceleration / (self.forward * self.gain) or math.inf
        return _Actuated(
            now.attitude @ exp(turned),
            body_rate + left * apart,
            lagged(now.fraction, fraction, self.speed_lag, dt, limit),
        )

    def _pushed(self, now: _Actuated | Vehicle) -> Array:
        """Return the airspeed [m/s] or thrust acceleration [m/s^2] as a vector, shape (n,)."""
        return np.asarray(self.gain * self.forward * now.fraction * now.attitude[:, 0])

    def _accelerated(
        self, velocity: Array, pushes: Sequence[Array], dt: float
    ) -> tuple[Array, Array]:
        """Return the way [m] and the velocity [m/s] after a time, by Runge and Kutta's method.

        ``pushes`` are accelerations without drag now, after half the time and at its end.
        """
        first, second, third = pushes
        a = first - self.drag * velocity
        b = second - self.drag * (velocity + 0.5 * dt * a)
        c = second - self.drag * (velocity + 0.5 * dt * b)
        d = third - self.drag * (velocity + dt * c)
        way = dt * velocity + dt * dt / 6.0 * (a + b + c)
        return way, velocity + dt / 6.0 * (a + 2.0 * b + 2.0 * c + d)


class _Actuated(NamedTuple):
    """Where a vehicle points and what its actuators do: fields of a :class:`Vehicle`."""

    attitude: Array
    body_rate: Array
    fraction: float


def lagged(value: float, wanted: float, lag: float, dt: float, limit: float = math.inf) -> float:
    """Return what a value becomes after ``dt`` [s] by a first-order lag [s], exactly.

    It changes by no more than a ``limit`` [1/s].
    """
    apart = wanted - value
    if math.isfinite(limit):
        # At its limit as long as it is farther from its aim than limit * lag.
        ramp = min(dt, max(0.0, abs(apart) / limit - lag))
        value += math.copysign(limit * ramp, apart)
        apart, dt = wanted - value, dt - ramp
        if not dt:
            return value
    return wanted - apart * math.exp(-dt / lag) if lag else wanted
