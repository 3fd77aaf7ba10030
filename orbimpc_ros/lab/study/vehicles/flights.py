"""One flight of a scenario by one pilot: a row of results."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from orbimpc_ros.lab.onboard import Planner, tell
from orbimpc_ros.lab.study.vehicles.pilots import pilot
from orbimpc_ros.lab.study.vehicles.scenario import Mission
from orbimpc_ros.mpc.outcome import Fallback, Status
from orbimpc_ros.ros.parameters import sim_settings
from orbimpc_ros.tool.io import settings
from orbimpc_ros.world.airspeed import Airspeeds
from orbimpc_ros.world.flight import departure
from orbimpc_ros.world.vehicle import Continuous

Row = dict[str, Any]


def row(scenario: Mission, name: str, seed: int, index: int, tuned: Mapping[str, float]) -> Row:
    """Fly a scenario.

    Args:
        scenario: what is flown.
        name: of the pilot.
        seed: with ``index``, of everything that is drawn.
        index: of the flight.
        tuned: what is set of the pilot.

    Returns:
        ``caught``, ``time`` [s] (None without a catch), ``closest`` [m], ``ticks``, ``proved``
        (ticks proved optimal), ``unplanned`` (ticks by a fallback), ``stalls``, and the processor
        time of the ticks, ``p50_ms`` and ``longest_ms``.
    """
    values = scenario.values | scenario.drawn(seed, index)
    simulated = sim_settings(settings.of_sim(values))
    made = partial(pilot, name, tuned=tuned)
    planner = Planner(values, patient=True, pilot=made)
    flight = departure(simulated.scenario, simulated.begin)
    model = flight.scenario.model
    airspeeds = Airspeeds(model.stall_speed if isinstance(model, Continuous) else 0.0)
    closest, proved, unplanned, spent = np.inf, 0, 0, []
    while not flight.over:
        tell(planner, flight, simulated.goal_path_steps)
        begun = time.thread_time()
        _, report = planner.report(flight.vehicle.time)
        spent.append(1e3 * (time.thread_time() - begun))
        tick = report.tick
        proved += tick.status is Status.OPTIMAL
        unplanned += tick.fallback is not Fallback.NONE
        flight = flight.after(tick.command.speed_fraction, tick.command.body_rate)
        airspeeds = airspeeds.seeing(flight.trail)
        closest = min(closest, flight.miss)
    caught = flight.captured
    return {
        'pilot': name,
        'seed': seed,
        'index': index,
        'caught': caught,
        'time': flight.missed_at - flight.scenario.start.time if caught else None,
        'closest': closest,
        'ticks': flight.ticks,
        'proved': proved,
        'unplanned': unplanned,
        'stalls': airspeeds.stalls,
        'p50_ms': float(np.median(spent)),
        'longest_ms': max(spent),
    }
