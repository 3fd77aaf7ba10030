# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Lines and orbits in wind and gusts: this planner beside what wings follow paths with today.

All fly the same airframes, through the same inner loops, at the same airspeed and rate, and know
the mean wind. ``python -m benchmarks.paths --flights 5`` prints a table.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.baselines.baseline import wrapped
from benchmarks.baselines.followers import (
    GRAVITY,
    Circle,
    Flying,
    Line,
    angle_of,
    field,
    l1,
    npfg,
)
from orbimpc_ros.loop.goal.motion import Route
from orbimpc_ros.loop.planner import Snapshot
from orbimpc_ros.loop.state import Odometry, WindReport
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.ros.parameters.planner import PLANNER, planner_settings
from orbimpc_ros.ros.parameters.spec import completed
from orbimpc_ros.ros.planner.core import planner_of
from orbimpc_ros.sim.engine_vehicle import class_of
from orbimpc_ros.sim.engines import Engine, Motion, Start, about
from orbimpc_ros.tool.files import read

WINDS = (0.0, 0.3, 0.6, 0.9, 1.2)  # of the airspeed
PERIOD = 0.2  # [s] between commands
MET, ALONG = 3.0, math.radians(20.0)  # [m] from the path, and the course off it: then it is met
GUST = 1.0  # [m/s] standard deviation along each axis


class Airframe(NamedTuple):
    """A wing of the file beside this one, which has the units."""

    airspeed: float
    bank: float
    stall: float
    radius: float
    aside: float
    seconds: float
    tuned: dict[str, float]
    planner: dict[str, Any]

    @property
    def max_rate(self) -> float:
        """Return the rate of a coordinated turn [rad/s]."""
        return GRAVITY * math.tan(math.radians(self.bank)) / self.airspeed


KNOWN = read(str(Path(__file__).with_suffix('.yaml')))
AIRFRAMES = {name: Airframe(**each) for name, each in KNOWN['airframes'].items()}


class Unmanned(Engine):
    """A wing of 18 m/s as an engine: a roll loop of second order (4 rad/s, 0.7), Dryden's gusts."""

    name = 'unmanned'
    tick = 0.01  # [s]

    def __init__(self, start: Start) -> None:
        self._position, self._wind, self._strength = start.position, start.wind, start.gust
        self._rng = np.random.default_rng(start.seed)
        self._heading, self._speed = angle_of(start.attitude[:, 0]), start.push
        self._time = self._bank = self._rolling = 0.0
        self._gust = start.gust * self._rng.normal(size=2)

    def fly(self, push: float, rate: Array) -> None:
        """Fly for a tick; see :meth:`Engine.fly`."""
        tick, wanted = self.tick, math.atan(float(rate[0]) * self._speed / GRAVITY)
        self._rolling += tick * (16.0 * (wanted - self._bank) - 5.6 * self._rolling)
        self._bank += tick * self._rolling
        self._heading += tick * GRAVITY * math.tan(self._bank) / self._speed
        self._speed += tick * (push - self._speed)
        fade = math.exp(-tick * self._speed / 200.0)
        noise = self._strength * math.sqrt(1.0 - fade**2)
        self._gust = fade * self._gust + noise * self._rng.normal(size=2)
        self._time += tick
        self._position = self._position + tick * self.motion().velocity

    def motion(self) -> Motion:
        """Return how it flies now, in the plane; a gust is in the ground's velocity at once."""
        through, turned = self._speed * about(2, self._heading)[:2, 0], np.zeros(3)
        air, turn = self._wind + self._gust, GRAVITY * math.tan(self._bank) / self._speed
        attitude, facts = about(2, self._heading), {'turn': turn}
        return Motion(
            self._time, self._position, through + air, attitude, turned, air, self._speed, facts
        )


LAWS: dict[str, Callable[..., float]] = {'npfg': npfg, 'l1': l1, 'field': field}


def ours(frame: Airframe, path: Line | Circle) -> Callable[..., tuple[float, float]]:
    """Return this package's planner as a follower."""
    own = {'forward': frame.airspeed, 'max_rate': frame.max_rate} | frame.planner
    settings = planner_settings(completed(PLANNER, KNOWN['planner'] | own))
    planner, route = planner_of(settings)[1], Route(path.points(30_000.0))

    def follow(time: float, wing: Flying, turning: float) -> tuple[float, float]:
        turned = about(2, angle_of(wing.through_air))[:2, :2]
        through, rate = turned.T @ wing.through_air, np.array([turning])
        measured = Odometry(time, np.array(wing.position), turned, through, rate)
        told = WindReport(time, np.array(wing.wind), 0.2)
        decision = planner.step(Snapshot(measured, route, wind=told), time)
        planner.sent(decision.command, time)
        return decision.command.speed_fraction, float(decision.command.body_rate[0])

    return follow


def rival(name: str, frame: Airframe, path: Line | Circle) -> Callable[..., tuple[float, float]]:
    """Return a follower of :mod:`benchmarks.baselines.followers`."""

    def follow(_time: float, wing: Flying, _turning: float) -> tuple[float, float]:
        turn = LAWS[name](path.seen(wing.position), wing, frame.tuned[name])
        return 1.0, max(-frame.max_rate, min(frame.max_rate, turn))

    return follow


def seen(motion: Motion, wind: Array) -> Flying:
    """Return what a follower sees of a motion, in the mean wind."""
    through = (motion.velocity - motion.air)[:2]
    return Flying(motion.position[:2], motion.velocity[:2], through, wind)


def flight(airframe: str, shape: str, wind: float, name: str, seed: int) -> dict[str, float]:
    """Fly and return what came of it: errors after the first meeting [m], when that was [s]."""
    frame, rng = AIRFRAMES[airframe], np.random.default_rng(seed)
    angle, blown, off = rng.uniform(-math.pi, math.pi, size=3)
    aside = rng.uniform(0.5, 1.0) * frame.aside * rng.choice([-1.0, 1.0])
    path = Line(angle) if shape == 'line' else Circle(frame.radius)
    normal = np.array([-math.sin(angle), math.cos(angle)])
    start = aside * normal if shape == 'line' else (frame.radius + aside) * normal
    blowing = wind * frame.airspeed * about(2, blown)[:2, 0]
    turned, rest = about(2, off)[:2, :2], np.zeros(2)
    velocity = frame.airspeed * turned[:, 0] + blowing
    known = start, velocity, turned, np.zeros(1), frame.airspeed
    begun = Start(*known, blowing, GUST, seed, rest, rest)
    engine = Unmanned(begun) if airframe == 'unmanned' else class_of('cessna')(begun)
    follow = ours(frame, path) if name == 'ours' else rival(name, frame, path)
    time, flown = 0.0, []
    while time < frame.seconds:
        motion = engine.motion()
        fraction, turn = follow(time, seen(motion, blowing), motion.facts['turn'])
        for motion in engine.run(PERIOD, fraction * frame.airspeed, np.array([turn])):
            wing = seen(motion, blowing)
            track = path.seen(wing.position)
            off = wrapped(angle_of(track.tangent) - angle_of(wing.over_ground))
            flown.append((time, track.error, off, float(np.linalg.norm(wing.through_air))))
        time += PERIOD
    times, errors, offs, airspeeds = np.abs(flown).T
    near = errors <= MET
    met = near & (offs <= ALONG)
    since = errors[np.argmax(met) :] if met.any() else [math.nan]
    return {
        'touched': next(iter(times[near]), math.nan),
        'met': next(iter(times[met]), math.nan),
        'mean': float(np.mean(since)),
        'p95': float(np.percentile(since, 95)),
        'stalls': float(airspeeds.min() < frame.stall),
        'away': errors[-1],
    }


def main() -> int:
    """Print a table: a row for each airframe, path, wind and follower."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--flights', type=int, default=5)
    parser.add_argument('--first', type=int, default=1000, help='seed of the first flight')
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.flights)
    print(
        'airframe path wind follower | met of, touched met [s] | mean p95 [m] | stalls | away [m]'
    )
    for row in product(AIRFRAMES, ('line', 'orbit'), WINDS, ('ours', *LAWS)):
        _show('{} {} {:g} {}'.format(*row), [flight(*row, seed) for seed in seeds])
    return 0


def _show(what: str, rows: list[dict[str, float]]) -> None:
    table = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    met = np.isfinite(table['met'])
    touched, times, mean, p95 = (
        float(np.mean(table[key][met])) if met.any() else math.nan
        for key in ('touched', 'met', 'mean', 'p95')
    )
    away = float(np.mean(table['away']))
    shown = f'{met.sum()}/{len(rows)} {touched:6.1f} {times:6.1f} | {mean:6.2f} {p95:6.2f}'
    print(f'{what:28} | {shown} | {int(table["stalls"].sum())} | {away:7.1f}', flush=True)


if __name__ == '__main__':
    sys.exit(main())
