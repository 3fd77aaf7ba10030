# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The true motion of a vehicle: on SO(n), turned by body rates, pushed along its x axis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.arrays import Array, frozen, number
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp, log, nearest
from orbimpc_ros.sim.engines import Engine


@dataclass(frozen=True)
class Model:
    """How a vehicle answers to commands; the fields are named like those of the Problem."""

    dimension: int = 2  # n, 2 or 3
    rotation_order: int = 1  # 1, it turns at the commanded rate at once; 2, from the next step on
    translation_order: int = 1  # 1, the forward axis carries a velocity; 2, an acceleration
    step: float = 1.0  # h [s]
    forward: float = 1.0  # z, full speed [m/s] (order 1) or thrust acceleration [m/s^2] (2)
    mass: float = 1.0  # turns a thrust acceleration into a force [kg]
    failsafe_fraction: float = 0.0  # share of full speed or thrust while no command is in force
    failsafe_rate: float = 0.0  # turn about the body's z axis meanwhile [rad/s]
    disturbance: tuple[float, ...] = ()  # wind [m/s] or acceleration [m/s^2], n numbers or none
    discretisation: str = 'euler'  # or ``exact``, as in the Problem
    velocity_source: str = 'ground'  # of odometry, or ``air``

    def __post_init__(self) -> None:
        if self.disturbance:
            frozen(self.disturbance, (self.dimension,), 'wind')
        fastest = np.pi / self.step
        number(self.failsafe_rate, 'failsafe.rate', -fastest, fastest)

    @property
    def length_unit(self) -> float:
        """Return what a step moves it at most, as :attr:`Problem.length_unit` [m]."""
        return self.step**self.translation_order * self.forward

    @property
    def blown(self) -> Array:
        """Return the disturbance, shape (n,)."""
        return np.array(self.disturbance or np.zeros(self.dimension))

    @property
    def wind(self) -> Array:
        """Return the velocity of the air, shape (n,) [m/s]; zero at translation order 2."""
        return self.blown if self.translation_order == 1 else np.zeros(self.dimension)

    @property
    def failsafe_turn(self) -> Array:
        """Return the body rate while no command is in force, shape (1,) or (3,) [rad/s]."""
        return np.array([0.0, 0.0, self.failsafe_rate])[-self.rates :]

    @property
    def rates(self) -> int:
        """Return how many components a body rate has: 1 in the plane, 3 in space."""
        return 1 if self.dimension == 2 else 3

    def begun(self, vehicle: Vehicle) -> Vehicle:
        """Return a vehicle at its start, moving as it does in this model."""
        return vehicle

    def flown(
        self, vehicle: Vehicle, span: float, fraction: float, body_rate: Array, elapsed: float
    ) -> tuple[Vehicle, ...]:
        """Return the vehicle at intervals of a time under one command, the last at its end.

        Args:
            vehicle: where it is.
            span: how long [s]; here a step, flown in one piece.
            fraction: commanded share of full speed or thrust.
            body_rate: commanded, in the body frame, shape (1,) or (3,) [rad/s].
            elapsed: time since the start of the flight [s].
        """
        del elapsed  # nothing changes with time
        return (advance(replace(self, step=span), vehicle, fraction, body_rate),)

    def released(self, vehicle: Vehicle) -> Vehicle:
        """Return the vehicle once no command is in force: by default it stops, there and then.

        At translation order 2 that is to coast: no command takes the velocity away.
        """
        velocity = vehicle.velocity
        if self.translation_order == 1:
            velocity = self.forward * self.failsafe_fraction * vehicle.attitude[:, 0] + self.wind
        return replace(
            vehicle,
            velocity=velocity,
            body_rate=self.failsafe_turn,
            fraction=self.failsafe_fraction,
        )


@dataclass(frozen=True)
class Continuous(Model):
    """A vehicle in continuous time, which follows commands from the moment that they come."""

    stall_speed: float = 0.0  # airspeed below which it is counted as stalled [m/s]; it flies on

    def released(self, vehicle: Vehicle) -> Vehicle:
        """Return the vehicle once no command is in force: nothing changes at once."""
        return vehicle


@dataclass(frozen=True)
class Vehicle:
    """The state of a simulated vehicle; what is in an engine goes on with its last state alone."""

    time: float  # since the start of its clock [s]
    position: Array  # s, shape (n,) [m]
    velocity: Array  # p, in the world frame, shape (n,) [m/s]; at order 1 it follows from the rest
    attitude: Array  # Q, body to world, shape (n, n)
    body_rate: Array  # omega, in the body frame, shape (1,) or (3,) [rad/s]
    fraction: float  # sigma, share of full speed or thrust now applied, in [0, 1]
    wind: Array = field(default_factory=lambda: np.zeros(0))  # shape (n,) [m/s]; still if empty
    height: float = 0.0  # above the plane that it is to fly in [m]; 0 in space
    climb: float = 0.0  # upwards through the air, out of that plane [m/s]
    facts: Mapping[str, float] = field(default_factory=dict)  # further figures of it, by name
    goal: Array | None = None  # shape (n,) [m]; None where the scenario decides where it is
    caught: bool | None = None  # whether it has caught the goal; None where distance decides
    lost: bool = False  # whether it can no longer catch the goal
    engine: Engine | None = None  # that moves it

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(self.position))
        if n not in (2, 3):
            raise BadInput('start.position', n, '2 or 3 numbers')
        if not len(self.wind):
            object.__setattr__(self, 'wind', np.zeros(n))
        number(self.time, 'start.time')
        number(self.fraction, 'start.speed_fraction', 0.0, 1.0)
        for name, shape in (
            ('position', (n,)),
            ('velocity', (n,)),
            ('attitude', (n, n)),
            ('body_rate', (1 if n == 2 else 3,)),
            ('wind', (n,)),
        ):
            object.__setattr__(self, name, frozen(getattr(self, name), shape, f'start.{name}'))

    @property
    def airspeed(self) -> float:
        """Return how fast it moves through the air [m/s]."""
        return float(np.linalg.norm(np.append(self.velocity - self.wind, self.climb)))


def launched(
    model: Model,
    position: Array,
    attitude: Array,
    *,
    fraction: float = 1.0,
    velocity: Array | None = None,
    body_rate: Array | None = None,
) -> Vehicle:
    """Return a vehicle at time 0; velocity (order 2 only) and body rate are zero by default.

    Args:
        model: how it moves.
        position: shape (n,) [m].
        attitude: of the body in the world, shape (n, n).
        fraction: share of full speed or thrust, in [0, 1].
        velocity: in the world, shape (n,) [m/s]; at translation order 1 it follows from the rest.
        body_rate: shape (1,) or (3,) [rad/s].
    """
    if model.translation_order == 1:
        velocity = model.forward * fraction * attitude[:, 0] + model.wind
    elif velocity is None:
        velocity = np.zeros(model.dimension)
    rate = np.zeros(model.rates) if body_rate is None else body_rate
    return Vehicle(0.0, position, velocity, nearest(attitude), rate, fraction, model.wind)


def advance(model: Model, vehicle: Vehicle, fraction: float, body_rate: Array) -> Vehicle:
    """Return the vehicle one step later: flown from the old values, the command then taken over.

    The commanded share of full speed or thrust is clipped to [0, 1].
    """
    h = model.step
    pushed = model.forward * vehicle.fraction * vehicle.attitude[:, 0]  # z sigma Q e1
    turning = body_rate if model.rotation_order == 1 else vehicle.body_rate
    attitude = nearest(vehicle.attitude @ exp(h * turning))  # nearest: no drift off SO(n)
    fraction = float(np.clip(fraction, 0.0, 1.0))
    new = model.forward * fraction * attitude[:, 0]
    mean = 0.5 * (pushed + new) if model.discretisation == 'exact' else pushed
    way: Array = h * (mean + model.blown)
    velocity: Array = new + model.wind
    if model.translation_order == 2:
        way, velocity = h * vehicle.velocity, vehicle.velocity + way
        if model.discretisation == 'exact':
            way = way + h * h * (pushed / 3.0 + new / 6.0 + 0.5 * model.blown)
    return Vehicle(
        vehicle.time + h,
        vehicle.position + way,
        velocity,
        attitude,
        np.array(body_rate),
        fraction,
        model.wind,
    )


def between(earlier: Vehicle, later: Vehicle, time: float) -> Vehicle:
    """Return the vehicle on its way from one step to the next, at ``time`` [s]."""
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
    """Return perfect odometry of the vehicle, over ``ground`` or through the ``air``."""
    velocity = vehicle.velocity
    if velocity_source == 'air':
        velocity = velocity - vehicle.wind
    return Odometry(
        vehicle.time,
        vehicle.position,
        vehicle.attitude,
        vehicle.attitude.T @ velocity,
        vehicle.body_rate,
    )
