# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""One flight of a scenario by one pilot: a row of results."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from orbimpc_ros.lab.onboard import Planner, tell
from orbimpc_ros.lab.study.vehicles.pilots import WAYPOINT, pilot
from orbimpc_ros.lab.study.vehicles.scenario import Mission
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.loop.controller import Tick
from orbimpc_ros.mpc.outcome import Fallback, Status
from orbimpc_ros.physics.engine import Guided
from orbimpc_ros.physics.failure import EngineFailure
from orbimpc_ros.ros.parameters import sim_settings
from orbimpc_ros.tool.io import settings
from orbimpc_ros.world.airspeed import Airspeeds
from orbimpc_ros.world.engines import EngineVehicle
from orbimpc_ros.world.flight import Flight, departure
from orbimpc_ros.world.vehicle import Continuous, Vehicle

Row = dict[str, Any]
NEARLY_ALL = 0.95  # of the ticks of a flight
MOMENT = 1e-6  # [s] shorter than between two vehicles on a trail


def row(scenario: Mission, name: str, seed: int, index: int, tuned: Mapping[str, float]) -> Row:
    """Fly a scenario.

    Args:
        scenario: what is flown.
        name: of the pilot.
        seed: with ``index``, of everything that is drawn.
        index: of the flight.
        tuned: what is set of the pilot.

    Returns:
        ``caught``, ``time`` [s] (None without a catch), ``closest`` [m], ``touched`` (whether it
        ended at an obstacle), ``ticks``, ``proved`` (ticks proved optimal), ``unplanned`` (ticks
        by a fallback), ``stalls``, and the processor time of the ticks, ``p50_ms`` and
        ``longest_ms``; ``tracking`` [m], how far from its plan the next one begins, in 19
        ticks of 20 at most (None without plans); ``failed``, how the engine has failed, if so; of
        an arrival ``missed`` [m] and ``speed`` [m/s] at its end, and of a vehicle in an engine
        ``airspeed`` [m/s] and what :class:`Facts` has, too.
    """
    values = scenario.values | scenario.drawn(seed, index)
    simulated = sim_settings(settings.of_sim(values))
    made = partial(pilot, name, tuned=tuned)
    # Others may keep the machine busy: what ticks take is counted in processor time.
    planner = Planner(values, pilot=made, clock=time.thread_time)
    flight = departure(simulated.scenario, simulated.begin)
    model = flight.scenario.model
    airspeeds = Airspeeds(model.stall_speed if isinstance(model, Continuous) else 0.0)
    closest, proved, unplanned, spent, facts = np.inf, 0, 0, [], Facts()
    tracking: list[float] = []
    last, at, failed = None, flight.vehicle.time, ''
    while not (flight.over or flight.touched):
        tell(planner, flight, simulated.goal_path_steps, scenario.margin)
        begun = time.thread_time()
        _, report = planner.report(flight.vehicle.time)
        spent.append(1e3 * (time.thread_time() - begun))
        tick = report.tick
        tracking += _off(last, tick, flight.vehicle.time - at)
        last, at = tick, flight.vehicle.time
        proved += tick.status is Status.OPTIMAL
        unplanned += tick.fallback is not Fallback.NONE
        if name == WAYPOINT:
            _aim(flight)
        try:
            flight = flight.after(tick.command.speed_fraction, tick.command.body_rate)
        except EngineFailure as error:
            failed = str(error)
            break
        airspeeds = airspeeds.seeing(flight.trail)
        facts = facts.seeing(flight, closest)
        closest = min(closest, flight.miss)
    caught = flight.captured
    return {
        'pilot': name,
        'seed': seed,
        'index': index,
        'caught': caught,
        'time': flight.missed_at - flight.scenario.start.time if caught else None,
        'closest': closest,
        'touched': bool(flight.touched),
        'ticks': flight.ticks,
        'proved': proved,
        'unplanned': unplanned,
        'stalls': airspeeds.stalls,
        'p50_ms': float(np.median(spent)),
        'longest_ms': max(spent),
        'tracking': float(np.quantile(tracking, NEARLY_ALL)) if tracking else None,
        'failed': failed,
        **_end(flight),
        **(asdict(facts) | {'airspeed': airspeeds.least} if _has_engine(flight) else {}),
    }


def _off(before: Tick | None, now: Tick, span: float) -> Sequence[float]:
    """Return how far from the plan of a tick the next one begins, a time [s] later [m].

    A plan begins where the lags of what was commanded before are over. Nothing without a plan.
    """
    if before is None or before.plan is None or before.problem is None or now.state is None:
        return ()
    ends = before.problem.step * np.arange(len(before.plan.positions))
    planned = [np.interp(span, ends, along) for along in before.plan.positions.T]
    return (float(np.linalg.norm(now.state.position - planned)),)


def _end(flight: Flight) -> Row:
    """Return where an arrival has ended; nothing of a catch."""
    arrival = flight.scenario.finish == 'arrival'
    return {'missed': flight.distance, 'speed': flight.speed} if arrival else {}


def _has_engine(flight: Flight) -> bool:
    return isinstance(flight.vehicle, EngineVehicle)


@dataclass(frozen=True)
class Facts:
    """What an engine knows of a flight.

    Attributes:
        bank: the largest so far, either way [rad].
        astray: the farthest so far from what the inner loop was to track, if it says so [m].
        pointing: the largest angle so far to the attitude that it was to track, if it does [rad].
        height: above the middle of the line, at the closest approach [m].
        apart: distance to that middle then [m].
        closing: speed relative to the goal then [m/s].
        headed: whether the aircraft was within the cone of approach then.
    """

    bank: float = 0.0
    astray: float = 0.0
    pointing: float = 0.0
    height: float = 0.0
    apart: float = math.inf
    closing: float = 0.0
    headed: bool = False

    def seeing(self, flight: Flight, closest: float) -> Facts:
        """Return what is known after a step more; ``closest`` is the least miss before it [m]."""
        loose = [each.facts for each in flight.trail if not each.caught]
        largest = {
            mine: max([getattr(self, mine), *(abs(facts.get(theirs, 0.0)) for facts in loose)])
            for mine, theirs in (('bank', 'bank'), ('astray', 'off'), ('pointing', 'pointing'))
        }
        known = replace(self, **largest)
        if flight.miss >= closest:
            return known
        there = min(flight.trail, key=lambda each: abs(each.time - flight.missed_at))
        return replace(
            known,
            height=there.height,
            apart=math.hypot(flight.miss, there.height),
            closing=_closing(flight, there),
            headed=flight.headed,
        )


def _closing(flight: Flight, vehicle: Vehicle) -> float:
    """Return how fast a vehicle on the last step's trail moves past the goal [m/s]."""
    trail = flight.trail
    place = next(k for k, each in enumerate(trail) if each is vehicle)
    before, after = trail[max(place - 1, 0)], trail[min(place + 1, len(trail) - 1)]
    moved = flight.goal_of(after) - flight.goal_of(before)
    moved = moved / max(after.time - before.time, MOMENT)
    return float(np.linalg.norm(vehicle.velocity - moved))


def _aim(flight: Flight) -> None:
    """Have the engine's own guidance fly to where the goal is now."""
    vehicle = flight.vehicle
    if not isinstance(vehicle, EngineVehicle) or not isinstance(vehicle.engine, Guided):
        raise BadInput('--controllers', WAYPOINT, 'an engine with a guidance of its own')
    vehicle.engine.steer_to(flight.goal)
