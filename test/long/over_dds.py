# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Missions flown by the real nodes over DDS, in lock-step, and judged by what they said.

Planner and simulator are processes, as in ``orbimpc demo``. The vehicle is judged by the topic
``truth``, the commands by ``cmd_vel``: whatever is in between is on trial as well. Each flight
leaves its bag, parameters and logs in a folder.
"""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import jobs
import numpy as np
from missions import Outcome, Tally, record

from orbimpc_ros.tool import bags, history
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.run.flying import fly


def row(
    name: str, seed: int, index: int, changes: Sequence[str] = (), *, folder: Path
) -> dict[str, Any]:
    """Fly a mission of a name, a seed and an index over DDS; ``folder`` takes the flights."""
    values, drawn = jobs.drawn(name, seed, index, changes)
    place = folder / f'{name}-{seed}-{index}'
    shutil.rmtree(place, ignore_errors=True)  # of a run before
    place.mkdir(parents=True)
    begun = time.perf_counter()
    with (place / 'run.log').open('w') as log, redirect_stdout(log), redirect_stderr(log):
        fly(values, place)
    flown = history.of_bag(place / 'bag')
    tally = told(flown, bags.of_vehicle(place / 'bag', '', ('cmd_vel', 'odom', 'goal')))
    missed, speed = flown.missed
    outcome = Outcome(
        flown.captured,
        flown.end - flown.times[0] if flown.captured else None,
        tally.miss if values['finish'] == 'capture' else missed,
        speed,
        len(flown.truth['touched']),
        flown.truth['least_airspeed'],
        flown.truth['stalls'],
        time.perf_counter() - begun,
    )
    return {'mission': name, 'seed': seed, 'index': index} | record(values, drawn, outcome, tally)


def told(flown: History, messages: Sequence[tuple[str, Any]]) -> Tally:
    """The tally of what was sent and of what ticks said."""
    tally = Tally()
    for fraction, turning in commands(flown, messages):
        tally.sent(fraction, turning)
    for _, tick in flown.ticks:
        tally.ticked(tick['fallback'] or 'plan', tick['solve_time_ms'])
        if tick['status'] != 'optimal' and isinstance(tick['gap'], float):
            tally.gaps.append(tick['gap'])
    tally.distances = np.linalg.norm(flown.positions - flown.ropes, axis=1).tolist()
    tally.miss = min([each.distance for each in flown.approaches], default=math.inf)
    return tally


def commands(
    flown: History, messages: Sequence[tuple[str, Any]]
) -> Iterator[tuple[float, list[float]]]:
    """What was sent: the shares of full speed or thrust, and the body rates [rad/s]."""
    values = flown.values
    twists = [message.twist for topic, message in messages if topic == 'cmd_vel']
    pushed, full = [each.linear.x for each in twists], values['forward']
    if values['translation_order'] == 2:
        pushed, full = [force for _, force in flown.forces], values['mass'] * full
    for push, twist in zip(pushed, twists, strict=True):
        yield push / full, [twist.angular.x, twist.angular.y, twist.angular.z]
