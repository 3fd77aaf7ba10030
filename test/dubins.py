# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The earliest interception by a Dubins vehicle, in closed form. No code of the package.

A vehicle of constant airspeed v turns no tighter than with a radius r, in a constant wind w; a goal
moves with a constant velocity u. In the air's frame the goal moves with u - w. With a free heading
at the end, the earliest path is one arc and a straight line (CS) or two arcs (CC); with a given one
it has a third part (CSC, CCC). What is left is an equation in one unknown for each of these words.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

LEFT, RIGHT = 1.0, -1.0
NAMES = {LEFT: 'L', RIGHT: 'R'}
POINTS = 2001  # at which an equation is looked at for a change of sign
RIM = 24  # points of the rim of what counts as caught: within 1 % of a radius of its nearest
HALVINGS = 60
TINY = 1e-9


@dataclass(frozen=True)
class Chase:
    """What is flown.

    Attributes:
        position, heading: of the vehicle at the start, shape (2,) [m], through the air [rad].
        airspeed, radius: of the vehicle [m/s], of its tightest turn [m].
        goal, course: of the goal at the start, position and velocity, shape (2,) [m], [m/s].
        wind: shape (2,) [m/s].
    """

    position: np.ndarray
    heading: float
    airspeed: float
    radius: float
    goal: np.ndarray
    course: np.ndarray
    wind: np.ndarray

    @property
    def rate(self) -> float:
        """The fastest turn [rad/s]."""
        return self.airspeed / self.radius

    def goal_at(self, times: np.ndarray) -> np.ndarray:
        """Where the goal is in the air, from where the vehicle starts; shape (M, 2) [m]."""
        drift = self.course - self.wind
        return (self.goal - self.position) + np.multiply.outer(times, drift)

    def centre(self, side: float) -> np.ndarray:
        """The middle of the first arc, shape (2,) [m]."""
        return self.radius * side * np.array([-math.sin(self.heading), math.cos(self.heading)])


def earliest(chase: Chase) -> tuple[float, str]:
    """The time of the earliest interception [s], and its word; inf and '' if there is none."""
    found = [*_straight_ends(chase), *_round_ends(chase)]
    return min(found, default=(math.inf, ''))


def earliest_within(chase: Chase, radius: float) -> float:
    """The earliest time at which the goal is within a radius [m], by points of its rim [s]."""
    angles = np.linspace(0.0, 2.0 * math.pi, RIM, endpoint=False)
    rim = chase.goal + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return min(earliest(replace(chase, goal=each))[0] for each in rim)


def earliest_headed(chase: Chase, heading: float) -> tuple[float, str]:
    """The same with a given heading through the air at the end [rad]."""
    away = float(np.linalg.norm(chase.goal - chase.position))
    closing = chase.airspeed - float(np.linalg.norm(chase.course - chase.wind))
    longest = 8.0 * math.pi / chase.rate + 2.0 * away / closing
    found = []
    for first, last, branch in itertools.product((LEFT, RIGHT), (LEFT, RIGHT), (None, 1.0, -1.0)):
        if branch and first != last:
            continue

        def spare(
            times: np.ndarray,
            first: float = first,
            last: float = last,
            branch: float | None = branch,
        ) -> np.ndarray:
            """By how much a path of the word is shorter than what is flown by then [m]."""
            aside = np.array([-math.sin(heading), math.cos(heading)])
            middle = chase.goal_at(times) + chase.radius * last * aside
            given = chase.radius, first, middle - chase.centre(first), chase.heading, heading
            length = _three_arcs(branch, *given) if branch else _two_arcs(last, *given)
            return chase.airspeed * times - length

        word = NAMES[first] + (NAMES[-first] if branch else 'S') + NAMES[last]
        found += [(time, word) for time in roots(spare, 0.0, longest)]
    return min(found, default=(math.inf, ''))


def _two_arcs(
    last: float, radius: float, first: float, apart: np.ndarray, begin: float, end: float
) -> np.ndarray:
    """The length of two arcs with a straight line in between, nan where there is none [m].

    Args:
        last, first: sides of the arcs.
        radius: of both [m].
        apart: from the middle of the first to that of the last, shape (..., 2) [m].
        begin, end: headings [rad].
    """
    across = radius * (first - last)
    with np.errstate(invalid='ignore'):
        straight = np.sqrt(np.sum(apart**2, axis=-1) - across**2)
    line = np.arctan2(apart[..., 1], apart[..., 0]) + np.arctan2(across, straight)
    turned = np.mod(first * (line - begin), 2.0 * math.pi) + np.mod(
        last * (end - line), 2.0 * math.pi
    )
    return straight + radius * turned


def _three_arcs(
    branch: float, radius: float, side: float, apart: np.ndarray, begin: float, end: float
) -> np.ndarray:
    """The length of three arcs, nan where there are none [m]; ``branch``: which middle circle."""
    with np.errstate(invalid='ignore'):
        aside = np.arccos(np.linalg.norm(apart, axis=-1) / (4.0 * radius))
    towards = np.arctan2(apart[..., 1], apart[..., 0])
    there, back = towards + branch * aside, towards + math.pi - branch * aside
    turned = (
        np.mod(side * (there - begin) + 0.5 * math.pi, 2.0 * math.pi)
        + np.mod(side * (there - back), 2.0 * math.pi)
        + np.mod(side * (end - back) - 0.5 * math.pi, 2.0 * math.pi)
    )
    return radius * turned


def _straight_ends(chase: Chase) -> Iterator[tuple[float, str]]:
    """Interceptions by an arc and a straight line."""
    for side in (LEFT, RIGHT):

        def left_over(turned: np.ndarray, side: float = side) -> tuple[np.ndarray, np.ndarray]:
            """How far the line passes the goal by, and how long it takes to get level with it."""
            heading = chase.heading + side * turned
            along = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
            spot = chase.centre(side) + chase.radius * side * np.stack(
                [along[..., 1], -along[..., 0]], axis=-1
            )
            apart = chase.goal_at(turned / chase.rate) - spot
            closing = chase.airspeed * along - (chase.course - chase.wind)
            crossed = apart[..., 0] * closing[..., 1] - apart[..., 1] * closing[..., 0]
            return crossed, np.sum(apart * closing, axis=-1) / np.sum(closing**2, axis=-1)

        for turned in roots(lambda x, f=left_over: f(x)[0], 0.0, 2.0 * math.pi):
            flown = float(left_over(np.array(turned))[1])
            if flown >= -TINY:
                yield turned / chase.rate + max(0.0, flown), f'{NAMES[side]}S'


def _round_ends(chase: Chase) -> Iterator[tuple[float, str]]:
    """Interceptions by two arcs: the goal is on the second circle when both are flown."""
    longest = 4.0 * math.pi / chase.rate
    for side in (LEFT, RIGHT):
        for branch in (1.0, -1.0):

            def late(times: np.ndarray, side: float = side, branch: float = branch) -> np.ndarray:
                return _lateness(chase, side, branch, times)

            for time in roots(late, 0.0, longest):
                yield time, NAMES[side] + NAMES[-side]


def _lateness(chase: Chase, side: float, branch: float, times: np.ndarray) -> np.ndarray:
    """By what angle two arcs to the goal are too long or too short at times, within half a turn.

    Args:
        chase: what is flown.
        side: of the first arc.
        branch: which of the two second circles through the goal.
        times: shape (M,) or () [s].
    """
    radius = chase.radius
    away = chase.goal_at(times) - chase.centre(side)
    distance = np.linalg.norm(away, axis=-1)
    # A triangle: 2 r to the second middle, r from there to the goal.
    cosine = (distance**2 + 3.0 * radius**2) / np.maximum(4.0 * radius * distance, TINY)
    with np.errstate(invalid='ignore'):
        towards = np.arctan2(away[..., 1], away[..., 0]) + branch * np.arccos(cosine)  # or nan
    middle = 2.0 * radius * np.stack([np.cos(towards), np.sin(towards)], axis=-1)
    begun = chase.heading - side * 0.5 * math.pi  # where on the first circle
    first = np.mod(side * (towards - begun), 2.0 * math.pi)
    out = away - middle
    second = np.mod(-side * (np.arctan2(out[..., 1], out[..., 0]) - towards - math.pi), 2 * math.pi)
    spare = chase.rate * times - first - second
    wrapped = np.mod(spare + math.pi, 2.0 * math.pi) - math.pi
    return np.where(spare > -math.pi, wrapped, math.nan)


def roots(function: Callable[[np.ndarray], np.ndarray], low: float, high: float) -> list[float]:
    """Where a function, smooth but for jumps and gaps, is zero; seen at :data:`POINTS` points."""
    points = np.linspace(low, high, POINTS)
    values = function(points)
    found = [float(points[k]) for k in np.flatnonzero(np.abs(values) < TINY)]
    for k in np.flatnonzero(values[:-1] * values[1:] < 0.0):
        a, b, positive = points[k], points[k + 1], values[k] > 0.0
        for _ in range(HALVINGS):
            middle = 0.5 * (a + b)
            a, b = (middle, b) if (function(np.array(middle)) > 0.0) == positive else (a, middle)
        if abs(function(np.array(0.5 * (a + b)))) < 1e-6:  # else a jump
            found.append(0.5 * (a + b))
    return found
