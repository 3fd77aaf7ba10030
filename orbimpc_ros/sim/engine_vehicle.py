# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Vehicles moved by an engine: the physics of another library inside this simulator."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from typing import NamedTuple

import numpy as np

from orbimpc_ros.install import command_for_extra
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.sim.engines import Engine, EngineFailure, Motion, Start
from orbimpc_ros.sim.vehicle import Model, Rope, Vehicle


class Kind(NamedTuple):
    """Properties of an engine vehicle; its class is in the module of ``engines`` with its name."""

    dimension: int  # of its flight
    translation_order: int  # 1: commanded by speed; 2: by thrust
    lacks: tuple[str, ...]  # parameters that do not apply, or that the engine sets
    extra: str = 'physics'  # of this package, which installs the libraries


PLAIN = ('response.speed', 'response.rate', 'gust_time', 'drag', 'gain')  # of plants without engine
ROPE = ('goal_path_steps', 'rope.frequency', 'rope.velocity')  # of goals moved without engine
ENGINES = {
    'cessna': Kind(2, 1, PLAIN),
    'hummingbird': Kind(2, 1, (*PLAIN, *ROPE)),
    'servicer': Kind(3, 2, (*PLAIN, 'gust', 'stall_speed'), extra='basilisk'),
}


@dataclass(frozen=True)
class EnginePlant(Model):
    """A vehicle moved by an engine with its own inner loop; in the plane, flight at one altitude.

    Its wind is the steady wind of the model plus turbulence.
    """

    engine: str = 'cessna'  # a key of :data:`ENGINES`
    gust: float = 0.0  # standard deviation of the turbulence along each axis [m/s]
    seed: int = 0  # of the turbulence and all other random draws of the engine
    rope: Rope = field(kw_only=True)  # the goal, for engines that simulate its motion

    lags = True

    def __post_init__(self) -> None:
        for name in ('dimension', 'translation_order'):
            needed = getattr(ENGINES[self.engine], name)
            if getattr(self, name) != needed:
                raise BadInput(name, getattr(self, name), f'{needed} with vehicle: {self.engine}')

    def begun(self, vehicle: Vehicle) -> Vehicle:
        """Return the vehicle in its initial state, with a new engine.

        Raises:
            BadInput: the engine is not installed, or cannot start from this state.
        """
        start = Start(
            *(vehicle.position, vehicle.velocity, vehicle.attitude, vehicle.body_rate),
            self.forward * vehicle.fraction,
            *(self.blown, self.gust, self.seed),
            *(self.rope.center, self.rope.at(0.0)),
        )
        try:
            engine = class_of(self.engine)(start)
        except EngineFailure as error:
            raise BadInput('vehicle', self.engine, f'a possible start ({error})') from None
        return self._read(engine, engine.motion())

    def flown(
        self, vehicle: Vehicle, span: float, fraction: float, body_rate: Array
    ) -> tuple[Vehicle, ...]:
        """Return the vehicle at the output times of its engine; see :meth:`Model.flown`.

        Raises:
            EngineFailure: the engine has failed.
        """
        assert vehicle.engine is not None
        push, engine = self.forward * float(np.clip(fraction, 0.0, 1.0)), vehicle.engine
        return tuple(self._read(engine, each) for each in engine.run(span, push, body_rate))

    def _read(self, engine: Engine, motion: Motion) -> Vehicle:
        """Return a motion as a vehicle state."""
        n, height, climb = self.dimension, 0.0, 0.0
        attitude, rate = motion.attitude, motion.body_rate
        if n == 2:
            yaw = math.atan2(attitude[1, 0], attitude[0, 0])
            attitude = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
            height, rate = float(motion.position[2]), np.array([motion.facts['turn']])
            climb = float((motion.velocity - motion.air)[2])
        return Vehicle(
            time=motion.time,
            position=motion.position[:n],
            velocity=motion.velocity[:n],
            attitude=attitude,
            body_rate=rate,
            fraction=min(max(motion.push / self.forward, 0.0), 1.0),
            wind=motion.air[:n],
            height=height,
            climb=climb,
            facts={'height': height, **motion.facts},
            goal=None if motion.goal is None else motion.goal[:n],
            caught=motion.caught,
            lost=motion.lost,
            engine=engine,
        )


def class_of(name: str) -> Callable[..., Engine]:
    """Return the engine class of a vehicle named in :data:`ENGINES`.

    Raises:
        BadInput: a library that it needs is not installed.
    """
    try:
        module = import_module(f'orbimpc_ros.sim.engines.{name}')
    except ModuleNotFoundError as error:
        library = str(error.name).partition('.')[0]
        hint = command_for_extra(ENGINES[name].extra)
        raise BadInput.stating(f'vehicle {name}', f'{library} is missing', hint) from None
    made: Callable[..., Engine] = getattr(module, name.capitalize())
    return made
