# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Courses of other vehicles: the plans that they publish, and what becomes of who falls silent.

A vehicle flies what it planned last, and then on as between the last two points of that. One that
has not spoken for longer than a timeout may have stopped on its way instead, as vehicles do whose
planner is gone. From then on it is two hazards: one that flies on, and a ball around the way that
it may have stopped on, which grows at half the speed. It is forgotten ``FORGOTTEN`` seconds later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.loop.traffic.track import along, position
from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.problem import Ball, Hazard

FORGOTTEN = 10.0  # [s] after it fell silent, a vehicle is no longer avoided


@dataclass(frozen=True, eq=False)
class Course:
    """A plan of another vehicle.

    Attributes:
        time: when it was made [s].
        times: increasing, shape (K,) [s].
        positions: of the vehicle then, shape (K, n) [m].
    """

    time: float
    times: Array
    positions: Array

    def __post_init__(self) -> None:
        sealed(self.times)
        sealed(self.positions)


@dataclass(frozen=True)
class Distance:
    """How other vehicles are avoided.

    Attributes:
        radius: from the middle of one vehicle to that of the other: the sum of their radii [m].
        timeout: after which a vehicle counts as silent [s].
    """

    radius: float
    timeout: float


class Courses:
    """The latest course of each other vehicle.

    Args:
        names: of the vehicles to hear of.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._latest: dict[str, Course] = {}

    def hear(self, name: str, course: Course) -> None:
        """Take in a course."""
        self._latest[name] = course

    def clear(self) -> None:
        """Forget every course."""
        self._latest.clear()

    def hazards(self, at: float, distance: Distance) -> list[Hazard]:
        """Return the vehicles as hazards from a time [s] on."""
        found = []
        for course in self._latest.values():
            age = at - course.time
            if age > distance.timeout + FORGOTTEN:
                continue
            body = Ball(course.positions[0], distance.radius)
            found.append(along(body, course.times, course.positions, at))
            if age > distance.timeout:
                found.append(
                    Hazard.drifting(_stopped(course, at, distance.radius), 0.0 * body.centre)
                )
        return found

    def troubles(self, at: float, timeout: float) -> list[str]:
        """Return which vehicles are not heard at a time [s], and what that means, in words."""
        return [words for name in self._names if (words := self._trouble(name, at - timeout))]

    def _trouble(self, name: str, due: float) -> str:
        course = self._latest.get(name)
        if course is None:
            return f'nothing heard on {name}: not avoided'
        silent = due - course.time
        if silent > FORGOTTEN:
            return f'{name} is silent: no longer avoided'
        return f'{name} is silent: avoided wherever it may have stopped' if silent > 0.0 else ''


def _stopped(course: Course, at: float, radius: float) -> Ball:
    """Return a ball around all that a vehicle may be at if it has stopped since its last plan."""
    between = (course.times > course.time) & (course.times < at)
    ends = [position(course.times, course.positions, time) for time in (course.time, at)]
    way = np.array([ends[0], *course.positions[between], ends[1]])
    middle = 0.5 * (way.min(axis=0) + way.max(axis=0))
    return Ball(middle, radius + float(np.linalg.norm(way - middle, axis=1).max()))
