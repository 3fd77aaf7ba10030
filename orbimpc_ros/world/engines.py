"""Vehicles that an engine moves: somebody else's physics behind the simulator of this package."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.physics.engine import Engine, EngineFailure, Motion, checked
from orbimpc_ros.world.vehicle import Continuous, Vehicle

ENGINES = {'cessna': ('jsbsim', 'Cessna')}  # by module of physics: its library and its class


@dataclass(frozen=True)
class EngineVehicle(Vehicle):
    """The state of a vehicle in an engine, which keeps all that is not here.

    Attributes:
        engine: that has it; it goes on with the last state alone.
        motion: in space.
    """

    engine: Engine | None = None
    motion: Motion | None = None

    @property
    def airspeed(self) -> float:
        """Return how fast it moves through the air, up and down too [m/s]."""
        return super().airspeed if self.motion is None else self.motion.airspeed

    @property
    def facts(self) -> Mapping[str, float]:
        """Return what else the engine knows of it, and its height."""
        more = {} if self.motion is None else self.motion.facts
        return {'height': self.height, **more}


@dataclass(frozen=True)
class Aircraft(Continuous):
    """An aircraft in an engine, on its own autopilots, in the plane of one altitude.

    It takes airspeeds and turns. Its wind is the steady one of the model, with turbulence on top.

    Attributes:
        engine: of :data:`ENGINES`.
        turbulence: standard deviation of the air's velocity along each axis [m/s].
        seed: of the turbulence.
    """

    engine: str = 'cessna'
    turbulence: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, needed in (('dimension', 2), ('translation_order', 1)):
            if getattr(self, name) != needed:
                raise BadInput(name, getattr(self, name), f'{needed} with vehicle: {self.engine}')

    def begun(self, vehicle: Vehicle) -> Vehicle:
        """Return a vehicle at its start, in an engine that is made for it.

        Raises:
            BadInput: the engine is not installed, or cannot start so.
        """
        heading = math.atan2(vehicle.attitude[1, 0], vehicle.attitude[0, 0])
        speed = self.forward * vehicle.fraction
        start = speed, heading, vehicle.position, self.blown, self.turbulence, self.seed
        try:
            engine = class_of(self.engine)(*start)
        except EngineFailure as error:
            raise BadInput('start.speed_fraction', vehicle.fraction, f'a start ({error})') from None
        return self._read(engine, engine.motion(), vehicle.time)

    def flown(
        self, vehicle: Vehicle, span: float, fraction: float, body_rate: Array, elapsed: float
    ) -> tuple[Vehicle, ...]:
        """Return the vehicle on its way through a time under one command, the last at its end.

        Args:
            vehicle: the last one that the engine has shown: it cannot go back.
            span: how long [s].
            fraction: commanded share of full speed.
            body_rate: commanded, shape (1,) [rad/s].
            elapsed: time since the start of the flight [s].

        Raises:
            EngineFailure: the engine has failed.
        """
        assert isinstance(vehicle, EngineVehicle)
        assert vehicle.engine is not None
        speed, engine = self.forward * float(np.clip(fraction, 0.0, 1.0)), vehicle.engine
        motions = checked(engine, elapsed, engine.run(span, speed, float(body_rate[0])), span)
        return tuple(self._read(engine, each, vehicle.time - elapsed) for each in motions)

    def _read(self, engine: Engine, motion: Motion, begun: float) -> EngineVehicle:
        """Return what a motion in space is in the plane, the engine having begun at a time [s]."""
        yaw = math.atan2(motion.attitude[1, 0], motion.attitude[0, 0])
        return EngineVehicle(
            time=begun + motion.time,
            position=motion.position[:2],
            velocity=motion.velocity[:2],
            attitude=np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]),
            body_rate=np.array([motion.facts['turn']]),
            fraction=min(motion.airspeed / self.forward, 1.0),
            wind=motion.air[:2],
            height=float(motion.position[2]),
            engine=engine,
            motion=motion,
        )


def class_of(name: str) -> Callable[..., Engine]:
    """Return the engine of a vehicle, by its name in :data:`ENGINES`.

    Raises:
        BadInput: its library is not installed.
    """
    library, kind = ENGINES[name]
    try:
        module = import_module(f'orbimpc_ros.physics.{name}')
    except ModuleNotFoundError as error:
        if error.name != library:
            raise
        hint = "pip install 'orbimpc_ros[physics]'"
        raise BadInput.stating(f'vehicle {name}', f'{library} is missing', hint) from None
    made: Callable[..., Engine] = getattr(module, kind)
    return made
