# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Guidance laws: pure pursuit, lead pursuit, proportional navigation, with a sidestep in traffic.

A sidestep is the course closest to the wanted one that stays clear of moving obstacles: velocity
obstacles (Fiorini and Shiller 1998) for a vehicle with a limited turn rate.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import ClassVar

import numpy as np

from benchmarks.baselines.baseline import BEHIND, Baseline, Sight, depths, wrapped
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.sim.world import Flight

LOOKS, FARTHEST = 240, 12.0  # points of the forecast, and its length in horizons
NEAR = 1e-9
ASIDE = math.radians(60.0)  # angle to the line of sight up to which a small-angle law holds
COURSES, POINTS = 72, 24  # of sidesteps: courses, and points on each
SLOWER = (1.0, 0.6, 0.2)  # shares of the wanted speed; losing all of it counts as half a turn


class _Guided(Baseline):
    """A baseline that steers to the heading of a guidance law, or around moving obstacles."""

    TUNABLE: ClassVar[dict[str, float]] = {**BEHIND, 'margin': 0.2, 'look': 8.0}

    def steered(self, sight: Sight) -> tuple[float, float]:
        """Return the speed and the turn of the law, or those of a sidestep."""
        heading, fraction = self.wanted(sight)
        if sight.state.hazards:
            heading, fraction = self._sidestepped(sight, heading, fraction)
        return fraction, wrapped(heading - sight.heading) / self.problem.step

    @abstractmethod
    def wanted(self, sight: Sight) -> tuple[float, float]:
        """Return the heading at the end of the step [rad], and the share of full speed."""

    def _sidestepped(self, sight: Sight, heading: float, fraction: float) -> tuple[float, float]:
        """Return the heading [rad] and the share of full speed of a sidestep.

        It keeps a ``margin`` to moving obstacles, in steps at full speed, and looks ``look`` steps
        ahead. It is the least detour that is clear of all, or else the one of least depth.
        """
        problem = self.problem
        times = problem.step * self.tuned['look'] * np.arange(1, POINTS + 1) / POINTS
        aside = math.pi * (2.0 * np.arange(COURSES) / COURSES - 1.0)
        shares = np.maximum(np.array(SLOWER) * fraction, problem.least_speed)
        each, speeds = (grid.ravel() for grid in np.meshgrid(aside, shares))
        flown = self._flown(sight, heading + each, speeds, times)
        deepest = depths(sight.state.hazards, flown, times).max(axis=1)
        clear = deepest < -self.tuned['margin'] * problem.step * problem.forward
        detour = np.abs(each) / math.pi + (1.0 - speeds / fraction)
        best = int(np.argmin(np.where(clear, detour, np.inf) if clear.any() else deepest))
        return heading + float(each[best]), float(speeds[best])

    def _flown(self, sight: Sight, courses: Array, fractions: Array, times: Array) -> Array:
        """Return paths that turn to courses [rad] at shares of full speed, shape (M, K, 2) [m]."""
        turn = wrapped(courses - sight.heading)
        each = times[1] - times[0]
        most = self.fastest * (times - 0.5 * each)
        headings = sight.heading + np.clip(turn[:, None], -most, most)
        airspeed = self.problem.forward * fractions[:, None, None]
        velocity = airspeed * np.stack([np.cos(headings), np.sin(headings)], axis=-1) + sight.wind
        return np.asarray(sight.state.position + each * np.cumsum(velocity, axis=1))


class PurePursuit(_Guided):
    """Pure pursuit: flies along the line of sight over ground, crabbed into the wind."""

    TUNABLE = _Guided.TUNABLE | {'gain': 1.0, 'fraction': 1.0}

    def wanted(self, sight: Sight) -> tuple[float, float]:
        """Return the heading after a share of the turn to the line of sight, and the speed."""
        away = sight.ahead(np.array([sight.time]))[0] - sight.state.position
        speed = self.tuned['fraction'] * self.problem.forward
        course = crabbed(away, speed, sight.wind)
        turn = self.tuned['gain'] * wrapped(course - sight.heading)
        return sight.heading + turn, self.tuned['fraction']


class Lead(_Guided):
    """Lead pursuit: straight to the earliest point of interception in the wind.

    ``turn`` is the share of the time for the first turn that counts as lost.
    """

    TUNABLE = _Guided.TUNABLE | {'gain': 1.0, 'fraction': 1.0, 'turn': 0.3}

    def wanted(self, sight: Sight) -> tuple[float, float]:
        """Return the heading after a share of the turn to the interception, and the speed."""
        course, fraction = self._meeting(sight)
        return sight.heading + self.tuned['gain'] * wrapped(course - sight.heading), fraction

    def _meeting(self, sight: Sight) -> tuple[float, float]:
        """Return the heading to the interception [rad], and the share of full speed for it."""
        problem, fraction = self.problem, self.tuned['fraction']
        longest = FARTHEST * problem.horizon * problem.step
        times = np.linspace(0.0, longest, LOOKS + 1)[1:]
        away = sight.ahead(sight.time + times) - sight.state.position - np.outer(times, sight.wind)
        distance, angle = np.linalg.norm(away, axis=1), np.arctan2(away[:, 1], away[:, 0])
        turn = np.abs(wrapped(angle - sight.heading))
        left = times - self.tuned['turn'] * turn / self.fastest
        met = distance <= np.maximum(left, 0.0) * fraction * problem.forward
        first = int(np.argmax(met)) if met.any() else LOOKS - 1
        needed = distance[first] / (max(left[first], NEAR) * problem.forward)
        return float(angle[first]), min(fraction, float(needed)) if met.any() else fraction


class Waypoint(Baseline):
    """Full speed; the guidance of an engine steers to the goal's present position."""

    def steered(self, sight: Sight) -> tuple[float, float]:
        """Return full speed, and no turn."""
        return 1.0, 0.0

    def steer(self, flight: Flight) -> None:
        """Have the engine's own guidance fly to the present position of the goal.

        Raises:
            BadInput: the vehicle has no engine with its own guidance.
        """
        steer_to = getattr(flight.vehicle.engine, 'steer_to', None)
        if steer_to is None:
            raise BadInput('--controllers', 'waypoint', 'an engine with its own guidance')
        steer_to(flight.goal)


class Proportional(_Guided):
    """Proportional navigation: turns in proportion to the rate of the line of sight.

    Far off the line of sight it first turns to the line.
    """

    TUNABLE = _Guided.TUNABLE | {'constant': 3.0, 'fraction': 1.0}

    def wanted(self, sight: Sight) -> tuple[float, float]:
        """Return the heading after a step at the rate of the law, and the speed."""
        step = self.problem.step
        now, soon = sight.ahead(sight.time + np.array([0.0, step]))
        away, fraction = now - sight.state.position, self.tuned['fraction']
        off = wrapped(math.atan2(away[1], away[0]) - sight.heading)
        if abs(off) > ASIDE:
            return sight.heading + off, fraction
        axis = sight.state.attitude[:, 0]
        closing = (soon - now) / step - fraction * self.problem.forward * axis - sight.wind
        turned = (away[0] * closing[1] - away[1] * closing[0]) / max(float(away @ away), NEAR)
        most = step * self.fastest  # larger turns would wrap to the other side
        turn = min(max(step * self.tuned['constant'] * turned, -most), most)
        return sight.heading + turn, fraction


def crabbed(way: Array, speed: float, wind: Array) -> float:
    """Return the heading to fly a direction over ground, as far as the wind allows [rad].

    Args:
        way: direction over ground, of any length, shape (2,).
        speed: through the air [m/s].
        wind: shape (2,) [m/s].
    """
    course = math.atan2(way[1], way[0])
    across = -math.sin(course) * wind[0] + math.cos(course) * wind[1]
    return course - math.asin(min(max(across / speed, -1.0), 1.0))
