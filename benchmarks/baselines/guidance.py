# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Guidance laws: towards the goal, to where it can be met, by the turn of the line of sight."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from benchmarks.baselines.baseline import (
    BEHIND,
    TRAFFIC,
    Baseline,
    Range,
    Sight,
    wrapped,
)
from benchmarks.baselines.sidestep import sidestepped
from orbimpc_ros.mpc.arrays import Array

LOOKS, FARTHEST = 240, 12.0  # points of the forecast, as far as so many horizons
NEAR = 1e-9
ASIDE = math.radians(60.0)  # off the line of sight by more, a law for small angles says nothing


class _Guided(Baseline):
    """Steers to where a law wants to point, or aside of what is in the way there."""

    SPACE: ClassVar[Mapping[str, Range]] = {
        **BEHIND,
        'margin': Range(0.2, 0.02, 1.0, TRAFFIC),
        'look': Range(8.0, 3.0, 20.0, TRAFFIC),
    }

    def steered(self, sight: Sight) -> tuple[float, float]:
        """Return the speed and the turn that the law wants, or those of a sidestep."""
        heading, fraction = self.wanted(sight)
        keep = self.tuned['margin'], self.tuned['look']
        heading, fraction = sidestepped(sight, self.problem, (heading, fraction), *keep)
        return fraction, self.turning(heading - sight.heading)

    @abstractmethod
    def wanted(self, sight: Sight) -> tuple[float, float]:
        """Return where to point at the end of the step [rad], and the share of full speed."""


class PurePursuit(_Guided):
    """Pure pursuit: flies over ground along the line of sight, into the wind as it takes."""

    SPACE: ClassVar[Mapping[str, Range]] = {
        **_Guided.SPACE,
        'gain': Range(1.0, 0.2, 1.5),
        'fraction': Range(1.0, 0.5, 1.0),
    }

    def wanted(self, sight: Sight) -> tuple[float, float]:
        """Return a part of the turn to the line of sight, and full speed."""
        away = sight.ahead(np.array([sight.time]))[0] - sight.state.position
        speed = self.tuned['fraction'] * self.problem.forward
        course = crabbed(away, speed, sight.wind)
        turn = self.tuned['gain'] * wrapped(course - sight.heading)
        return sight.heading + turn, self.tuned['fraction']


class Lead(_Guided):
    """Lead pursuit: straight to the earliest point at which it can meet the goal in the wind.

    ``turn`` is the share of the time for the first turn that is taken off the flight.
    """

    SPACE: ClassVar[Mapping[str, Range]] = {
        **_Guided.SPACE,
        'gain': Range(1.0, 0.2, 1.5),
        'fraction': Range(1.0, 0.5, 1.0),
        'turn': Range(0.3, 0.05, 1.0),
    }

    def wanted(self, sight: Sight) -> tuple[float, float]:
        """Return a part of the turn to the point of meeting, and the speed."""
        course, fraction = self._meeting(sight)
        return sight.heading + self.tuned['gain'] * wrapped(course - sight.heading), fraction

    def _meeting(self, sight: Sight) -> tuple[float, float]:
        """Return where to point [rad], and the share of full speed that gets there in time."""
        problem, fraction = self.problem, self.tuned['fraction']
        longest = FARTHEST * problem.horizon * problem.step
        times = np.linspace(0.0, longest, LOOKS + 1)[1:]
        away = sight.ahead(sight.time + times) - sight.state.position - np.outer(times, sight.wind)
        distance, angle = np.linalg.norm(away, axis=1), np.arctan2(away[:, 1], away[:, 0])
        turn = np.abs((angle - sight.heading + np.pi) % (2.0 * np.pi) - np.pi)
        left = times - self.tuned['turn'] * turn / self.fastest
        met = distance <= np.maximum(left, 0.0) * fraction * problem.forward
        first = int(np.argmax(met)) if met.any() else LOOKS - 1
        needed = distance[first] / (max(left[first], NEAR) * problem.forward)
        return float(angle[first]), min(fraction, float(needed)) if met.any() else fraction


class Waypoint(Baseline):
    """Leaves turns to the guidance of an engine, which flies to where the goal is; full speed."""

    def steered(self, sight: Sight) -> tuple[float, float]:
        """Return full speed, and no turn."""
        return 1.0, 0.0


class Proportional(_Guided):
    """Proportional navigation: turns in proportion to how the line of sight turns.

    Far off the line of sight it turns to it first.
    """

    SPACE: ClassVar[Mapping[str, Range]] = {
        **_Guided.SPACE,
        'constant': Range(3.0, 1.0, 8.0),
        'fraction': Range(1.0, 0.5, 1.0),
    }

    def wanted(self, sight: Sight) -> tuple[float, float]:
        """Return what the rate of the law makes of a step, and full speed."""
        step = self.problem.step
        now, soon = sight.ahead(sight.time + np.array([0.0, step]))
        away, fraction = now - sight.state.position, self.tuned['fraction']
        off = wrapped(math.atan2(away[1], away[0]) - sight.heading)
        if abs(off) > ASIDE:
            return sight.heading + off, fraction
        axis = sight.state.attitude[:, 0]
        closing = (soon - now) / step - fraction * self.problem.forward * axis - sight.wind
        turned = (away[0] * closing[1] - away[1] * closing[0]) / max(float(away @ away), NEAR)
        most = step * self.fastest  # so that no rate turns the other way about
        return sight.heading + min(
            max(step * self.tuned['constant'] * turned, -most), most
        ), fraction


def crabbed(way: Array, speed: float, wind: Array) -> float:
    """Return where to point so as to fly a way over ground, shape (2,), as far as wind lets [rad].

    Args:
        way: in any length.
        speed: through the air [m/s].
        wind: shape (2,) [m/s].
    """
    course = math.atan2(way[1], way[0])
    across = -math.sin(course) * wind[0] + math.cos(course) * wind[1]
    return course - math.asin(min(max(across / speed, -1.0), 1.0))
