# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Sampling: model predictive path integral control, with the settings of Nav2's MPPI controller.

2,000 sequences of commands about the last one, each rolled out by the planner's own model; the new
sequence is their mean, weighed by :math:`\exp(-(S_i - \min S)/\lambda)`, with a cost of
:math:`\gamma` on the noise. A sequence costs its mean distance to the goal, in steps at full speed,
and the steps before it comes within the radius of a catch, headed into the cone of approach where
there is one; in traffic, as many steps as ``touch`` says for each half of one within the margin.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from benchmarks.baselines.baseline import TRAFFIC, Baseline, Range, Sight, depths
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.ros.parameters.planner import PlannerSettings

SAMPLES = 2000
SEED = 0
TINY = 1e-9  # the spread of what has no range: at constant speed


class Sampling(Baseline):
    """Improves its last sequence by weighed samples, once a tick."""

    SPACE: ClassVar[Mapping[str, Range]] = {
        'temperature': Range(0.3, 0.003, 1.0),
        'gamma': Range(0.015, 0.001, 0.1),
        'deviation': Range(0.2, 0.1, 0.6),
        'catch': Range(1.0, 0.1, 10.0),
        'touch': Range(100.0, 10.0, 1000.0, TRAFFIC),
        'margin': Range(0.2, 0.02, 1.0, TRAFFIC),
    }

    def __init__(self, settings: PlannerSettings, tuned: Mapping[str, float]) -> None:
        super().__init__(settings, tuned)
        least = self.problem.floor.clearance(2)
        self._low, self._high = np.array([least, -self.fastest]), np.array([1.0, self.fastest])
        self._spread = self.tuned['deviation'] * (self._high - self._low)
        self._weights = 1.0 / np.maximum(self._spread, TINY) ** 2
        self._rng = np.random.default_rng(SEED)
        self._mean = np.tile([1.0, 0.0], (self.problem.horizon, 1))

    def steered(self, sight: Sight) -> tuple[float, float]:
        """Return the first command of the sequence that the samples make."""
        mean = np.concatenate([self._mean[1:], self._mean[-1:]])
        noise = self._spread * self._rng.standard_normal((SAMPLES, *mean.shape))
        noise[0] = 0.0
        tried = np.clip(mean + noise, self._low, self._high)
        pull = ((tried - mean) * mean * self._weights).sum(axis=(1, 2))
        costs = self._costs(sight, tried) + self.tuned['gamma'] * pull
        shares = np.exp(-(costs - costs.min()) / self.tuned['temperature'])
        self._mean = np.einsum('i,ikj->kj', shares / shares.sum(), tried)
        fraction, rate = self._mean[0]
        return float(fraction), float(rate)

    def _costs(self, sight: Sight, tried: Array) -> Array:
        """Return what sequences of speed and rate cost, shape (SAMPLES, N, 2) as (SAMPLES,)."""
        step, forward = self.problem.step, self.problem.forward
        turned = step * np.cumsum(tried[..., 1], axis=1)
        heading = sight.heading + turned - 0.5 * step * tried[..., 1]  # in the middle of the step
        moved = tried[..., 0, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        path = sight.state.position + np.cumsum(step * (forward * moved + sight.wind), axis=1)
        begin = sight.ahead(np.array([sight.time])) - sight.state.position
        apart = np.concatenate(
            [np.broadcast_to(begin, (len(tried), 1, 2)), sight.goals - path], axis=1
        )
        distance = np.linalg.norm(apart[:, 1:], axis=2).mean(axis=1) / (forward * step)
        missed = _nearest(apart) > self.radius
        if self.cone.exists:
            off = heading - math.atan2(*self.cone.axis(sight.state)[::-1])
            missed |= np.cos(off) < math.cos(self.cone.cone)
        never = np.logical_and.accumulate(missed, axis=1).sum(axis=1)
        return np.asarray(distance + self.tuned['catch'] * never + self._touches(sight, path))

    def _touches(self, sight: Sight, path: Array) -> Array | float:
        """Return what paths, shape (SAMPLES, N, 2), cost for what they touch, shape (SAMPLES,)."""
        if not sight.hazards:
            return 0.0
        place, step = sight.state.position, self.problem.step
        before = np.concatenate([np.broadcast_to(place, (len(path), 1, 2)), path[:, :-1]], axis=1)
        halves = np.concatenate([0.5 * (before + path), path], axis=1)
        ends = step * np.arange(1, path.shape[1] + 1)
        inside = depths(sight.hazards, halves, np.concatenate([ends - 0.5 * step, ends]))
        near = inside > -self.tuned['margin'] * step * self.problem.forward
        return np.asarray(self.tuned['touch'] * near.sum(axis=1))


def _nearest(apart: Array) -> Array:
    """Return the least distance in each step of offsets, (M, N + 1, 2), as (M, N) [m]."""
    begin, drift = apart[:, :-1], np.diff(apart, axis=1)
    squared = np.maximum((drift**2).sum(axis=2), 1e-12)
    share = np.clip(-(begin * drift).sum(axis=2) / squared, 0.0, 1.0)
    return np.asarray(np.linalg.norm(begin + share[..., None] * drift, axis=2))
