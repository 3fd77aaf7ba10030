# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Faults between a flight and its planner, from a seed: noise, losses, delays, wrong stamps.

The random draws of a tick depend on the seed and the tick number only, so that runs repeat exactly,
faults do not affect each other's draws, and repeated queries of one tick agree.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from typing import TYPE_CHECKING

import numpy as np

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.loop.goal.motion import GoalObservation
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.ros.parameters.spec import TINY, parameter
from orbimpc_ros.sim.vehicle import Vehicle, between, measured

if TYPE_CHECKING:  # both refer to the faults
    from orbimpc_ros.sim.parameters import SimSettings
    from orbimpc_ros.sim.world import Flight

ODOMETRY, GOAL, COMMAND = range(3)  # rows of a tick's draws
CHANCES = ('dropout', 'reorder', 'duplicate', 'nan')  # columns


@dataclass(frozen=True)
class Faults:
    """Rates and magnitudes of message faults; each field is a parameter of the simulator."""

    # fmt: off
    position_noise: float = parameter('faults.position_noise', 0.0,
        'Standard deviation of noise on odometry and goal along each axis', 'm', 0.0, 1e3)
    attitude_noise: float = parameter('faults.attitude_noise', 0.0,
        'Standard deviation of noise on odometry about each axis', 'rad', 0.0, math.pi)
    dropout: float = parameter('faults.dropout', 0.0,
        'Share of odometry, goals and commands that is lost', '', 0.0, 1.0)
    delay: float = parameter('faults.delay', 0.0, 'Age of odometry on arrival', 's', 0.0, 10.0)
    reorder: float = parameter('faults.reorder', 0.0,
        'Share of odometry and goals that arrives a step late', '', 0.0, 1.0)
    duplicate: float = parameter('faults.duplicate', 0.0,
        'Share of odometry and goals that arrives twice', '', 0.0, 1.0)
    nan: float = parameter('faults.nan', 0.0,
        'Share of odometry and goals whose position is not a number', '', 0.0, 1.0)
    occlusion_length: float = parameter('faults.occlusion_length', 0.0,
        'How long the goal is hidden in each period', 's', 0.0, 1e6)
    occlusion_period: float = parameter('faults.occlusion_period', 10.0,
        'Period in which the goal is hidden once, at a random time', 's', TINY, 1e6)
    clock_jump: float = parameter('faults.clock_jump', 0.0,
        'Offset of every stamp from clock_jump_tick on', 's', -1e6, 1e6)
    clock_jump_tick: int = parameter('faults.clock_jump_tick', 0,
        'Steps flown before the clock jumps', '', 0, 1_000_000)
    # fmt: on

    def __post_init__(self) -> None:
        if not 0.0 <= self.occlusion_length <= self.occlusion_period:
            allowed = f'in [0, occlusion_period = {self.occlusion_period:g}]'
            raise BadInput('faults.occlusion_length', self.occlusion_length, allowed)

    @property
    def any(self) -> bool:
        """Return True if any fault is configured."""
        return self != Faults()

    def jumped(self, ticks: int) -> float:
        """Return the error of stamps after a number of steps [s]."""
        return self.clock_jump if ticks >= self.clock_jump_tick else 0.0


Seen = Odometry | GoalObservation  # a message to the planner, at the true time of measurement


class View:
    """The messages of a flight that reach its planner at each tick."""

    def __init__(self, settings: SimSettings) -> None:
        self.faults, self._seed = settings.faults, settings.seed
        past = 2 + math.ceil(self.faults.delay / settings.model.step)
        self._past: deque[tuple[Vehicle, ...]] = deque(maxlen=past)
        self._held_back: list[Seen] = []

    def of(self, flight: Flight) -> list[Seen]:
        """Return the messages that arrive at this tick, in order. Call it once per tick."""
        self._past.append(flight.trail or (flight.vehicle,))
        arriving, self._held_back = self._held_back, []
        chances, shifts, turn = _draws(self._seed, flight.ticks)
        shifts = self.faults.position_noise * shifts[:, : len(flight.goal)]
        if not self._hidden(flight.vehicle.time):
            goal = GoalObservation(flight.vehicle.time, flight.goal + shifts[GOAL])
            arriving += self._through(chances[GOAL], goal)
        seen = measured(self._delayed(), flight.settings.velocity_source)
        turned = seen.attitude @ exp(self.faults.attitude_noise * turn[: len(seen.body_rate)])
        seen = replace(seen, position=seen.position + shifts[ODOMETRY], attitude=turned)
        return arriving + self._through(chances[ODOMETRY], seen)

    def command_lost(self, ticks: int) -> bool:
        """Return True if the command that answers a tick is lost."""
        return 'dropout' in self._happening(_draws(self._seed, ticks)[0][COMMAND])

    def _delayed(self) -> Vehicle:
        """Return the vehicle as it was ``delay`` ago; before the start, its initial state."""
        past = list(chain.from_iterable(self._past))
        at = past[-1].time - self.faults.delay
        for earlier, later in pairwise(past):
            if earlier.time <= at < later.time:
                return between(earlier, later, at)
        return past[-1] if at >= past[-1].time else replace(past[0], time=at)

    def _through(self, chances: Array, sent: Seen) -> list[Seen]:
        """Return the copies of a message that arrive now: zero, one or two."""
        happening = self._happening(chances)
        if 'dropout' in happening:
            return []
        if 'nan' in happening:
            sent = replace(sent, position=np.full_like(sent.position, np.nan))
        copies = [sent] * (2 if 'duplicate' in happening else 1)
        if 'reorder' in happening:
            self._held_back += copies
            return []
        return copies

    def _happening(self, chances: Array) -> set[str]:
        drawn = zip(CHANCES, chances, strict=True)
        return {fault for fault, chance in drawn if chance < getattr(self.faults, fault)}

    def _hidden(self, time: float) -> bool:
        """Return True if the goal is occluded."""
        length, period = self.faults.occlusion_length, self.faults.occlusion_period
        window, into = divmod(time, period)
        begin = (period - length) * np.random.default_rng((self._seed, 1, int(window))).uniform()
        return length > 0.0 and begin <= into < begin + length


def _draws(seed: int, ticks: int) -> tuple[Array, Array, Array]:
    """Return a tick's draws: uniform, shape (3, 4), and normal, shapes (2, 3) and (3,)."""
    rng = np.random.default_rng((seed, 0, ticks))
    return rng.uniform(size=(3, 4)), rng.normal(size=(2, 3)), rng.normal(size=3)
