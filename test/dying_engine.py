# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A simulator whose engine fails after two seconds of flight, as ``FAILURE`` selects."""

import os
import sys
from dataclasses import replace

import numpy as np

from orbimpc_ros.ros.entry import sim
from orbimpc_ros.sim import vehicle as engines
from orbimpc_ros.sim.engines import Engine, EngineFailure, Vehicle


class Straight(Engine):
    """Flies along x at 45 m/s; subclasses fail after ``lasts`` ticks: two seconds."""

    name, tick, every, lasts = 'broken', 0.01, 100, 200

    def __init__(self, *_start):
        self.ticks = 0

    @property
    def time(self):
        return self.ticks * self.tick

    def fly(self, fraction, rate):
        self.ticks += 1

    def state(self):
        still, ahead = np.zeros(3), np.array([45.0, 0.0, 0.0])
        known = self.time, self.time * ahead, ahead, np.eye(3), still, 0.9, still
        return Vehicle(*known, facts={'bank': 0.0, 'turn': 0.0}).level()


class Poisoned(Straight):
    def state(self):
        unknown = {'velocity': np.full(2, np.nan)} if self.ticks > self.lasts else {}
        return replace(super().state(), **unknown)


class Stopping(Straight):
    def fly(self, fraction, rate):
        if self.ticks == self.lasts:
            raise EngineFailure(f'{self.name}: stopped at t = {self.time:.3f} s')
        super().fly(fraction, rate)


FAILURES = {kind.__name__: kind for kind in (Poisoned, Stopping)}

if __name__ == '__main__':
    engines.class_of = lambda _name: FAILURES[os.environ['FAILURE']]
    sys.exit(sim())
