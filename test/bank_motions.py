# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Goals of every family that the bank of goal models has, sightings of them, and oracles.

An oracle is the one family that a goal belongs to, fitted by nonlinear least squares to the same
sightings and started from the truth: the best that a forecast from them can be expected to do.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from orbimpc_ros.loop.goal.bank import Bank
from orbimpc_ros.loop.goal.motion import GoalObservation
from orbimpc_ros.mpc.geometry.rotations import exp

FAMILIES = ('still', 'velocity', 'swing', 'carrier', 'turn', 'damped')
START = 1000.0  # [s] the first sighting
AHEAD = 3.0  # [s]


@dataclass(frozen=True)
class Motion:
    """A goal's motion, ``at(parameters, times)``, with its true parameters."""

    family: str
    parameters: np.ndarray
    at: object

    def __call__(self, times):
        return self.at(self.parameters, np.asarray(times) - START)

    def fitted(self, times, seen, ahead):
        """The oracle's forecast at ``ahead``."""

        def residuals(parameters):
            return (self.at(parameters, times - START) - seen).ravel()

        found = least_squares(residuals, self.parameters, x_scale='jac', method='lm')
        return self.at(found.x, np.asarray(ahead) - START)


def drawn(family, n, rng):
    """A goal of 0.05 to 0.4 Hz and 0.3 to 1.5 m, 0.3 to 3 m/s, turns of 0.1 to 0.6 rad/s."""
    centre, velocity = 5.0 * rng.normal(size=n), rng.uniform(0.3, 2.5) * _direction(rng, n)
    rate = 2.0 * np.pi * np.exp(rng.uniform(np.log(0.05), np.log(0.4)))
    size, phase = rng.uniform(0.3, 1.5, size=n), rng.uniform(0.0, 2.0 * np.pi, size=n)
    swing = np.r_[size * np.cos(phase), size * np.sin(phase), rate]
    if family == 'still':
        return Motion(family, centre, lambda p, t: np.tile(p, (len(t), 1)))
    if family == 'velocity':
        return Motion(family, np.r_[centre, velocity], lambda p, t: p[:n] + np.outer(t, p[n:]))
    if family == 'swing':
        return Motion(family, np.r_[centre, swing], lambda p, t: p[:n] + _swung(p[n:], t))
    if family == 'carrier':

        def carried(p, t):
            return p[:n] + np.outer(t, p[n : 2 * n]) + _swung(p[2 * n :], t)

        return Motion(family, np.r_[centre, velocity, swing], carried)
    if family == 'damped':
        swing[:-1] *= 2.0
        damping = 1.0 / np.exp(rng.uniform(np.log(5.0), np.log(20.0)))

        def fading(p, t):
            return p[:n] + np.exp(-p[-1] * t)[:, None] * _swung(p[n:-1], t)

        return Motion(family, np.r_[centre, swing, damping], fading)
    rate, speed = rng.uniform(0.1, 0.6) * rng.choice([-1.0, 1.0]), rng.uniform(0.5, 3.0)
    attitude = rng.uniform(-np.pi, np.pi, size=n * (n - 1) // 2)

    def turning(p, t):
        frame, angle = exp(p[n:-2]), p[-1] * t
        rim = np.outer(np.cos(angle), frame[:, 0]) + np.outer(np.sin(angle), frame[:, 1])
        return p[:n] + p[-2] * rim

    return Motion('turn', np.r_[centre, attitude, speed / abs(rate), rate], turning)


def _direction(rng, n):
    direction = rng.normal(size=n)
    return direction / np.linalg.norm(direction)


def _swung(p, t):
    a, b = p[:-1].reshape(2, -1)
    return np.outer(np.cos(p[-1] * t), a) + np.outer(np.sin(p[-1] * t), b)


def sighted(motion, rng, *, seconds=20.0, noise=0.0):
    """Sightings at 5 to 20 Hz with jitter, a seventh of them lost: times, and positions."""
    spacing = 1.0 / rng.uniform(5.0, 20.0)
    times = START + np.arange(0.0, seconds, spacing)
    times = times + 0.2 * spacing * rng.uniform(-1.0, 1.0, size=len(times))
    times = times[rng.uniform(size=len(times)) > 0.15]
    seen = motion(times)
    return times, seen + noise * rng.normal(size=seen.shape)


def shown(times, seen, bank=None):
    """A bank that was shown sightings."""
    bank = bank or Bank()
    for time, position in zip(times, seen, strict=True):
        bank.observe(GoalObservation(float(time), position.copy()))
    return bank
