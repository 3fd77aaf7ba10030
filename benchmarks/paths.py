# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Lines and orbits in wind and gusts: this planner against today's path followers for wings.

All fly the same airframes with the same inner loops, at the same airspeed and rate, and with the
mean wind known. ``python -m benchmarks.paths --flights 5`` prints a table.
"""

from __future__ import annotations

import argparse
import cmath
import math
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path as File
from types import SimpleNamespace

import numpy as np

from benchmarks.baselines.baseline import wrapped
from benchmarks.baselines.followers import GRAVITY, LAWS, Flying, Path
from orbimpc_ros.loop.compensation import Odometry, WindReport
from orbimpc_ros.loop.goal.motion import Route
from orbimpc_ros.loop.planner import Snapshot
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.ros.parameters.planner import PLANNER, planner_settings
from orbimpc_ros.ros.parameters.spec import completed
from orbimpc_ros.ros.planner.core import planner_of
from orbimpc_ros.sim.engines import Engine, Vehicle, about
from orbimpc_ros.sim.vehicle import class_of
from orbimpc_ros.tool.files import read

WINDS = (0.0, 0.3, 0.6, 0.9, 1.2)  # of the airspeed
PERIOD = 0.2  # [s] between commands
MET, ALONG = 3.0, math.radians(20.0)  # [m], and of course: errors at which a path is met
GUST = 1.0  # [m/s] standard deviation along each axis


KNOWN = read(str(File(__file__).with_suffix('.yaml')))  # that file gives the units
AIRFRAMES = {name: SimpleNamespace(**each) for name, each in KNOWN['airframes'].items()}
Follower = Callable[[float, Flying, float], tuple[float, float]]


class Unmanned(Engine):
    """A wing at 18 m/s as an engine: a second-order roll loop (4 rad/s, 0.7), Dryden gusts."""

    name = 'unmanned'
    tick = 0.01  # [s]

    def __init__(
        self, start: Vehicle, forward: float, gust: float, seed: int, _rest: Array
    ) -> None:
        self._position, self._wind, self._strength = start.position, start.wind, gust
        self._rng, self._forward = np.random.default_rng(seed), forward
        self._heading, self._speed = math.atan2(*start.attitude[1::-1, 0]), forward
        self._time = self._bank = self._rolling = 0.0
        self._gust = gust * self._rng.normal(size=2)

    def fly(self, fraction: float, rate: Array) -> None:
        """Fly for a tick; see :meth:`Engine.fly`."""
        tick, wanted = self.tick, math.atan(float(rate[0]) * self._speed / GRAVITY)
        self._rolling += tick * (16.0 * (wanted - self._bank) - 5.6 * self._rolling)
        self._bank += tick * self._rolling
        self._heading += tick * GRAVITY * math.tan(self._bank) / self._speed
        self._speed += tick * (self._forward * fraction - self._speed)
        fade = math.exp(-tick * self._speed / 200.0)
        noise = self._strength * math.sqrt(1.0 - fade**2)
        self._gust = fade * self._gust + noise * self._rng.normal(size=2)
        self._time += tick
        self._position = self._position + tick * self.state().velocity

    def state(self) -> Vehicle:
        """Return the present state in the plane; gusts act on the ground velocity immediately."""
        attitude, air = about(2, self._heading)[:2, :2], self._wind + self._gust
        velocity = self._speed * attitude[:, 0] + air
        turn = np.array([GRAVITY * math.tan(self._bank) / self._speed])
        known = self._time, self._position, velocity, attitude, turn
        return Vehicle(*known, self._speed / self._forward, air)


def ours(frame: SimpleNamespace, path: Path, max_rate: float) -> Follower:
    """Return this package's planner as a follower."""
    own = {'forward': frame.airspeed, 'max_rate': max_rate} | frame.planner
    settings = planner_settings(completed(PLANNER, KNOWN['planner'] | own))
    planner, route = planner_of(settings), Route(path.points(30_000.0))

    def follow(time: float, wing: Flying, turning: float) -> tuple[float, float]:
        turned = about(2, cmath.phase(wing.through_air))[:2, :2]
        through, rate = turned.T @ vector(wing.through_air), np.array([turning])
        measured = Odometry(time, vector(wing.position), turned, through, rate)
        told = WindReport(time, vector(wing.wind), 0.2)
        decision = planner.step(Snapshot(measured, route, wind=told), time)
        planner.sent(decision.command, time)
        return decision.command.speed_fraction, float(decision.command.body_rate[0])

    return follow


def rival(name: str, frame: SimpleNamespace, path: Path, max_rate: float) -> Follower:
    """Return a follower of :mod:`benchmarks.baselines.followers`."""

    def follow(_time: float, wing: Flying, _turning: float) -> tuple[float, float]:
        turn = LAWS[name](path.seen(wing.position), wing, frame.tuned[name])
        return 1.0, max(-max_rate, min(max_rate, turn))

    return follow


def seen(state: Vehicle, wind: complex) -> Flying:
    """Return the measurements of a vehicle for a follower, with the mean wind."""
    known = state.position, state.velocity, state.velocity - state.wind
    position, over_ground, through_air = (complex(*each) for each in known)
    return Flying(position, over_ground, through_air, wind)


def vector(number: complex) -> Array:
    """Return a complex number as a vector, shape (2,)."""
    return np.array([number.real, number.imag])


def flight(airframe: str, shape: str, wind: float, name: str, seed: int) -> dict[str, float]:
    """Fly, and return results: errors after meeting the path first [m], the time of that [s]."""
    frame, rng = AIRFRAMES[airframe], np.random.default_rng(seed)
    angle, blown, off = rng.uniform(-math.pi, math.pi, size=3)
    aside = rng.uniform(0.5, 1.0) * frame.aside * rng.choice([-1.0, 1.0])
    path = Path(angle, 0.0 if shape == 'line' else frame.radius)
    start = (path.radius + aside) * 1j * cmath.rect(1.0, angle)
    blowing = cmath.rect(wind * frame.airspeed, blown)
    velocity = cmath.rect(frame.airspeed, off) + blowing
    known = vector(start), vector(velocity), about(2, off)[:2, :2], np.zeros(1)
    begun = Vehicle(0.0, *known, 1.0, vector(blowing))
    kind = Unmanned if airframe == 'unmanned' else class_of('cessna')
    engine = kind(begun, frame.airspeed, GUST, seed, np.zeros(2))
    max_rate = GRAVITY * math.tan(math.radians(frame.bank)) / frame.airspeed
    flying = frame, path, max_rate
    follow = ours(*flying) if name == 'ours' else rival(name, *flying)
    time, flown = 0.0, []
    while time < frame.seconds:
        state = engine.state()
        fraction, turn = follow(time, seen(state, blowing), float(state.body_rate[0]))
        for state in engine.run(PERIOD, fraction, np.array([turn])):
            wing = seen(state, blowing)
            track = path.seen(wing.position)
            off = wrapped(cmath.phase(track.tangent) - cmath.phase(wing.over_ground))
            flown.append((time, track.error, off, abs(wing.through_air)))
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
