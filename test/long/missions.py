# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Missions of the package's own vehicle in continuous time, flown in process.

The planner's path from messages to commands flies the simulator's vehicle, each of the two with the
parameters that its node would get.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import jobs
import numpy as np
from jobs import Values

from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.ros.reports import Report
from orbimpc_ros.sim.parameters import SimSettings, sim_settings
from orbimpc_ros.sim.plant import Plant
from orbimpc_ros.sim.world import Airspeeds, Flight, departure
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.offline import OfflinePlanner, aboard, tell

ROUNDING = 1e-6  # relative


@dataclass
class Tally:
    """What came of a mission, tick by tick.

    Attributes:
        roads: commands by the road that they came.
        gaps: of plans that are not proved optimal.
        solved: what ticks took [ms].
        slowest, fastest: least and largest share of full speed or thrust that was commanded.
        turned: largest rate that was commanded [rad/s].
        miss: least distance to the goal [m].
        distances: to the goal, at every tick [m].
    """

    roads: Counter[str] = field(default_factory=Counter)
    gaps: list[float] = field(default_factory=list)
    solved: list[float] = field(default_factory=list)
    slowest: float = math.inf
    fastest: float = 0.0
    turned: float = 0.0
    miss: float = math.inf
    distances: list[float] = field(default_factory=list)

    @property
    def offset(self) -> float:
        """The mean distance to the goal in the second half of the flight [m]."""
        return float(np.mean(self.distances[len(self.distances) // 2 :]))

    def note(self, report: Report) -> None:
        """Note a tick, and the road that its command came."""
        tick = report.decision
        self.sent(tick.command.speed_fraction, tick.command.body_rate)
        self.ticked(tick.fallback or 'plan', report.solve_time_ms)
        if tick.plan is not None and tick.status is not Status.OPTIMAL:
            self.gaps.append(tick.plan.gap)

    def sent(self, fraction: float, body_rate: Sequence[float] | np.ndarray) -> None:
        """Note a command: its share of full speed or thrust, and its body rate [rad/s]."""
        self.slowest = min(self.slowest, fraction)
        self.fastest = max(self.fastest, fraction)
        self.turned = max(self.turned, float(np.linalg.norm(body_rate)))

    def ticked(self, road: str, solved: float) -> None:
        """Note the road that a command came, and what its tick took [ms]."""
        self.roads[road] += 1
        self.solved.append(solved)

    @property
    def record(self) -> dict[str, Any]:
        """What the record of a flight says of its ticks."""
        return {
            'offset': self.offset,
            'turned': self.turned,
            'ticks': sum(self.roads.values()),
            'roads': dict(self.roads),
            'unproved': len(self.gaps),
            'gap': float(np.median(self.gaps)) if self.gaps else 0.0,
            'p50_ms': float(np.median(self.solved)),
            'p99_ms': float(np.percentile(self.solved, 99)),
        }


@dataclass(frozen=True)
class Outcome:
    """What came of a flight as a whole.

    Attributes:
        caught: whether the job was done.
        when: that was, from the start [s]; None if it was not.
        miss: least distance to the goal, or where there is an arrival the last one [m].
        speed: at the end [m/s].
        touched: how many boxes were.
        least_airspeed: of the flight [m/s].
        stalls: how often the airspeed fell below that of a stall.
        seconds: that flying it took.
    """

    caught: bool
    when: float | None
    miss: float
    speed: float
    touched: int
    least_airspeed: float
    stalls: int
    seconds: float


def row(
    name: str, seed: int, index: int, changes: Sequence[str] = (), *, patient: bool = False
) -> dict[str, Any]:
    """Fly a mission of a name, a seed and an index.

    Args:
        name: of the mission.
        seed: with ``index``, of what is drawn.
        index: of the flight.
        changes: ``name=value``, of the configuration.
        patient: whether a solve has no deadline, so that the machine's load hardly counts.
    """
    values, drawn = jobs.drawn(name, seed, index, changes)
    simulated = sim_settings(settings.of_sim(values))
    begun = time.perf_counter()
    flight, airspeeds, tally = flown(
        aboard(values, None if patient else time.perf_counter), simulated
    )
    outcome = Outcome(
        flight.captured,
        flight.missed_at - flight.scenario.start.time if flight.captured else None,
        tally.miss if flight.scenario.finish == 'capture' else flight.distance,
        flight.speed,
        len(flight.touched),
        airspeeds.least,
        airspeeds.stalls,
        time.perf_counter() - begun,
    )
    return {'mission': name, 'seed': seed, 'index': index} | record(values, drawn, outcome, tally)


def record(values: Values, drawn: Values, outcome: Outcome, tally: Tally) -> dict[str, Any]:
    """What is kept of a flight.

    Args:
        values: of the configuration.
        drawn: of these, what was drawn.
        outcome: what came of it.
        tally: of its ticks.
    """
    return {
        **asdict(outcome),
        'broken': broken(values, tally, outcome.stalls),
        **tally.record,
        'drawn': drawn,
    }


def flown(planner: OfflinePlanner, simulated: SimSettings) -> tuple[Flight, Airspeeds, Tally]:
    """Fly until the goal is caught or the ticks run out, as simulator and planner do over DDS."""
    flight, tally = departure(simulated.scenario, simulated.begin), Tally()
    model = flight.scenario.model
    assert isinstance(model, Plant)
    airspeeds = Airspeeds(model.stall_speed).seeing([flight.vehicle])
    while not flight.over:
        now = flight.vehicle.time
        tell(planner, flight, simulated.goal_path_steps)
        report = planner.report(now)
        tally.note(report)
        flight = flight.after(
            report.decision.command.speed_fraction, report.decision.command.body_rate
        )
        airspeeds = airspeeds.seeing(flight.trail)
        tally.miss = min(tally.miss, flight.miss)
        tally.distances.append(flight.distance)
    return flight, airspeeds, tally


def broken(values: Values, tally: Tally, stalls: int) -> list[str]:
    """Which limits of the planner its commands have broken, and whether the vehicle stalled."""
    least = values['floor.fraction'] if values['floor.shape'] != 'none' else 0.0
    found = []
    if tally.slowest < least * (1.0 - ROUNDING):
        found.append('below the floor')
    if tally.fastest > 1.0 + ROUNDING:
        found.append('above full speed')
    if values['max_rate'] and tally.turned > values['max_rate'] * (1.0 + ROUNDING):
        found.append('beyond max_rate')
    if stalls:
        found.append('stalled')
    return found


def table(rows: Sequence[dict[str, Any]]) -> str:
    """What came of the missions, in a few lines."""
    caught = [each for each in rows if each['caught']]
    ticks = sum(each['ticks'] for each in rows)
    roads: Counter[str] = sum((Counter(each['roads']) for each in rows), Counter())
    lines = [
        f'done {len(caught)} of {len(rows)}, '
        f'at t = {np.median([each["when"] for each in caught] or [math.nan]):.1f} s (median)',
        f'miss: median {_percentile(rows, "miss", 50):.3g} m, '
        f'95 % {_percentile(rows, "miss", 95):.3g} m; '
        f'speed left: 95 % {_percentile(rows, "speed", 95):.3g} m/s',
        f'distance in the second half: mean {np.mean([each["offset"] for each in rows]):.3g} m',
        f'least airspeed {min(each["least_airspeed"] for each in rows):.6g} m/s, '
        f'{sum(each["stalls"] for each in rows)} stalls; '
        f'largest rate {max(each["turned"] for each in rows):.6g} rad/s; '
        f'broken limits in {sum(bool(each["broken"]) for each in rows)}; '
        f'boxes touched in {sum(each["touched"] > 0 for each in rows)}',
        f'ticks {ticks}, unproved {sum(each["unproved"] for each in rows)}, '
        f'p50 {_percentile(rows, "p50_ms", 50):.3g} ms, '
        f'p99 {_percentile(rows, "p99_ms", 50):.3g} ms (medians of flights)',
        f'commands: {", ".join(f"{count} {road}" for road, count in roads.most_common())}',
    ]
    return '\n'.join(lines)


def _percentile(rows: Sequence[dict[str, Any]], name: str, share: float) -> float:
    return float(np.percentile([each[name] for each in rows], share))
