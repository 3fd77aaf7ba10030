# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Flights of a continuous vehicle with a floor and a rate limit: no command ever beyond them.

The planner's own path from messages to commands flies a vehicle that is not the one it believes in,
through wind, with goals and odometry that fail now and then. The law: no command below the floor,
above full speed or beyond ``max_rate``, on any tick, however it came about.

``ORBIMPC_FLIGHTS=200 pytest test/test_ros_missions.py`` flies the first 200 (``make flights``).
"""

import functools
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import continuous
import numpy as np
import pytest
from continuous import Craft, Motion

pytest.importorskip('rclpy', reason='needs ROS 2, or pip install orbimpc_ros[ros]')

from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.tool.offline import OfflinePlanner, aboard

MANY = int(os.environ.get('ORBIMPC_FLIGHTS', '0'))
QUICK = 6  # flights with steps that are few
ROUNDING = 1e-6  # relative
SUBSTEP = 0.02  # [s]
STEPS = {0.05: 0.1, 0.1: 0.2, 0.2: 0.25, 0.5: 0.25, 1.0: 0.2}  # [s], and how often


@dataclass(frozen=True)
class AirFlight:
    """What is flown.

    Attributes:
        parameters: of the planner, by name.
        craft: the vehicle.
        dead_band: commanded speeds below it do nothing [m/s].
        start: its motion.
        goal: where it should go, shape (2,) [m].
        circling: radius and angular speed of the goal about that [m], [rad/s].
        duration: [s].
        faults: by name, the times from which and until which they last [s].
    """

    parameters: dict[str, Any]
    craft: Craft
    dead_band: float
    start: Motion
    goal: np.ndarray
    circling: tuple[float, float]
    duration: float
    faults: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def step(self) -> float:
        return self.parameters['step']

    @property
    def least(self) -> float:
        """The floor [m/s]."""
        return self.parameters['floor.fraction'] * self.parameters['forward']


def beyond(flight: AirFlight, speed: float, rate: float) -> Iterator[str]:
    """Which limits a command breaks."""
    limits = flight.parameters
    if not math.isfinite(speed) or not math.isfinite(rate):
        yield 'not finite'
    if speed < flight.least * (1.0 - ROUNDING):
        yield 'below the floor'
    if speed > limits['forward'] * (1.0 + ROUNDING):
        yield 'above full speed'
    if abs(rate) > limits['max_rate'] * (1.0 + ROUNDING):
        yield 'beyond max_rate'


# --- drawing a flight


def draw(seed: int, index: int) -> AirFlight:
    """A flight from a seed and an index alone; every fourth one has faults."""
    rng = np.random.default_rng([seed, index])
    parameters = _parameters(rng)
    forward, least = parameters['forward'], parameters['forward'] * parameters['floor.fraction']
    duration = float(np.clip(600.0 * parameters['step'], 30.0, 60.0))
    blowing, coming = min(5.0, 0.5 * forward) * rng.uniform(0.0, 1.0), rng.uniform(-np.pi, np.pi)
    craft = Craft(
        forward,
        speed_lag=float(rng.choice([0.0, rng.uniform(0.0, 1.5)])),
        rate_lag=float(rng.choice([0.0, rng.uniform(0.0, 0.5)])),
        gain=rng.uniform(0.85, 1.1),
        blown=blowing * np.array([math.cos(coming), math.sin(coming)]),
    )
    dead_band = least * rng.uniform(0.0, 0.2)
    craft = replace(craft, turns=parameters['max_rate'] * rng.uniform(0.7, 1.5))
    reach = forward * rng.uniform(2.0, 30.0)
    heading, fraction = rng.uniform(-np.pi, np.pi), rng.uniform(0.0, 1.0)
    return AirFlight(
        parameters,
        craft,
        dead_band,
        continuous.at_rest(heading=heading, fraction=fraction, plant=craft),
        goal=reach * rng.normal(size=2),
        circling=(reach * rng.choice([0.0, 0.5]), 0.5 * forward / reach),
        duration=duration,
        faults=_faults(rng, duration) if index % 4 == 3 else {},
    )


def _parameters(rng: np.random.Generator) -> dict[str, Any]:
    step = float(rng.choice(list(STEPS), p=list(STEPS.values())))
    known: dict[str, Any] = {
        'trigger': 'odom',
        'step': step,
        'horizon': int(rng.integers(5, 13)),
        'forward': float(rng.choice([rng.uniform(8.0, 25.0), rng.uniform(1.0, 3.0)])),
        'floor.shape': str(rng.choice(['circle', 'polygon'])),
        'floor.faces': int(rng.choice([4, 6, 8])),
        'max_rate': math.radians(rng.uniform(10.0, 60.0)),
        'deadline': min(0.5 * step, 0.05),
        'goal_prediction': str(rng.choice(['hold', 'velocity', 'harmonic'])),
        'projection': str(rng.choice(['nearest', 'thrust_aligned'])),
    }
    largest = 0.8
    if known['floor.shape'] == 'polygon':
        largest = min(largest, math.cos(math.pi / known['floor.faces']))
    known['floor.fraction'] = rng.uniform(0.3, largest)
    safe = rng.choice(['', 'loiter', 'hold_rate_zero'], p=[0.4, 0.4, 0.2])
    return {**known, 'safe_command': str(safe)} if safe else known


def _faults(rng: np.random.Generator, duration: float) -> dict[str, tuple[float, float]]:
    kinds = ('goal lost', 'odometry lost', 'too fast', 'backwards', 'nonsense')
    faults = {}
    for kind in rng.choice(kinds, size=3, replace=False):
        begin = rng.uniform(0.1, 0.7) * duration
        faults[str(kind)] = (begin, begin + rng.uniform(0.05, 0.3) * duration)
    return faults


# --- flying it


def measurement(motion: Motion) -> Odometry:
    """What is measured of a motion."""
    seen = motion.attitude.T @ motion.velocity
    return Odometry(0.0, motion.position, motion.attitude, seen, motion.rate)


def fly(flight: AirFlight) -> Iterator[tuple[str, list[str]]]:
    """Fly; yield of every command how it came about, and which limits it breaks."""
    planner, motion = aboard(flight.parameters), flight.start
    for k in range(round(flight.duration / flight.step)):
        now = k * flight.step
        tell(planner, flight, now, motion)
        report = planner.report(now)
        command = report.decision.command
        speed = command.speed_fraction * flight.parameters['forward']
        rate = float(command.body_rate[-1])
        yield report.decision.fallback or 'plan', list(beyond(flight, speed, rate))
        fraction = command.speed_fraction if speed >= flight.dead_band else 0.0
        motion = continuous.flown(
            flight.craft, motion, fraction, command.body_rate, flight.step, SUBSTEP
        )


def tell(planner: OfflinePlanner, flight: AirFlight, now: float, motion: Motion) -> None:
    """Send the planner what it hears at a time [s]."""
    present = {kind for kind, (begin, end) in flight.faults.items() if begin <= now < end}
    if now == 0.0 or 'goal lost' not in present:
        planner.goal(now, goal_at(flight, now))
    if now == 0.0 or 'odometry lost' not in present:
        planner.odometry(now, measurement(shown(flight, present, motion)))


def goal_at(flight: AirFlight, now: float) -> np.ndarray:
    radius, speed = flight.circling
    return flight.goal + radius * np.array([math.cos(speed * now), math.sin(speed * now)])


def shown(flight: AirFlight, present: set[str], motion: Motion) -> Motion:
    """What odometry says of a motion while faults are present."""
    ahead = motion.attitude[:, 0]
    if 'too fast' in present:
        faster = 1.5 * flight.parameters['forward'] * ahead
        motion = replace(motion, velocity=motion.velocity + faster)
    if 'backwards' in present:
        back = 2.0 * (motion.velocity @ ahead) * ahead
        motion = replace(motion, velocity=motion.velocity - back)
    if 'nonsense' in present:
        far, turned = np.array([1e5, -1e5]), motion.attitude.T
        motion = Motion(motion.position + far, turned @ far, turned, np.array([50.0]), 0.0)
    return motion


# --- the law


@functools.cache
def quick_indices():
    """The first flights of at most 120 ticks, two of them with faults."""
    short = [i for i in range(100) if draw(1, i).duration / draw(1, i).step <= 120.0]
    faulty = [i for i in short if draw(1, i).faults]
    return [*[i for i in short if i not in faulty][: QUICK - 2], *faulty[:2]]


@pytest.mark.parametrize('k', range(MANY or QUICK))
def test_no_command_is_beyond_the_limits(k):
    flown = list(fly(draw(1, k if MANY else quick_indices()[k])))
    assert [each for each in flown if each[1]] == []
    assert len(flown) >= 60


def test_each_limit_is_judged():
    flight = draw(1, 0)
    full, turning = flight.parameters['forward'], flight.parameters['max_rate']

    def found(speed, rate):
        return list(beyond(flight, speed, rate))

    assert found(flight.least, turning) == found(full, -turning) == []
    assert found(flight.least * (1.0 - 2e-6), 0.0) == ['below the floor']
    assert found(full * (1.0 + 2e-6), 0.0) == ['above full speed']
    assert found(full, -turning * (1.0 + 2e-6)) == ['beyond max_rate']
    assert found(np.nan, 0.0) == found(full, np.inf)[:1] == ['not finite']
