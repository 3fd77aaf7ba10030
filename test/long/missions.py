"""Missions of the package's own vehicle in continuous time: the configurations, drawn at random.

A mission is a configuration file, flown in process: the planner's path from messages to commands,
and the simulator's vehicle, each with the parameters that its node would get. What is drawn is told
to the simulator alone: wind, gusts, gain, and where the goal is. Of boxes the planner knows.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from onboard import Planner

from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.ros.parameters import SimSettings, sim_settings
from orbimpc_ros.ros.reports import Report
from orbimpc_ros.tool.io import settings
from orbimpc_ros.tool.io.share import config
from orbimpc_ros.world.airspeed import Airspeeds
from orbimpc_ros.world.flight import Flight, departure, perfect_sensor
from orbimpc_ros.world.plant import Plant

ROUNDING = 1e-6  # relative
Values = dict[str, Any]


def fixed_wing(rng: np.random.Generator) -> Values:
    """A goal 80 m away in any direction, that drifts and swings, in wind of up to 5 m/s."""
    coming, bearing, course = rng.uniform(-math.pi, math.pi, size=3)
    return {
        'wind': (*_towards(coming, rng.uniform(0.0, 5.0)), 0.0),
        'gust': rng.uniform(0.0, 1.0),
        'rope.center': (*_towards(bearing, 80.0), 0.0),
        'rope.velocity': (*_towards(course, rng.uniform(0.0, 2.0)), 0.0),
        'rope.amplitude': (*rng.uniform(0.0, 3.0, size=2).tolist(), 0.0),
        'rope.frequency': rng.uniform(0.02, 0.1),
        'rope.phase': tuple(rng.uniform(0.0, 2.0 * math.pi, size=3).tolist()),
        'seed': int(rng.integers(2**31)),
    }


def spacecraft(rng: np.random.Generator) -> Values:
    """A goal within 2 m of (5, 10, 25), lags of 0.2 and 0.3 s, a gain off by up to 3 %."""
    return {
        'vehicle': 'continuous',
        'response.speed': 0.2,
        'response.rate': 0.3,
        'gain': rng.uniform(0.97, 1.03),
        'rope.center': tuple((np.array([5.0, 10.0, 25.0]) + rng.uniform(-2.0, 2.0, 3)).tolist()),
    }


def multirotor(rng: np.random.Generator) -> Values:
    """Eight boxes on the way to a goal 10 m away, in a wind of up to 2 m/s^2, and gusts."""
    goal = (10.0, *rng.uniform(-2.0, 2.0, size=2).tolist())
    return {
        'wind': _in_space(rng, rng.uniform(0.0, 2.0)),
        'gust': rng.uniform(0.0, 0.3),
        'rope.center': goal,
        'obstacles': _boxes(rng, np.array(goal), 8),
        'seed': int(rng.integers(2**31)),
    }


def _in_space(rng: np.random.Generator, length: float) -> tuple[float, ...]:
    way = rng.normal(size=3)
    return tuple((way * length / np.linalg.norm(way)).tolist())


def _boxes(rng: np.random.Generator, goal: np.ndarray, count: int) -> tuple[float, ...]:
    """Boxes about the way to the goal, a metre and more from either end of it."""
    numbers: list[float] = []
    while len(numbers) < 6 * count:
        middle = rng.uniform(0.15, 0.85) * goal + rng.uniform(-2.5, 2.5, size=3)
        half = rng.uniform(0.2, 0.9, size=3)
        ends = np.array([np.zeros(3), goal])
        if (np.abs(ends - middle) - half).max(axis=1).min() > 1.0:
            numbers += [*(middle - half).tolist(), *(middle + half).tolist()]
    return tuple(numbers)


def larger(numbers: Sequence[float], margin: float) -> tuple[float, ...]:
    """Boxes with so much more on each side [m]: those of the planner."""
    sides = np.array([-margin] * 3 + [margin] * 3)
    return tuple((np.reshape(numbers, (-1, 6)) + sides).ravel().tolist())


MISSIONS: dict[str, Callable[[np.random.Generator], Values]] = {
    'fixed_wing': fixed_wing,
    'spacecraft': spacecraft,
    'multirotor': multirotor,
}
MARGIN = 0.4  # [m] by which boxes are larger for the planner, as in config/multirotor.yaml


def _towards(angle: float, length: float) -> tuple[float, float]:
    return length * math.cos(angle), length * math.sin(angle)


@dataclass
class Tally:
    """What came of a mission, tick by tick.

    Attributes:
        roads: commands by the road that they came.
        unproved: plans that are not proved optimal.
        gaps: of these.
        solved: what ticks took [ms].
        slowest, fastest: least and largest share of full speed or thrust that was commanded.
        turned: largest rate that was commanded [rad/s].
        miss: least distance to the goal [m].
    """

    roads: Counter[str] = field(default_factory=Counter)
    unproved: int = 0
    gaps: list[float] = field(default_factory=list)
    solved: list[float] = field(default_factory=list)
    slowest: float = math.inf
    fastest: float = 0.0
    turned: float = 0.0
    miss: float = math.inf

    def note(self, road: str, report: Report) -> None:
        tick = report.tick
        self.roads[road] += 1
        self.slowest = min(self.slowest, tick.command.speed_fraction)
        self.fastest = max(self.fastest, tick.command.speed_fraction)
        self.turned = max(self.turned, float(np.linalg.norm(tick.command.body_rate)))
        self.solved.append(report.solve_time_ms)
        if tick.plan is not None and tick.status is not Status.OPTIMAL:
            self.unproved += 1
            self.gaps.append(tick.plan.gap)


def row(name: str, seed: int, index: int, changes: Sequence[str] = ()) -> dict[str, Any]:
    """Fly a mission of a name, a seed and an index; ``changes`` are ``name=value``."""
    values = settings.resolve(config(f'{name}.yaml'), changes)
    drawn = MISSIONS[name](np.random.default_rng([seed, index]))
    simulated = sim_settings(settings.of_sim(values) | drawn)
    if 'obstacles' in drawn:
        values = values | {'obstacles': larger(drawn['obstacles'], MARGIN)}
    begun = time.perf_counter()
    flight, airspeeds, tally = flown(Planner(values), simulated)
    solved = np.array(tally.solved)
    return {
        'mission': name,
        'seed': seed,
        'index': index,
        'caught': flight.captured,
        'when': flight.missed_at - flight.scenario.start.time if flight.captured else None,
        'miss': tally.miss if flight.scenario.finish == 'capture' else flight.distance,
        'speed': flight.speed,
        'touched': len(flight.touched),
        'least_airspeed': airspeeds.least,
        'stalls': airspeeds.stalls,
        'turned': tally.turned,
        'broken': broken(values, tally),
        'ticks': flight.ticks,
        'roads': dict(tally.roads),
        'unproved': tally.unproved,
        'gap': float(np.median(tally.gaps)) if tally.gaps else 0.0,
        'p50_ms': float(np.median(solved)),
        'p99_ms': float(np.percentile(solved, 99)),
        'seconds': time.perf_counter() - begun,
        'drawn': drawn,
    }


def flown(planner: Planner, simulated: SimSettings) -> tuple[Flight, Airspeeds, Tally]:
    """Fly until the goal is caught or the ticks run out, as simulator and planner do over DDS."""
    flight, tally = departure(simulated.scenario, simulated.begin), Tally()
    model = flight.scenario.model
    assert isinstance(model, Plant)
    airspeeds = Airspeeds(model.stall_speed).seeing([flight.vehicle])
    while not flight.over:
        now = flight.vehicle.time
        tell(planner, flight, simulated.goal_path_steps)
        road, report = planner.report(now)
        tally.note(road, report)
        flight = flight.after(report.tick.command.speed_fraction, report.tick.command.body_rate)
        airspeeds = airspeeds.seeing(flight.trail)
        tally.miss = min(tally.miss, flight.miss)
    return flight, airspeeds, tally


def tell(planner: Planner, flight: Flight, ahead: int) -> None:
    """Send the planner what it hears of a flight, with ``ahead`` steps of the goal's future."""
    sighting, odometry = perfect_sensor(flight)
    now, step, rope = flight.vehicle.time, flight.scenario.model.step, flight.scenario.rope
    if ahead:
        planner.goals(now, step, [rope.at(flight.elapsed + k * step) for k in range(ahead + 1)])
    planner.goal(now, sighting.position)
    planner.odometry(now, odometry)


def broken(values: Values, tally: Tally) -> list[str]:
    """Which limits of the planner its commands have broken."""
    least = values['floor.fraction'] if values['floor.shape'] != 'none' else 0.0
    found = []
    if tally.slowest < least * (1.0 - ROUNDING):
        found.append('below the floor')
    if tally.fastest > 1.0 + ROUNDING:
        found.append('above full speed')
    if values['max_rate'] and tally.turned > values['max_rate'] * (1.0 + ROUNDING):
        found.append('beyond max_rate')
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
