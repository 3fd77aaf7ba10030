# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A vehicle in continuous time, in the plane or in space: lags, gain, wind.

Rates and speed (or thrust) follow their commands with first-order lags as soon as a command comes,
which is how airframes, rovers and spacecraft behave, and not what the paper's discrete model says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.sim.plant import Plant
from orbimpc_ros.sim.vehicle import Vehicle


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
    attitude = exp(np.array([heading]) if n == 2 else np.array([0.0, 0.0, heading]))
    velocity = np.zeros(n)
    if plant is not None and not plant.inertial:
        velocity = plant.forward * fraction * attitude[:, 0] + plant.blown
    return Motion(np.zeros(n), velocity, attitude, np.zeros(1 if n == 2 else 3), fraction)


def flown(plant, motion, fraction, rate, time):
    """The motion after a time [s] under one command."""
    n, turns = len(motion.position), plant.turns if math.isfinite(plant.turns) else 0.0
    model = Plant(
        n,
        translation_order=1 + plant.inertial,
        forward=plant.forward,
        speed_lag=plant.speed_lag,
        rate_lag=plant.rate_lag,
        gain=plant.gain,
        disturbance=tuple(np.zeros(n) + plant.blown),
        max_rate=turns,
    )
    begun = motion.position, motion.velocity, motion.attitude, motion.rate, motion.fraction
    end = model.flown(Vehicle(0.0, *begun), time, fraction, rate, 0.0)[-1]
    return Motion(end.position, end.velocity, end.attitude, end.body_rate, end.fraction)
