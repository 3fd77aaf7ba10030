# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Vehicles that are moved by an engine: the physics of another library in this simulator."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import NamedTuple

import numpy as np

from orbimpc_ros.install import command_for_extra
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.sim.engines import Engine, EngineFailure, Motion, Start
from orbimpc_ros.sim.vehicle import Model, Vehicle
from orbimpc_ros.sim.world import Rope


class Kind(NamedTuple):
    """A vehicle in an engine: the class in the module of ``engines`` that has its name."""

    dimension: int  # in which it is flown
    translation_order: int  # 1, it takes speeds; 2, thrusts
    lacks: tuple[str, ...]  # parameters that mean nothing to it, or that it decides itself
    extra: str = 'physics'  # of this package, that has the libraries


PLAIN = ('response.speed', 'response.rate', 'gust_time', 'drag', 'gain')  # of no engine
ROPE = ('goal_path_steps', 'rope.frequency', 'rope.velocity')  # of a goal that is no body
ENGINES = {
    'cessna': Kind(2, 1, PLAIN),
    'hummingbird': Kind(2, 1, (*PLAIN, *ROPE)),
    'servicer': Kind(3, 2, (*PLAIN, 'gust', 'stall_speed'), extra='basilisk'),
}


@dataclass(frozen=True)
class EnginePlant(Model):
    """A vehicle in an engine, on its own inner loop; in the plane it is that of one altitude.

    Its wind is the steady one of the model, with turbulence on top.
    """

    engine: str = 'cessna'  # of :data:`ENGINES`
    gust: float = 0.0  # standard deviation of the air's velocity along each axis [m/s]
    seed: int = 0  # of the turbulence, and of what else the engine draws
    rope: Rope | None = None  # the goal, for engines that move it themselves

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ('dimension', 'translation_order'):
            needed = getattr(ENGINES[self.engine], name)
            if getattr(self, name) != needed:
                raise BadInput(name, getattr(self, name), f'{needed} with vehicle: {self.engine}')

    def begun(self, vehicle: Vehicle) -> Vehicle:
        """Return a vehicle at its start, in an engine that is made for it.

        Raises:
            BadInput: the engine is not installed, or cannot start so.
        """
        goal = self.rope or Rope(vehicle.position)
        start = Start(
            *(vehicle.position, vehicle.velocity, vehicle.attitude, vehicle.body_rate),
            self.forward * vehicle.fraction,
            *(self.blown, self.gust, self.seed),
            *(goal.center, goal.at(0.0)),
        )
        try:
            engine = class_of(self.engine)(start)
        except EngineFailure as error:
            raise BadInput('vehicle', self.engine, f'a start that it has ({error})') from None
        return self._read(engine, engine.motion(), vehicle.time)

    def released(self, vehicle: Vehicle) -> Vehicle:
        """Return the vehicle once no command is in force: nothing changes at once."""
        return vehicle

    def flown(
        self, vehicle: Vehicle, span: float, fraction: float, body_rate: Array, elapsed: float
    ) -> tuple[Vehicle, ...]:
        """Return the vehicle at the intervals of its engine; see :meth:`Model.flown`.

        Raises:
            EngineFailure: the engine has failed.
        """
        assert vehicle.engine is not None
        push, engine = self.forward * float(np.clip(fraction, 0.0, 1.0)), vehicle.engine
        motions = engine.run(span, push, body_rate)
        return tuple(self._read(engine, each, vehicle.time - elapsed) for each in motions)

    def _read(self, engine: Engine, motion: Motion, begun: float) -> Vehicle:
        """Return the state that a planner sees of a motion; the engine began at a time [s]."""
        n, height, climb = self.dimension, 0.0, 0.0
        attitude, rate = motion.attitude, motion.body_rate
        if n == 2:
            yaw = math.atan2(attitude[1, 0], attitude[0, 0])
            attitude = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
            height, rate = float(motion.position[2]), np.array([motion.facts['turn']])
            climb = float((motion.velocity - motion.air)[2])
        return Vehicle(
            time=begun + motion.time,
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
    """Return the engine of a vehicle, by its name in :data:`ENGINES`.

    Raises:
        BadInput: a library that it takes is not installed.
    """
    try:
        module = import_module(f'orbimpc_ros.sim.engines.{name}')
    except ModuleNotFoundError as error:
        library = str(error.name).partition('.')[0]
        hint = command_for_extra(ENGINES[name].extra)
        raise BadInput.stating(f'vehicle {name}', f'{library} is missing', hint) from None
    made: Callable[..., Engine] = getattr(module, name.capitalize())
    return made
