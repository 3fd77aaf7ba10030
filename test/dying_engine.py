# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A simulator whose engine flies on for two seconds, and then fails as ``FAILURE`` says."""

import os
import sys

import numpy as np

from orbimpc_ros.ros.entry import sim
from orbimpc_ros.sim import engine_vehicle as engines
from orbimpc_ros.sim.engines import EngineFailure, Motion


class Straight:
    """Flies along x at 45 m/s, until its time has come."""

    name, tick, lasts = 'broken', 0.01, 2.0

    def __init__(self, _start):
        self.time = 0.0

    def motion(self):
        still, facts = np.zeros(3), {'bank': 0.0, 'turn': 0.0}
        ahead = np.array([1.0, 0.0, 0.0])
        return Motion(
            self.time, 45.0 * self.time * ahead, 45.0 * ahead, np.eye(3), still, still, 45.0, facts
        )

    def run(self, span, _push, _rate):
        if self.time >= self.lasts:
            return self.failing(span)
        self.time += span
        return [self.motion()]

    def failing(self, _span):
        return [self.motion()]  # its clock stands


class Slow(Straight):
    def failing(self, span):
        self.time += 0.5 * span
        return [self.motion()]


class Reset(Straight):
    def failing(self, span):
        self.time = span
        return [self.motion()]


class Poisoned(Straight):
    def failing(self, span):
        self.time += span
        return [self.motion()._replace(velocity=np.full(3, np.nan))]


class Stopping(Straight):
    def failing(self, _span):
        raise EngineFailure(f'{self.name}: stopped at t = {self.time:.3f} s')


FAILURES = {kind.__name__: kind for kind in (Straight, Slow, Reset, Poisoned, Stopping)}

if __name__ == '__main__':
    engines.class_of = lambda _name: FAILURES[os.environ['FAILURE']]
    sys.exit(sim())
