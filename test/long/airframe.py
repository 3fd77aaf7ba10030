# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A vehicle of its own in continuous time: what a planner meets outside of its own simulator.

A unicycle in the plane that lags behind its commands, reaches a little more or less speed than is
commanded, drifts with the wind, turns no faster than it can and does not start below a dead band.
It shares no code with the package.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

SUBSTEP = 0.01  # [s]


@dataclass(frozen=True)
class Airframe:
    """What a vehicle is.

    Attributes:
        speed_lag, rate_lag: first-order, of airspeed and of body rate; 0 for none [s].
        gain: airspeed reached, a share of what is commanded.
        wind: carries it over ground, shape (2,) [m/s].
        dead_band: commanded speeds below it do nothing [m/s].
        turns: its own limit of the body rate [rad/s].
    """

    speed_lag: float
    rate_lag: float
    gain: float
    wind: np.ndarray
    dead_band: float
    turns: float


@dataclass(frozen=True)
class Motion:
    """Where a vehicle is: position [m], heading [rad], airspeed [m/s], body rate [rad/s]."""

    x: float
    y: float
    heading: float
    airspeed: float
    rate: float


def flown(frame: Airframe, motion: Motion, speed: float, rate: float, time: float) -> Motion:
    """The motion after a time [s] under one command: speed [m/s] and body rate [rad/s]."""
    wanted = frame.gain * speed if speed >= frame.dead_band else 0.0
    turning = min(frame.turns, max(-frame.turns, rate))
    x, y, heading = motion.x, motion.y, motion.heading
    v, w = motion.airspeed, motion.rate
    steps = max(1, round(time / SUBSTEP))
    dt = time / steps
    for _ in range(steps):
        v = _lagged(v, wanted, frame.speed_lag, dt)
        w = _lagged(w, turning, frame.rate_lag, dt)
        middle = heading + 0.5 * dt * w
        x += dt * (v * math.cos(middle) + frame.wind[0])
        y += dt * (v * math.sin(middle) + frame.wind[1])
        heading += dt * w
    return Motion(x, y, heading, v, w)


def _lagged(value: float, wanted: float, lag: float, dt: float) -> float:
    return wanted if lag == 0.0 else wanted + (value - wanted) * math.exp(-dt / lag)


def over_ground(frame: Airframe, motion: Motion) -> np.ndarray:
    """The velocity over ground in the body's axes, shape (2,): what odometry shows [m/s]."""
    c, s = math.cos(motion.heading), math.sin(motion.heading)
    ahead, aside = frame.wind @ (c, s), frame.wind @ (-s, c)
    return np.array([motion.airspeed + ahead, aside])
