# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Has MuJoCo draw a flight of ``orbimpc demo rope``, flown again from the commands in its bag."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

os.environ['MUJOCO_GL'] = 'egl'  # read when MuJoCo is imported: it needs no display

import mujoco
import numpy as np
from PIL import Image

from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.sim.node import Orders
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.sim.world import Flight, departure
from orbimpc_ros.tool import bags, settings
from orbimpc_ros.tool.plot import LAST

SIZE = 480, 720  # [px] height and width
LATER = 2**62  # [ns] after any flight


def flown_again(path: Path) -> Iterator[Flight]:
    """Yield a flight tick by tick: an engine does the same again on the same commands."""
    told = sim_settings(settings.of_sim(settings.of_bag(path)))
    flight, given = departure(told), {}
    orders = Orders(told)
    for each in bags.of_vehicle(path, '', ('cmd_vel', 'goal', 'odom')):
        if each.topic == 'cmd_vel' and (order := orders.take(each.topic, each.content, LATER)):
            given[order.stamp] = order
    yield flight
    while not flight.over and (at := round((told.begin + flight.vehicle.time) * SECOND)) in given:
        flight = flight.after(given[at].fraction, given[at].body_rate)
        yield flight


def picture(engine: Any, renderer: mujoco.Renderer) -> Image.Image:
    """Return what vehicle and rope look like now."""
    place, rope = engine._data.qpos[:3], engine._crossing()
    camera = mujoco.MjvCamera()
    camera.lookat[:] = 0.5 * (place + rope) + [0.0, 0.0, 0.3]
    camera.distance = 3.0 + 0.8 * float(np.linalg.norm(place - rope))
    camera.azimuth, camera.elevation = 60.0, -15.0
    renderer.update_scene(engine._data, camera)
    return Image.fromarray(renderer.render().copy()).quantize(128)


def render(bag: Path, file: Path) -> None:
    """Write the animation of a flight in real time; the catch, its end, is shown for longer."""
    pictures: list[Image.Image] = []
    for flight in flown_again(bag):
        engine = flight.vehicle.engine
        if not pictures:
            renderer = mujoco.Renderer(engine._model, *SIZE)
        pictures.append(picture(engine, renderer))
    shown = [round(1e3 * flight.settings.model.step)] * (len(pictures) - 1) + [LAST]
    pictures[0].save(file, save_all=True, append_images=pictures[1:], duration=shown, loop=0)
