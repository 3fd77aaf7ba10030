# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The true motion of a vehicle on SO(n), turned by body rates and driven along its x axis.

It follows the discrete model, or a continuous-time plant with lags and limits in gusty air, or it
is moved by an engine: the physics of another library inside this simulator.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import import_module
from itertools import accumulate

import numpy as np

from orbimpc_ros.install import command_for_extra
from orbimpc_ros.loop.compensation import Odometry, followed
from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp, log, nearest
from orbimpc_ros.sim.engines import Engine, Vehicle

SUBSTEP = 0.02  # [s] longest integration step
SAMPLE = 0.02  # [s] between samples of gusts, interpolated linearly
BLOCK = 1024  # samples drawn at a time
USE = 2  # random stream of the seed; faults use 0 and 1


@dataclass(frozen=True)
class Model:
    """Response of a vehicle to commands; the fields are named like those of the Problem."""

    dimension: int = 2  # n, 2 or 3
    rotation_order: int = 1  # 1: a commanded rate acts at once; 2: from the next step on
    translation_order: int = 1  # 1: velocity along the forward axis; 2: acceleration
    step: float = 1.0  # h [s]
    forward: float = 1.0  # z, full speed [m/s] (order 1) or thrust acceleration [m/s^2] (2)
    disturbance: tuple[float, ...] = ()  # wind [m/s] or acceleration [m/s^2], shape (n,) or (0,)
    discretisation: str = 'euler'  # or ``exact``, as in the Problem

    gain = 1.0  # actual speed or thrust as a share of the command

    @property
    def blown(self) -> Array:
        """Return the disturbance, shape (n,)."""
        return np.array(self.disturbance or np.zeros(self.dimension))

    @property
    def rates(self) -> int:
        """Return the number of components of a body rate: 1 in the plane, 3 in space."""
        return 1 if self.dimension == 2 else 3

    def flown(
        self, vehicle: Vehicle, span: float, fraction: float, body_rate: Array
    ) -> tuple[Vehicle, ...]:
        """Return the vehicle at successive times under one command, the last at the end.

        This model takes a single step on the previous values and then adopts the command.

        Args:
            vehicle: initial state.
            span: duration [s].
            fraction: commanded share of full speed or thrust, clipped to [0, 1].
            body_rate: commanded, in the body frame, shape (1,) or (3,) [rad/s].
        """
        turning = body_rate if self.rotation_order == 1 else vehicle.body_rate
        attitude = nearest(vehicle.attitude @ exp(span * turning))  # nearest: no drift off SO(n)
        fraction, time = float(np.clip(fraction, 0.0, 1.0)), vehicle.time + span
        end = replace(vehicle, time=time, attitude=attitude, body_rate=body_rate, fraction=fraction)
        before, after = self._pushed(vehicle), self._pushed(end)
        exact = self.discretisation == 'exact'
        change: Array = span * ((0.5 * (before + after) if exact else before) + self.blown)
        velocity: Array = after + self.blown
        if self.translation_order == 2:
            change, velocity = span * vehicle.velocity, vehicle.velocity + change
            if exact:
                change = change + span * span * (before / 3.0 + after / 6.0 + 0.5 * self.blown)
        return (replace(end, position=vehicle.position + change, velocity=velocity),)

    def _pushed(self, vehicle: Vehicle) -> Array:
        """Return the airspeed [m/s] or thrust acceleration [m/s^2] as a vector, shape (n,)."""
        # z sigma Q e1, and the gain
        return np.asarray(self.gain * self.forward * vehicle.fraction * vehicle.attitude[:, 0])


def between(earlier: Vehicle, later: Vehicle, time: float) -> Vehicle:
    """Return the vehicle interpolated between two states, at ``time`` [s]."""
    share = (time - earlier.time) / (later.time - earlier.time)
    turned = log(earlier.attitude.T @ later.attitude)
    return replace(
        earlier,
        time=time,
        position=earlier.position + share * (later.position - earlier.position),
        attitude=earlier.attitude @ exp(share * turned),
        body_rate=turned / (later.time - earlier.time),
    )


def measured(vehicle: Vehicle, velocity_source: str = 'ground') -> Odometry:
    """Return exact odometry of the vehicle; velocity over ``ground`` or through the ``air``."""
    past = vehicle.velocity - (vehicle.wind if velocity_source == 'air' else 0.0)
    place, attitude = vehicle.position, vehicle.attitude
    return Odometry(vehicle.time, place, attitude, attitude.T @ past, vehicle.body_rate)


# --- in continuous time


def gusts(time: float, dimension: int, memory: float, seed: int) -> Array:
    """Return unit-variance first-order Gauss-Markov noise along each axis, shape (n,).

    Its correlation over a lag t is exp(-t/memory) [s]. It depends only on seed and time since the
    start [s], so that all vehicles with one seed meet the same gusts.
    """
    index = time / SAMPLE
    before = math.floor(index)
    blocks = 1 << ((before + 1) // BLOCK).bit_length()
    earlier, later = _series(seed, dimension, memory, blocks)[before : before + 2]
    share = index - before
    return np.asarray((1.0 - share) * earlier + share * later)


@lru_cache(maxsize=64)
def _series(seed: int, dimension: int, memory: float, blocks: int) -> Array:
    """Return unit-variance samples of gusts from the start on, shape (blocks * BLOCK, n)."""
    rngs = (np.random.default_rng((seed, USE, block)) for block in range(blocks))
    drawn = np.concatenate([rng.normal(size=(BLOCK, dimension)) for rng in rngs])
    kept = math.exp(-SAMPLE / memory)
    drawn[1:] *= math.sqrt(1.0 - kept * kept)  # the first is stationary noise
    return sealed(np.array([*accumulate(drawn, lambda last, new: kept * last + new)]))


@dataclass(frozen=True)
class Plant(Model):
    """A vehicle in continuous time, driven along its x axis.

    At all orders, commands act at once, through first-order lags: the orders of a :class:`Model`
    define the meaning of a command in the discrete steps of a planner.
    """

    speed_lag: float = 0.0  # time constant of the speed (translation order 1) or thrust (2) [s]
    rate_lag: float = 0.0  # time constant of the body rate [s]
    max_rate: float = 0.0  # limit of the body rate [rad/s]; 0 for no limit
    max_acceleration: float = 0.0  # limit of the change of speed (order 1) [m/s^2]; 0 for no limit
    gain: float = 1.0  # actual speed or thrust as a share of the command
    drag: float = 0.0  # deceleration per unit of velocity (order 2) [1/s]
    # standard deviation of gusts along each axis, in addition to the steady wind [m/s] (order 1)
    # or acceleration [m/s^2] (order 2)
    gust: float = 0.0
    gust_time: float = 3.0  # their correlation time [s]
    seed: int = 0  # of the gusts

    def __post_init__(self) -> None:
        if self.translation_order == 1 and self.drag:
            raise BadInput('drag', self.drag, '0 at translation_order 1, which commands airspeed')
        if self.translation_order == 2 and self.max_acceleration:
            allowed = '0 at translation_order 2, whose thrust is limited by forward'
            raise BadInput('max_acceleration', self.max_acceleration, allowed)
        self._wind(0.0)  # the first gust takes a second to draw: too long in a real-time flight

    def flown(
        self, vehicle: Vehicle, span: float, fraction: float, body_rate: Array
    ) -> tuple[Vehicle, ...]:
        """Return the vehicle after each integration step; see :meth:`Model.flown`."""
        size = float(np.linalg.norm(body_rate))
        if self.max_rate and size > self.max_rate:
            body_rate = body_rate * (self.max_rate / size)
        wanted = float(np.clip(fraction, 0.0, 1.0)), body_rate
        count = max(1, math.ceil(span / SUBSTEP - 1e-9))
        trail = []
        for _ in range(count):
            vehicle = self._moved(vehicle, span / count, *wanted)
            trail.append(vehicle)
        return tuple(trail)

    def _wind(self, time: float) -> Array:
        """Return the wind [m/s] or acceleration [m/s^2] at a time of the flight [s], shape (n,)."""
        if not self.gust:
            return self.blown
        return self.blown + self.gust * gusts(time, self.dimension, self.gust_time, self.seed)

    def _moved(self, vehicle: Vehicle, dt: float, fraction: float, body_rate: Array) -> Vehicle:
        """Return the vehicle after a short time ``dt`` [s], by the Runge-Kutta method.

        The actuators' own responses are exact.
        """
        times = (0.0, 0.5 * dt, dt)
        states = [self._actuated(vehicle, after, fraction, body_rate) for after in times]
        winds = [self._wind(vehicle.time + after) for after in times]
        first, second, third = (self._pushed(s) + w for s, w in zip(states, winds, strict=True))
        if self.translation_order == 1:
            shift, velocity, wind = dt / 6.0 * (first + 4.0 * second + third), third, winds[-1]
        else:
            begun, wind = vehicle.velocity, vehicle.wind
            a = first - self.drag * begun
            b = second - self.drag * (begun + 0.5 * dt * a)
            c = second - self.drag * (begun + 0.5 * dt * b)
            d = third - self.drag * (begun + dt * c)
            shift = dt * begun + dt * dt / 6.0 * (a + b + c)
            velocity = begun + dt / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        return replace(
            states[-1],
            time=vehicle.time + dt,
            position=vehicle.position + shift,
            velocity=velocity,
            attitude=nearest(states[-1].attitude),  # nearest: no drift off SO(n)
            wind=wind,
        )

    def _actuated(self, now: Vehicle, dt: float, fraction: float, body_rate: Array) -> Vehicle:
        """Return the vehicle with attitude (by the mean rate) and actuators after ``dt`` [s].

        These are exact responses of first-order lags. That of the speed has a limited slope as long
        as the remaining difference exceeds the slope times the lag.
        """
        body_rate, turned = followed(now.body_rate, body_rate, dt, self.rate_lag)
        attitude, reached, lag = now.attitude @ exp(turned), now.fraction, self.speed_lag
        if self.max_acceleration:
            limit, beyond = self.max_acceleration / (self.forward * self.gain), reached - fraction
            ramp = min(dt, max(0.0, abs(beyond) / limit - lag))
            reached, dt = reached - math.copysign(limit * ramp, beyond), dt - ramp
        if dt or not self.max_acceleration:
            reached, _ = followed(reached, fraction, dt, lag)
        return replace(now, attitude=attitude, body_rate=body_rate, fraction=reached)


# --- in an engine

# Vehicles, each with a class in the module of ``engines`` with its name, and the extra of this
# package that installs its libraries.
ENGINES = {'cessna': 'physics', 'hummingbird': 'physics', 'servicer': 'basilisk'}


def class_of(name: str) -> Callable[..., Engine]:
    """Return the engine class of a vehicle named in :data:`ENGINES`.

    Raises:
        BadInput: a library that it needs is not installed.
    """
    try:
        module = import_module(f'orbimpc_ros.sim.engines.{name}')
    except ModuleNotFoundError as error:
        library = str(error.name).partition('.')[0]
        hint = command_for_extra(ENGINES[name])
        raise BadInput.stating(f'vehicle {name}', f'{library} is missing', hint) from None
    return getattr(module, name.capitalize())
