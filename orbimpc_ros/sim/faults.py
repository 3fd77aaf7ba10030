# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Faults between a flight and its planner, from a seed: noise, losses, delays, wrong stamps.

The random draws of a tick depend on the seed and the tick number only, so that runs repeat exactly,
faults do not affect each other's draws, and repeated queries of one tick agree.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from itertools import chain, pairwise

import numpy as np

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.loop.goal.motion import GoalObservation
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.sim.parameters import SimSettings
from orbimpc_ros.sim.vehicle import Vehicle, between, measured
from orbimpc_ros.sim.world import Flight

ODOMETRY, GOAL, COMMAND = range(3)  # rows of a tick's draws
CHANCES = ('dropout', 'reorder', 'duplicate', 'nan')  # columns
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
