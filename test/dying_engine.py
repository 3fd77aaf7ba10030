# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A simulator whose engine fails after two seconds of flight, as ``FAILURE`` selects."""

import os
import sys

import numpy as np

from orbimpc_ros.ros.entry import sim
from orbimpc_ros.sim import vehicle as engines
from orbimpc_ros.sim.engines import Engine, EngineFailure, Motion


class Straight(Engine):
    """Flies along x at 45 m/s; subclasses fail after ``lasts`` ticks: two seconds."""

    name, tick, every, lasts = 'broken', 0.01, 100, 200

    def __init__(self, _start):
        self.ticks = 0

    @property
    def time(self):
        return self.ticks * self.tick

    def fly(self, push, rate):
        self.ticks += 1

    def motion(self):
        still, facts = np.zeros(3), {'bank': 0.0, 'turn': 0.0}
        ahead = np.array([1.0, 0.0, 0.0])
        return Motion(
            self.time, 45.0 * self.time * ahead, 45.0 * ahead, np.eye(3), still, still, 45.0, facts
        )


class Poisoned(Straight):
    def motion(self):
        unknown = {'velocity': np.full(3, np.nan)} if self.ticks > self.lasts else {}
        return super().motion()._replace(**unknown)


class Stopping(Straight):
    def fly(self, push, rate):
        if self.ticks == self.lasts:
            raise EngineFailure(f'{self.name}: stopped at t = {self.time:.3f} s')
        super().fly(push, rate)


FAILURES = {kind.__name__: kind for kind in (Poisoned, Stopping)}

if __name__ == '__main__':
    engines.class_of = lambda _name: FAILURES[os.environ['FAILURE']]
    sys.exit(sim())
