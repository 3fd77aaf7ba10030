# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Path followers that wings fly today, each as its paper has it, and this package's own.

- NPFG, PX4's: Stastny and Siegwart, *On Flying Backwards* (arXiv 1908.01381).
- L1, ArduPilot's: Park, Deyst and How, *A New Nonlinear Guidance Logic for Trajectory Tracking*
  (2004), with a length in proportion to the speed over ground.
- A vector field, ROSplane's: Nelson et al., *Vector Field Path Following* (2007), as in Beard and
  McLain, *Small Unmanned Aircraft*, chapters 6 and 10.

All return a rate of turn, which the same inner loop makes a bank of.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.baselines.baseline import wrapped
from orbimpc_ros.mpc.arrays import Array

GRAVITY = 9.80665  # [m/s^2]
FARTHEST = 1.05  # [rad] course of a vector field off a line, far from it


class Track(NamedTuple):
    """A path as seen from a wing."""

    error: float  # distance from the path, positive to the left of it [m]
    tangent: Array  # where it leads, shape (2,)
    curvature: float  # positive to the left [1/m]


@dataclass(frozen=True)
class Line:
    """A straight line through the origin, at an angle from east [rad]."""

    angle: float

    def seen(self, position: Array) -> Track:
        """Return the path as seen from a position, shape (2,) [m]."""
        tangent = np.array([math.cos(self.angle), math.sin(self.angle)])
        return Track(cross(tangent, position), tangent, 0.0)

    def points(self, length: float) -> Array:
        """Return its ends, so far from the origin [m]."""
        along = np.array([math.cos(self.angle), math.sin(self.angle)])
        return np.array([-length * along, length * along])


@dataclass(frozen=True)
class Circle:
    """A circle about the origin, flown to the left."""

    radius: float

    def seen(self, position: Array) -> Track:
        """Return the path as seen from a position, shape (2,) [m]."""
        away = float(np.linalg.norm(position))
        x, y = position / max(away, 1e-9)
        return Track(self.radius - away, np.array([-y, x]), 1.0 / self.radius)

    def points(self, _length: float) -> Array:
        """Return points all around it, one for each degree."""
        angles = np.linspace(0.0, 2.0 * math.pi, 361)
        points = self.radius * np.column_stack([np.cos(angles), np.sin(angles)])
        points[-1] = points[0]
        return points


class Flying(NamedTuple):
    """What a follower knows: position and velocity over ground, through the air, and the wind."""

    position: Array
    over_ground: Array
    through_air: Array
    wind: Array


def npfg(track: Track, wing: Flying, period: float, damping: float = 0.7) -> float:
    """Return the rate of turn of nonlinear path-following guidance [rad/s].

    The bearing turns from the shortest way to the path to the path's own, as the error falls below
    a bound. It is made an airspeed vector where the wind allows; elsewhere one that flies into the
    wind, and drifts the least across.
    """
    airspeed, ground = map(np.linalg.norm, (wing.through_air, wing.over_ground))
    bound = max(float(ground), 1.0) * period * damping
    share = min(1.0, abs(track.error) / bound)
    look = 0.5 * math.pi * (1.0 - share) ** 2
    x, y = track.tangent
    to_path = -math.copysign(1.0, track.error) * np.array([-y, x])
    bearing = math.cos(look) * to_path + math.sin(look) * track.tangent
    across, along = cross(wing.wind, bearing), float(wing.wind @ bearing)
    left = airspeed**2 - across**2
    if left > 0.0 and along + math.sqrt(left) > 0.0:
        reference = (along + math.sqrt(left)) * bearing - wing.wind
    else:
        strong = float(wing.wind @ wing.wind) - airspeed**2
        reference = math.sqrt(max(strong, 0.0)) * bearing - wing.wind
    reference = reference / np.linalg.norm(reference)
    off = cross(wing.through_air / airspeed, reference)
    if wing.through_air @ reference < 0.0:
        off = math.copysign(1.0, off)
    gain = 4.0 * math.pi * damping / period
    ahead = max(float(wing.through_air @ track.tangent), 1.0)
    ratio = max(0.0, 1.0 + float(wing.wind @ track.tangent) / ahead)
    bent = track.curvature / max(1.0 - track.curvature * track.error, 0.1)
    turning = bent * max(0.0, float(wing.over_ground @ track.tangent)) * ratio
    return gain * off + math.sin(look) ** 2 * turning


def l1(track: Track, wing: Flying, period: float, damping: float = 0.75) -> float:
    """Return the rate of turn towards a point of the path ahead [rad/s].

    ArduPilot's length is ``damping * period / pi`` times the speed over ground.
    """
    ground = max(float(np.linalg.norm(wing.over_ground)), 1.0)
    length = max(damping * period / math.pi * ground, abs(track.error) + 1e-3)
    # On a line the point ahead is where a circle of this length cuts it; on an orbit nearly so.
    inward = math.asin(max(-1.0, min(1.0, -track.error / length)))
    bent = 0.5 * length * track.curvature
    aim = math.atan2(track.tangent[1], track.tangent[0]) + inward + math.asin(min(1.0, bent))
    course = math.atan2(wing.over_ground[1], wing.over_ground[0])
    eta = max(-0.5 * math.pi, min(0.5 * math.pi, wrapped(aim - course)))
    acceleration = 4.0 * damping**2 * ground**2 / length * math.sin(eta)
    return acceleration / float(np.linalg.norm(wing.through_air))


def field(track: Track, wing: Flying, gain: float) -> float:
    """Return the rate of turn along a vector field, by a course loop with feed-forward [rad/s]."""
    tangent = math.atan2(track.tangent[1], track.tangent[0])
    airspeed = float(np.linalg.norm(wing.through_air))
    if track.curvature:
        radius = 1.0 / track.curvature
        wanted = tangent - math.atan(80.0 * gain * track.error / radius)
        crab = math.cos(angle_of(wing.over_ground) - angle_of(wing.through_air))
        ground = float(wing.over_ground @ wing.over_ground)
        ahead = ground / (radius * airspeed * max(crab, 0.3))
    else:
        wanted = tangent - FARTHEST * 2.0 / math.pi * math.atan(gain * track.error)
        ahead = 0.0
    bank = 0.73 * wrapped(wanted - angle_of(wing.over_ground))
    return ahead + GRAVITY / airspeed * math.tan(max(-1.2, min(1.2, bank)))


def angle_of(vector: Array) -> float:
    """Return the angle of a vector, shape (2,), from east [rad]."""
    return math.atan2(vector[1], vector[0])


def cross(one: Array, other: Array) -> float:
    """Return how far one vector, shape (2,), is turned to the left to the other."""
    return float(one[0] * other[1] - one[1] * other[0])
