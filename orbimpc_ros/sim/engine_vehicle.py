# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Vehicles that are moved by an engine: the physics of another library in this simulator."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import NamedTuple

import numpy as np

from orbimpc_ros.install import command_for_extra
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.sim.engines import NoStart
from orbimpc_ros.sim.engines.engine import Engine, Motion, Start, checked
from orbimpc_ros.sim.vehicle import Continuous, Vehicle
from orbimpc_ros.sim.world import Rope, fixed


class Kind(NamedTuple):
    """A vehicle in an engine.

    Attributes:
        libraries: that it takes, by the names of their modules.
        made_by: the class of the module in ``engines`` that has the vehicle's name.
        dimension: in which it is flown.
        translation_order: 1, it takes speeds; 2, thrusts.
        moves_goal: whether the goal is a body of the engine, too.
        extra: of this package, that has the libraries.
    """

    libraries: tuple[str, ...]
    made_by: str
    dimension: int
    translation_order: int
    moves_goal: bool = False
    extra: str = 'physics'


ENGINES = {
    'cessna': Kind(('jsbsim',), 'Cessna', 2, 1),
    'hummingbird': Kind(('mujoco', 'rotorpy'), 'Hummingbird', 2, 1, moves_goal=True),
    'servicer': Kind(('Basilisk',), 'Servicer', 3, 2, extra='basilisk'),
}


@dataclass(frozen=True)
class EngineVehicle(Vehicle):
    """The state of a vehicle in an engine; the engine holds the rest of it.

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
        """Return its height, and what else the engine reports."""
        more = {} if self.motion is None else self.motion.facts
        return {'height': self.height, **more}

    @property
    def goal(self) -> Array | None:
        """Return where the goal is, shape (n,) [m], if the engine moves it."""
        known = None if self.motion is None else self.motion.goal
        return None if known is None else known[: len(self.position)]

    @property
    def caught(self) -> bool | None:
        """Return whether it has caught the goal, where the engine decides that."""
        return None if self.motion is None else self.motion.caught

    @property
    def lost(self) -> bool:
        """Return whether the goal can no longer be caught, as the engine decides."""
        return self.motion is not None and self.motion.lost


@dataclass(frozen=True)
class EnginePlant(Continuous):
    """A vehicle in an engine, on its own inner loop; in the plane it is that of one altitude.

    Its wind is the steady one of the model, with turbulence on top.

    Attributes:
        engine: of :data:`ENGINES`.
        turbulence: standard deviation of the air's velocity along each axis [m/s].
        seed: of the turbulence, and of what else the engine draws.
        rope: the goal, for engines that move it themselves: where it is at rest, and at the start.
    """

    engine: str = 'cessna'
    turbulence: float = 0.0
    seed: int = 0
    rope: Rope | None = None

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
        goal = self.rope or fixed(vehicle.position)
        start = Start(
            vehicle.position,
            vehicle.velocity,
            vehicle.attitude,
            vehicle.body_rate,
            self.forward * vehicle.fraction,
            self.blown,
            self.turbulence,
            self.seed,
            goal.center,
            goal.at(0.0),
        )
        try:
            engine = class_of(self.engine)(start)
        except NoStart as error:
            given = {
                'start.speed_fraction': vehicle.fraction,
                'rope.amplitude': goal.amplitude.tolist(),
            }
            allowed = f'a start ({error})'
            raise BadInput(error.culprit, given[error.culprit], allowed) from None
        return self._read(engine, engine.motion(), vehicle.time)

    def flown(
        self, vehicle: Vehicle, span: float, fraction: float, body_rate: Array, elapsed: float
    ) -> tuple[Vehicle, ...]:
        """Return the vehicle at the intervals of its engine; see :meth:`Model.flown`.

        Raises:
            EngineFailure: the engine has failed.
        """
        assert isinstance(vehicle, EngineVehicle)
        assert vehicle.engine is not None
        push, engine = self.forward * float(np.clip(fraction, 0.0, 1.0)), vehicle.engine
        motions = checked(engine, elapsed, engine.run(span, push, body_rate), span)
        return tuple(self._read(engine, each, vehicle.time - elapsed) for each in motions)

    def _read(self, engine: Engine, motion: Motion, begun: float) -> EngineVehicle:
        """Return the state that a planner sees of a motion; the engine began at a time [s]."""
        n, height, rate = self.dimension, 0.0, motion.body_rate
        attitude = motion.attitude
        if n == 2:
            yaw = math.atan2(attitude[1, 0], attitude[0, 0])
            attitude = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
            height, rate = float(motion.position[2]), np.array([motion.facts['turn']])
        return EngineVehicle(
            time=begun + motion.time,
            position=motion.position[:n],
            velocity=motion.velocity[:n],
            attitude=attitude,
            body_rate=rate,
            fraction=min(max(motion.push / self.forward, 0.0), 1.0),
            wind=motion.air[:n],
            height=height,
            engine=engine,
            motion=motion,
        )


def class_of(name: str) -> Callable[..., Engine]:
    """Return the engine of a vehicle, by its name in :data:`ENGINES`.

    Raises:
        BadInput: a library that it takes is not installed.
    """
    kind = ENGINES[name]
    try:
        module = import_module(f'orbimpc_ros.sim.engines.{name}')
    except ModuleNotFoundError as error:
        library = str(error.name).partition('.')[0]
        if library not in kind.libraries:
            raise
        hint = command_for_extra(kind.extra)
        raise BadInput.stating(f'vehicle {name}', f'{library} is missing', hint) from None
    made: Callable[..., Engine] = getattr(module, kind.made_by)
    return made
