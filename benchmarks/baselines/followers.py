# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Path followers of today's autopilots for wings, each as in its paper.

- NPFG, PX4's: Stastny and Siegwart, *On Flying Backwards* (arXiv 1908.01381).
- L1, ArduPilot's: Park, Deyst and How, *A New Nonlinear Guidance Logic for Trajectory Tracking*
  (2004), with a length in proportion to the speed over ground.
- A vector field, ROSplane's: Nelson et al., *Vector Field Path Following* (2007), as in Beard and
  McLain, *Small Unmanned Aircraft*, chapters 6 and 10.

All return a rate of turn, which the same inner loop converts to a bank. Vectors are complex
numbers, x + iy.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.baselines.baseline import wrapped
from orbimpc_ros.mpc.arrays import Array

GRAVITY = 9.80665  # [m/s^2]
FARTHEST = 1.05  # [rad] angle between a line and a vector field far from it


class Track(NamedTuple):
    """A path relative to a wing."""

    error: float  # distance from the path, positive to the left of it [m]
    tangent: complex  # unit tangent of the path
    curvature: float  # of the path, positive to the left [1/m]


@dataclass(frozen=True)
class Path:
    """A straight line through the origin, or a circle around it, which is flown to the left."""

    angle: float  # of the line, from east [rad]
    radius: float  # of the circle [m]; 0 for a line

    def seen(self, position: complex) -> Track:
        """Return the path relative to a position [m]."""
        if not self.radius:
            tangent = cmath.rect(1.0, self.angle)
            return Track(cross(tangent, position), tangent, 0.0)
        away = max(abs(position), 1e-9)
        return Track(self.radius - away, 1j * position / away, 1.0 / self.radius)

    def points(self, length: float) -> Array:
        """Return points: one per degree of a circle, or the ends of a line, ``length`` away [m]."""
        if not self.radius:
            ahead = np.array([math.cos(self.angle), math.sin(self.angle)])
            return np.array([-length * ahead, length * ahead])
        angles = np.linspace(0.0, 2.0 * math.pi, 361)
        points = self.radius * np.column_stack([np.cos(angles), np.sin(angles)])
        points[-1] = points[0]
        return points


class Flying(NamedTuple):
    """A follower's inputs: position [m], velocity over ground and through the air, wind [m/s]."""

    position: complex
    over_ground: complex
    through_air: complex
    wind: complex


def npfg(track: Track, wing: Flying, period: float, damping: float = 0.7) -> float:
    """Return the rate of turn of nonlinear path-following guidance [rad/s].

    As the error falls below a bound, the bearing turns from the direction to the path to the
    path's tangent. An airspeed vector realises it if the wind allows; otherwise the airspeed points
    into the wind, with the least drift across.
    """
    airspeed, bound = abs(wing.through_air), max(abs(wing.over_ground), 1.0) * period * damping
    look = 0.5 * math.pi * (1.0 - min(1.0, abs(track.error) / bound)) ** 2
    to_path = -math.copysign(1.0, track.error) * 1j * track.tangent
    bearing = math.cos(look) * to_path + math.sin(look) * track.tangent
    across, along = cross(wing.wind, bearing), dot(wing.wind, bearing)
    left = airspeed**2 - across**2
    if left > 0.0 and along + math.sqrt(left) > 0.0:
        reference = (along + math.sqrt(left)) * bearing - wing.wind
    else:
        strong = abs(wing.wind) ** 2 - airspeed**2
        reference = math.sqrt(max(strong, 0.0)) * bearing - wing.wind
    off = cross(wing.through_air / airspeed, reference / abs(reference))
    if dot(wing.through_air, reference) < 0.0:
        off = math.copysign(1.0, off)
    gain = 4.0 * math.pi * damping / period
    ahead = max(dot(wing.through_air, track.tangent), 1.0)
    ratio = max(0.0, 1.0 + dot(wing.wind, track.tangent) / ahead)
    bent = track.curvature / max(1.0 - track.curvature * track.error, 0.1)
    turning = bent * max(0.0, dot(wing.over_ground, track.tangent)) * ratio
    return gain * off + math.sin(look) ** 2 * turning


def l1(track: Track, wing: Flying, period: float, damping: float = 0.75) -> float:
    """Return the rate of turn towards a point ahead on the path [rad/s].

    Its distance, as in ArduPilot, is ``damping * period / pi`` times the speed over ground.
    """
    ground = max(abs(wing.over_ground), 1.0)
    length = max(damping * period / math.pi * ground, abs(track.error) + 1e-3)
    # The point ahead is where a circle of this radius cuts a line, and approximately an orbit.
    inward = math.asin(max(-1.0, min(1.0, -track.error / length)))
    bent = math.asin(min(1.0, 0.5 * length * track.curvature))
    off = wrapped(cmath.phase(track.tangent) + inward + bent - cmath.phase(wing.over_ground))
    eta = max(-0.5 * math.pi, min(0.5 * math.pi, off))
    return 4.0 * damping**2 * ground**2 / length * math.sin(eta) / abs(wing.through_air)


def field(track: Track, wing: Flying, gain: float) -> float:
    """Return the rate of turn along a vector field, by a course loop with feed-forward [rad/s]."""
    airspeed, course = abs(wing.through_air), cmath.phase(wing.over_ground)
    if track.curvature:
        off = math.atan(80.0 * gain * track.error * track.curvature)
        crab = math.cos(course - cmath.phase(wing.through_air))
        ahead = abs(wing.over_ground) ** 2 * track.curvature / (airspeed * max(crab, 0.3))
    else:
        off, ahead = FARTHEST * 2.0 / math.pi * math.atan(gain * track.error), 0.0
    bank = 0.73 * wrapped(cmath.phase(track.tangent) - off - course)
    return ahead + GRAVITY / airspeed * math.tan(max(-1.2, min(1.2, bank)))


LAWS: dict[str, Callable[[Track, Flying, float], float]] = {'npfg': npfg, 'l1': l1, 'field': field}


def dot(one: complex, other: complex) -> float:
    """Return the inner product of two vectors."""
    return (one.conjugate() * other).real


def cross(one: complex, other: complex) -> float:
    """Return the cross product of two vectors, positive if the other one is to the left."""
    return (one.conjugate() * other).imag
