# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Crossings in simulated time: planners that hear each other's plans, vehicles that obey them.

A planner is whoever answers odometry: here the planner's own path from messages to messages without
a node; in test/long/crossing.py the nodes as well, each a process of its own. All plan at the same
moments, one after the other, or each at a phase of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from orbimpc_ros.ros import messages
from orbimpc_ros.ros.clock import RosTime
from orbimpc_ros.ros.messages import SECOND, Stamp
from orbimpc_ros.ros.parameters import planner_settings
from orbimpc_ros.sim.commands import Orders
from orbimpc_ros.sim.fleet import separations
from orbimpc_ros.sim.parameters import SimSettings, sim_settings
from orbimpc_ros.sim.vehicle import measured
from orbimpc_ros.sim.world import Flight, departure
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.bags import fields
from orbimpc_ros.tool.demo import fleet
from orbimpc_ros.tool.offline import OfflinePlanner, resolved


class Crew(Protocol):
    """Who answers the odometry of a round, by namespace."""

    def reset(self) -> None:
        """Have every planner forget the crossing before."""

    def answers(self, asked: Mapping[str, tuple[Any, Any]], at: int) -> dict[str, dict[str, Any]]:
        """Return each planner's messages, given its odometry and goal, stamped ``at`` [ns]."""


@dataclass
class Outcome:
    """What came of a crossing.

    Attributes:
        tracks: times [s] and positions [m] of each vehicle.
        distances: of each from its goal at the end [m].
        fallbacks: ticks that were no new plan, by what stood in for it.
        solve_times: of ticks [ms].
        statuses: of ticks.
        reasons: why ticks fell back.
    """

    tracks: list[tuple[np.ndarray, np.ndarray]]
    distances: list[float] = field(default_factory=list)
    fallbacks: list[str] = field(default_factory=list)
    solve_times: list[float] = field(default_factory=list)
    statuses: list[str] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)

    @property
    def apart(self) -> float:
        """The least distance between any two vehicles [m]."""
        return min(separations(dict(enumerate(self.tracks))).values(), default=math.inf)


def setup(count: int, seed: int, changes: Sequence[str] = ()):
    """Return the parameters of a crossing's vehicles, by namespace."""
    values, own = fleet(count, [*changes, f'seed={seed}'], 'crossing')
    return {name: values | each for name, each in own.items()}


class Aboard:
    """Planners without nodes, which answer one after the other.

    Args:
        values: parameters by namespace.
        clock: that deadlines are kept by [s]; None for no deadlines.
        delay: from a plan's odometry to when the others hear of it [s].
    """

    def __init__(
        self,
        values: Mapping[str, settings.Values],
        clock: Callable[[], float] | None = None,
        delay: float = 0.0,
    ) -> None:
        known = {name: planner_settings(each) for name, each in values.items()}
        self.avoided = {name: resolved(each, name) for name, each in known.items()}
        self.planners = {
            name: OfflinePlanner(each, f'{name}/planner', self.avoided[name], clock)
            for name, each in known.items()
        }
        self._delay, self._told = round(delay * SECOND), 1.0 if clock is None else None
        self._under_way: list[tuple[int, str, Any]] = []  # plans: when they are heard [ns], whose

    def reset(self) -> None:
        """Have every planner forget the crossing before."""
        self._under_way.clear()
        for each in self.planners.values():
            each.start_afresh(wind=True)

    def answers(self, asked: Mapping[str, tuple[Any, Any]], at: int) -> dict[str, dict[str, Any]]:
        found, now = {}, RosTime(at)
        for name, (odometry, goal) in asked.items():
            self._deliver(at)
            planner = self.planners[name]
            planner.inputs.update('goal', goal, at / SECOND, now)
            planner.inputs.update('odom', odometry, at / SECOND, now)
            found[name] = planner.plan(at / SECOND, 0.0, self._told)
            planner.went_out(at / SECOND)
            if 'plan' in found[name]:
                self._under_way.append((at + self._delay, f'{name}/plan', found[name]['plan']))
        return found

    def _deliver(self, at: int) -> None:
        """Have all hear the plans that are there by a time [ns]."""
        now = RosTime(at)
        for due, topic, plan in self._under_way:
            for name, hears in self.planners.items():
                if due <= at and topic in self.avoided[name]:
                    hears.inputs.update(topic, plan, at / SECOND, now)
        self._under_way = [each for each in self._under_way if each[0] > at]


def phases(values: Mapping[str, settings.Values], seed: int) -> dict[str, float]:
    """Return when in a step each vehicle plans, at random [s]."""
    rng = np.random.default_rng([seed, len(values)])
    return {name: rng.uniform(0.0, each['step']) for name, each in values.items()}


def fly(
    values: Mapping[str, settings.Values],
    crew: Crew,
    begin: float = 0.0,
    phases: Mapping[str, float] | None = None,
) -> Outcome:
    """Fly a crossing until all have arrived, or their steps are used up.

    Args:
        values: parameters by namespace.
        crew: the planners.
        begin: time at the start [s].
        phases: how long after it each vehicle starts [s]; by default all start together.
    """
    phases = phases or dict.fromkeys(values, 0.0)
    together = [[n for n in values if phases[n] == each] for each in sorted({*phases.values()})]
    sims = {name: sim_settings(settings.of_sim(each)) for name, each in values.items()}
    flights = {n: departure(each.scenario, begin + phases[n]) for n, each in sims.items()}
    flown = {name: [flight] for name, flight in flights.items()}
    outcome = Outcome([])
    for _ in range(next(iter(sims.values())).scenario.max_ticks):
        for names in together:
            at = round(flights[names[0]].vehicle.time * SECOND)
            asked = {name: _shown(flights[name], sims[name], at) for name in names}
            for name, said in crew.answers(asked, at).items():
                flights[name] = _after(flights[name], sims[name], said, at)
                flown[name].append(flights[name])
                _note(outcome, said['tick'])
        if all(map(_is_there, flights.values())):
            break
    for each in flown.values():
        times = np.array([flight.vehicle.time for flight in each])
        outcome.tracks.append((times, np.array([flight.vehicle.position for flight in each])))
        outcome.distances.append(each[-1].distance)
    return outcome


def _is_there(flight: Flight) -> bool:
    return flight.distance <= flight.scenario.arrival_radius


def _shown(flight: Flight, sim: SimSettings, at: int) -> tuple[Any, Any]:
    stamp = Stamp(at, sim.frames)
    odometry = messages.odometry_message(stamp, measured(flight.vehicle))
    return odometry, messages.goal_message(stamp, flight.goal)


def _after(flight: Flight, sim: SimSettings, said: Mapping[str, Any], at: int) -> Flight:
    orders = Orders(sim.scenario.model, sim.frames)
    orders.take_twist(said['cmd_vel'], at)
    assert orders.latest is not None
    return flight.after(orders.latest.fraction, orders.latest.body_rate, math.inf)


def _note(outcome: Outcome, tick: Any) -> None:
    told = fields(tick)
    outcome.fallbacks.append(told['fallback'])
    outcome.solve_times.append(told['solve_time_ms'])
    outcome.statuses.append(told['status'])
    if told['fallback']:
        outcome.reasons.append(told['reason'])
