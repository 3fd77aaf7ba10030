# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner without its node, and its flights with a vehicle in one process."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.loop.goal.motion import GoalObservation
from orbimpc_ros.loop.planner import Decision, Planner
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.outcome import Fallback, Status
from orbimpc_ros.ros.messages import SECOND, Stamp, command_messages
from orbimpc_ros.ros.parameters.planner import PlannerSettings, planner_settings
from orbimpc_ros.ros.planner.core import Core, planner_of
from orbimpc_ros.ros.planner.outputs import report_messages
from orbimpc_ros.ros.topics import resolving
from orbimpc_ros.sim.engines import EngineFailure
from orbimpc_ros.sim.outputs import View, sensed, surroundings
from orbimpc_ros.sim.parameters import SimSettings, sim_settings
from orbimpc_ros.sim.world import Flight, departure
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.files import in_clone

Row = dict[str, Any]
OURS = 'orbitope'  # this package's controller
baselines = partial(in_clone, 'baselines', '--controllers')  # returns the package of the others


class OfflinePlanner(Core):
    """The planner's core with an explicit clock.

    Args:
        settings: of the planner.
        node: its name, with its namespace.
        clock: for deadlines [s]; None to solve without deadlines, so that results do not depend on
            the machine.
        planner: that decides; by default the planner of the package.

    Attributes:
        epoch: stamp of the time 0 of flights in this process [ns].
    """

    epoch = 1_700_000_000 * SECOND  # so that stamps are dates

    def __init__(
        self,
        settings: PlannerSettings,
        node: str = '/planner',
        clock: Callable[[], float] | None = None,
        planner: Planner | None = None,
    ) -> None:
        resolve = resolving(node.rpartition('/')[0])
        super().__init__(settings, planner or planner_of(settings), clock=clock, resolve=resolve)
        self._node = node

    @property
    def stamp(self) -> int | None:
        """Return the stamp of the odometry for the next plan [ns]; None if an input is missing."""
        last = None if self.inputs.missing else self.inputs.odometry
        return None if last is None else last.stamp.nanoseconds

    def messages(self, decision: Decision, stamp: int) -> dict[str, Any]:
        """Return a decision as messages by topic, with the stamp of the odometry [ns]."""
        last = self.inputs.odometry
        at = Stamp(stamp, self.settings.frames if last is None else last.stamp.frames)
        commands = command_messages(self.settings, at, decision.command, oriented=last is not None)
        return dict([*commands, *report_messages(self.settings, at, decision, self._node)])

    # --- on board a flight in this process, at times since its start

    def hear(self, topic: str, message: Any, now: float) -> None:
        """Take in a message at a time [s]."""
        self.inputs.update(topic, message, now, self.at(now).nanoseconds)

    def sense(
        self, now: float, content: Odometry | GoalObservation, measured: float | None = None
    ) -> None:
        """Take in a sensor's measurement, by default measured now [s]."""
        stamp = self.at(now if measured is None else measured)
        self.hear(*sensed(stamp, content), now)

    def report(self, now: float) -> Decision:
        """Plan at a time [s]; return the decision, with its command registered as sent."""
        at = self.at(now).nanoseconds
        decision = self.decide(now, at)
        self.planner.sent(decision.command, at / SECOND)
        return decision

    def at(self, now: float) -> Stamp:
        """Return the stamp of a message at a time [s]."""
        return Stamp(self.epoch + round(now * SECOND), self.settings.frames)


def closed_loop(
    planner: OfflinePlanner, settings: SimSettings
) -> Iterator[tuple[Flight, Decision | None]]:
    """Yield a flight at each step, with the decision then.

    As in a simulator in lock-step, the planner answers new odometry, the last one included. If none
    arrives, or the answer is lost, the last command stays in force until it times out.

    Args:
        planner: of the vehicle.
        settings: of the simulator, with faults between the vehicle and its planner.
    """
    flight, view, faults = departure(settings), View(settings), settings.faults
    answered, came = planner.stamp, -math.inf
    order: tuple[float, Array] = (0.0, np.zeros(settings.model.rates))
    if settings.traffic:
        planner.planner.expect_hazards()
    while True:
        now, decision = flight.vehicle.time, None
        shown = now + faults.jumped(flight.ticks)
        for topic, message in surroundings(planner.at(shown), flight):
            planner.hear(topic, message, shown)
        for seen in view.of(flight):
            planner.sense(shown, seen, seen.time + shown - now)
        if planner.stamp != answered:
            answered, decision = planner.stamp, planner.report(shown)
            if not view.command_lost(flight.ticks):
                order, came = (decision.command.speed_fraction, decision.command.body_rate), now
        yield flight, decision
        if flight.over:
            return
        flight = flight.after(*order, came + settings.command_timeout - now)


# --- flights of a study


def flown(study: str, controller: str, index: int, values: settings.Values) -> Row:
    """Fly and return the row of a flight.

    Args:
        study: its name, by which baselines find their tuned parameters.
        controller: :data:`OURS`, or the name of a baseline.
        index: of the flight.
        values: of all parameters, drawn ones included.

    Returns:
        ``controller`` and ``index``; ``caught``, ``time`` to the catch [s] (None without one),
        ``touched`` (whether it ended in a collision), ``failed`` (error of an engine, if any); the
        numbers of ``ticks``, of ``optimal`` and of ``unplanned`` (fallback) ones; ``p50_ms`` and
        ``longest_ms``, the processor time of a tick; the ``closest`` distance to the goal [m] and
        ``stalls``; of an arrival, the final distance ``missed`` [m] and ``speed`` [m/s]; of a
        vehicle in an engine, its least ``airspeed`` [m/s] and the largest magnitude of each
        quantity that the engine reports, such as its ``bank`` [rad].
    """
    simulated, planning = sim_settings(settings.of_sim(values)), planner_settings(values)
    pilot: Any = None  # this package's planner
    if controller != OURS:
        pilot = baselines().baseline_named(controller, planning, study)
    # Ticks are measured in processor time, because other processes may load the machine.
    planner = OfflinePlanner(planning, clock=time.thread_time, planner=pilot)
    steps, ticks, failed = list[Flight](), list[Decision](), ''
    try:
        for flight, decision in closed_loop(planner, simulated):
            steps.append(flight)
            if flight.over or flight.touched:
                break
            if decision is not None:
                ticks.append(decision)
            if controller != OURS:
                pilot.steer(flight)
    except EngineFailure as error:
        failed = str(error)
    spent = [decision.solve_time_ms for decision in ticks] or [0.0]
    row: Row = {
        'controller': controller,
        'index': index,
        'caught': flight.captured,
        'time': flight.missed_at if flight.captured else None,
        'touched': bool(flight.touched),
        'failed': failed,
        'ticks': len(ticks),
        'optimal': sum(decision.status is Status.OPTIMAL for decision in ticks),
        'unplanned': sum(decision.fallback is not Fallback.NONE for decision in ticks),
        'p50_ms': float(np.median(spent)),
        'longest_ms': max(spent),
        'closest': min(each.miss for each in steps),
        'stalls': flight.stalls,
    }
    if simulated.finish == 'arrival':
        row |= {'missed': flight.distance, 'speed': flight.speed}
    if flight.vehicle.engine is not None:
        row['airspeed'] = flight.least_airspeed
        trail = (vehicle.facts for each in steps for vehicle in each.trail if not vehicle.caught)
        for name, value in chain.from_iterable(facts.items() for facts in trail):
            row[name] = max(row.get(name, 0.0), abs(value))
    return row
