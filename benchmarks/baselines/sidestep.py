# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Sidestepping: the course nearest to the wanted one that stays clear of what moves.

Courses all around, at three speeds, are flown ahead as the vehicle can turn; of those that stay
clear for long enough the one is taken that is the least away from what is wanted, or else the one
that stays clear the most. These are velocity obstacles (Fiorini and Shiller 1998) for who turns
at a limited rate.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.baselines.baseline import Sight, depths
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem

COURSES, POINTS = 72, 24
SLOWER = (1.0, 0.6, 0.2)  # times the wanted speed; each of it lost counts as half a turn


def sidestepped(
    sight: Sight, problem: Problem, wanted: tuple[float, float], margin: float, steps: float
) -> tuple[float, float]:
    """Return the heading [rad] and the share of full speed to fly.

    Args:
        sight: what is around.
        problem: gives the limits.
        wanted: heading [rad] and share of full speed that would be flown without traffic.
        margin: to keep, in steps at full speed.
        steps: for how many steps to look ahead.
    """
    if not sight.hazards:
        return wanted
    heading, fraction = wanted
    times = problem.step * steps * np.arange(1, POINTS + 1) / POINTS
    aside = math.pi * (2.0 * np.arange(COURSES) / COURSES - 1.0)
    shares = np.maximum(np.array(SLOWER) * fraction, problem.floor.clearance(2))
    each, speeds = (grid.ravel() for grid in np.meshgrid(aside, shares))
    flown = _flown(sight, problem, heading + each, speeds, times)
    deepest = depths(sight.hazards, flown, times).max(axis=1)
    clear = deepest < -margin * problem.step * problem.forward
    detour = np.abs(each) / math.pi + (1.0 - speeds / fraction)
    best = int(np.argmin(np.where(clear, detour, np.inf) if clear.any() else deepest))
    return heading + float(each[best]), float(speeds[best])


def _flown(sight: Sight, problem: Problem, courses: Array, fractions: Array, times: Array) -> Array:
    """Return the ways of turns to courses [rad] at shares of full speed, shape (M, K, 2) [m]."""
    fastest = problem.max_rate or math.pi / problem.step
    turn = (courses - sight.heading + np.pi) % (2.0 * np.pi) - np.pi
    each = times[1] - times[0]
    middles = times - 0.5 * each
    headings = sight.heading + np.clip(turn[:, None], -fastest * middles, fastest * middles)
    airspeed = problem.forward * fractions[:, None, None]
    velocity = airspeed * np.stack([np.cos(headings), np.sin(headings)], axis=-1) + sight.wind
    return np.asarray(sight.state.position + each * np.cumsum(velocity, axis=1))
