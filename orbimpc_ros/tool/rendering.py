# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""An animation of a flight as its engine renders it, flown again from the commands in its bag."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.sim.commands import Orders
from orbimpc_ros.sim.engine_vehicle import EngineVehicle
from orbimpc_ros.sim.engines.engine import Depicted
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.sim.world import Flight, departure
from orbimpc_ros.tool import bags, settings

RENDERED = 'rendered.gif'
LATER = 2**62  # [ns] after any flight


def flown_again(path: Path) -> Iterator[Flight]:
    """Yield a flight tick by tick as the commands in its bag have it.

    An engine does the same again on the same commands: in lock-step each answers one odometry.

    Args:
        path: of the bag.
    """
    told = sim_settings(settings.of_sim(settings.of_bag(path, '') or settings.read('{}')))
    flight, given = departure(told.scenario, told.begin), {}
    orders = Orders(told.scenario.model, told.frames)
    take = {'cmd_vel': orders.take_twist, 'cmd_thrust': orders.take_force}
    for topic, message in bags.of_vehicle(path, '', (*take, 'goal', 'odom')):
        if topic in take and take[topic](message, LATER) and orders.latest:
            given[orders.latest.stamp] = orders.latest
    yield flight
    while not flight.over and (at := round(flight.vehicle.time * SECOND)) in given:
        flight = flight.after(given[at].fraction, given[at].body_rate)
        yield flight


def render(path: Path, folder: Path) -> Path | None:
    """Write the animation of a flight in real time; None if its engine draws nothing.

    Args:
        path: of the bag.
        folder: takes the animation.

    Raises:
        Exception: the engine cannot draw here.
    """
    pictures: list[Image.Image] = []
    period = 0.0
    for flight in flown_again(path):
        vehicle, period = flight.vehicle, flight.scenario.model.step
        if not isinstance(vehicle, EngineVehicle) or not isinstance(vehicle.engine, Depicted):
            return None
        pictures.append(_quantised(vehicle.engine.picture()))
    place = folder / RENDERED
    duration = round(1e3 * period)
    pictures[0].save(place, save_all=True, append_images=pictures[1:], duration=duration, loop=0)
    return place


def _quantised(picture: NDArray[np.uint8]) -> Image.Image:
    return Image.fromarray(picture).quantize(128)
