# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""One flight of a study: planner and simulated vehicle in one process, a row of results."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from orbimpc_ros.loop.planner import Decision, Planner
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.outcome import Fallback, Status
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.ros.planner.core import planner_of
from orbimpc_ros.sim.engines import EngineFailure, Guided
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.sim.vehicle import Continuous
from orbimpc_ros.sim.world import Airspeeds, Flight, departure
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.offline import aboard, tell

Row = dict[str, Any]
OURS, WAYPOINT = 'orbitope', 'waypoint'  # this package's controller, an engine's own guidance
BASELINES = 'benchmarks.baselines'  # a folder of the repository, which is not installed
_made: dict[str, Planner] = {}  # the last controller, by its settings: making one takes long


@dataclass(frozen=True)
class Job:
    """A flight to be flown.

    Attributes:
        study: its name, by which baselines find what they were tuned to.
        controller: :data:`OURS`, or the name of a baseline.
        index: of the flight.
        values: of all parameters, drawn ones included.
        margin: by how much larger than they are bodies in the traffic are reported [m].
        tuned: numbers of a baseline; by default those found for the study.
    """

    study: str
    controller: str
    index: int
    values: dict[str, Any]
    margin: float = 0.0
    tuned: Mapping[str, float] | None = None


def flown(job: Job) -> Row:
    """Fly and return ``controller``, ``index`` and what came of the flight.

    ``caught``, ``time`` to the catch [s] (None without one), ``touched`` (whether it ended at an
    obstacle), ``failed`` (how an engine has failed, or an empty string); the rows of
    :func:`_of_way` and :func:`_of_ticks`.
    """
    simulated = sim_settings(settings.of_sim(job.values))
    # Other processes may keep the machine busy: ticks are measured in processor time.
    planner = aboard(job.values, time.thread_time, lambda given: _pilot(job, given))
    flight = departure(simulated.scenario, simulated.begin)
    way, ticks, failed = [flight], list[tuple[Decision, float]](), ''
    while not (flight.over or flight.touched or failed):
        tell(planner, flight, simulated.goal_path_steps, job.margin)
        begun = time.thread_time()
        decision = planner.report(flight.vehicle.time).decision
        ticks.append((decision, 1e3 * (time.thread_time() - begun)))
        if job.controller == WAYPOINT:
            _steer(flight)
        try:
            flight = flight.after(decision.command.speed_fraction, decision.command.body_rate)
            way.append(flight)
        except EngineFailure as error:
            failed = str(error)
    caught, begun = flight.captured, flight.scenario.start.time
    return {
        'controller': job.controller,
        'index': job.index,
        'caught': caught,
        'time': flight.missed_at - begun if caught else None,
        'touched': bool(flight.touched),
        'failed': failed,
        **_of_way(way),
        **_of_ticks(ticks),
    }


def _pilot(job: Job, given: PlannerSettings) -> Planner:
    """Return the controller of a flight, reset."""
    if job.controller != OURS:
        made: Planner = baselines().baseline_named(job.controller, given, job.study, job.tuned)
        return made
    key = repr(given)
    if key not in _made:
        _made.clear()
        _made[key] = planner_of(given)[1]
    _made[key].reset()
    return _made[key]


def baselines() -> Any:
    """Return the package of the baselines.

    Raises:
        BadInput: this is no clone of the repository.
    """
    try:
        return import_module(BASELINES)
    except ModuleNotFoundError:
        missing = f'{BASELINES} is missing'
        raise BadInput.stating('--controllers', missing, 'a clone has it') from None


def _steer(flight: Flight) -> None:
    """Have the engine's own guidance fly to where the goal is now."""
    vehicle = flight.vehicle
    if not isinstance(vehicle.engine, Guided):
        raise BadInput('--controllers', WAYPOINT, 'an engine with a guidance of its own')
    vehicle.engine.steer_to(flight.goal)


def _of_way(way: Sequence[Flight]) -> Row:
    """Return how a flight went.

    ``closest`` to the goal [m] and ``stalls``; of an arrival ``missed`` [m] and ``speed`` [m/s] at
    its end; of a vehicle in an engine its least ``airspeed`` [m/s], and the largest magnitudes of
    what the engine reports, such as its ``bank`` [rad].
    """
    last, model = way[-1], way[0].scenario.model
    trail = [vehicle for flight in way for vehicle in flight.trail]
    airspeeds = Airspeeds(model.stall_speed if isinstance(model, Continuous) else 0.0).seeing(trail)
    row = {'closest': min(flight.miss for flight in way), 'stalls': airspeeds.stalls}
    if last.scenario.finish == 'arrival':
        row |= {'missed': last.distance, 'speed': last.speed}
    if last.vehicle.engine is not None:
        facts = [fact for each in trail if not each.caught for fact in each.facts.items()]
        row |= {'airspeed': airspeeds.least}
        row |= {name: max(abs(v) for n, v in facts if n == name) for name in dict(facts)}
    return row


def _of_ticks(ticks: Sequence[tuple[Decision, float]]) -> Row:
    """Return what planning took and proved.

    How many ``ticks``, of which ``optimal`` and ``unplanned`` (by a fallback); the largest ``gap``
    of a plan and ``projection`` loss; ``p50_ms`` and ``longest_ms``, processor time of the ticks.
    """
    plans = [decision.plan for decision, _ in ticks if decision.plan is not None]
    spent = [each for _, each in ticks]
    return {
        'ticks': len(ticks),
        'optimal': sum(decision.status is Status.OPTIMAL for decision, _ in ticks),
        'unplanned': sum(decision.fallback is not Fallback.NONE for decision, _ in ticks),
        'gap': max((plan.gap for plan in plans), default=None),
        'projection': max((_lost(plan) for plan in plans), default=None),
        'p50_ms': float(np.median(spent)),
        'longest_ms': max(spent),
    }


def _lost(plan: Plan) -> float:
    """Return how far a rotation's thrust is from the planned one, as a share of full thrust."""
    pushed = plan.speed_fraction[1] * plan.projected[1][:, 0]
    return float(np.linalg.norm(pushed - plan.rotations[1][:, 0]))
