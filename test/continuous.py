# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A vehicle in continuous time, in the plane or in space: lags, gain, wind. No code of the package.

Rates and speed (or thrust) follow their commands with first-order lags as soon as a command comes,
which is how airframes, rovers and spacecraft behave, and not what the paper's discrete model says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

SUBSTEP = 0.01  # [s]


@dataclass(frozen=True)
class Craft:
    """What a vehicle is.

    Attributes:
        forward: full speed [m/s], or with inertia full thrust acceleration [m/s^2].
        inertial: whether the axis pushes instead of moves.
        speed_lag, rate_lag: first-order; 0 for none [s].
        gain: of speed or thrust, a share of what is commanded.
        blown: wind [m/s], or with inertia an acceleration [m/s^2]; shape (n,) or 0.
        turns: its own limit of the body rate [rad/s].
    """

    forward: float = 1.0
    inertial: bool = False
    speed_lag: float = 0.0
    rate_lag: float = 0.0
    gain: float = 1.0
    blown: np.ndarray | float = 0.0
    turns: float = math.inf


@dataclass(frozen=True)
class Motion:
    """Where a vehicle is: position, velocity over ground, attitude, body rate, share of speed."""

    position: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray
    rate: np.ndarray
    fraction: float


def at_rest(n=2, heading=0.0, fraction=0.0, plant=None):
    """A motion at the origin in the plane or in space, turned about z by a heading [rad]."""
    attitude = turned(np.array([heading]) if n == 2 else np.array([0.0, 0.0, heading]))
    velocity = np.zeros(n)
    if plant is not None and not plant.inertial:
        velocity = plant.forward * fraction * attitude[:, 0] + plant.blown
    return Motion(np.zeros(n), velocity, attitude, np.zeros(1 if n == 2 else 3), fraction)


def flown(plant, motion, fraction, rate, time, substep=SUBSTEP):
    """The motion after a time [s] under one command."""
    size = float(np.linalg.norm(rate))
    wanted = np.asarray(rate) * min(1.0, plant.turns / size) if size else np.asarray(rate)
    steps = max(1, round(time / substep))
    dt = time / steps
    s, p, q, w, f = motion.position, motion.velocity, motion.attitude, motion.rate, motion.fraction
    keep = [math.exp(-dt / lag) if lag else 0.0 for lag in (plant.rate_lag, plant.speed_lag)]
    half = [math.exp(-0.5 * dt / lag) if lag else 0.0 for lag in (plant.rate_lag, plant.speed_lag)]
    for _ in range(steps):
        # Rate, share of speed and direction are taken in the middle of each short step.
        turning, pushing = wanted + half[0] * (w - wanted), fraction + half[1] * (f - fraction)
        axis = (q @ turned(0.5 * dt * turning))[:, 0]
        push = plant.gain * plant.forward * pushing * axis + plant.blown
        if plant.inertial:
            s, p = s + dt * p + 0.5 * dt * dt * push, p + dt * push
        else:
            s = s + dt * push
        q = q @ turned(dt * turning)
        w, f = wanted + keep[0] * (w - wanted), fraction + keep[1] * (f - fraction)
    if not plant.inertial:
        p = plant.gain * plant.forward * f * q[:, 0] + plant.blown
    return Motion(s, p, q, w, f)


def turned(angle):
    """The rotation by a vector [rad], after Rodrigues."""
    if len(angle) == 1:
        c, s = math.cos(angle[0]), math.sin(angle[0])
        return np.array([[c, -s], [s, c]])
    x, y, z = angle
    cross, size = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]), math.sqrt(angle @ angle)
    if size < 1e-9:
        return np.eye(3) + cross
    return (
        np.eye(3) + math.sin(size) / size * cross + (1.0 - math.cos(size)) / size**2 * cross @ cross
    )
