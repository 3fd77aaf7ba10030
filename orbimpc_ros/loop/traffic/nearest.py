# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The hazards that matter to a plan, and how far it stays clear of them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from orbimpc_ros.loop.odometry import Odometry
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import MAX_HAZARDS, Hazard, Problem, State
from orbimpc_ros.mpc.problem.reach import farthest


def nearest(
    problem: Problem,
    odometry: Odometry,
    disturbance: Array | None,
    hazards: Sequence[Hazard],
    horizons: float = 1.0,
) -> tuple[tuple[Hazard, ...], int]:
    """Return the hazards that a vehicle may meet, and how many more there are.

    Those are the ones whose way and its own reach can meet at one and the same time; the ones that
    come nearest to where it is now, ``MAX_HAZARDS`` at most.

    Args:
        problem: gives the reach.
        odometry: where the vehicle is when the hazards' time begins.
        disturbance: a wind or an acceleration, shape (n,); None for none.
        hazards: all there are.
        horizons: how far ahead plans look, in horizons.
    """
    times = problem.step * np.arange(math.ceil(horizons * problem.horizon) + 1)
    speed = float(np.linalg.norm(odometry.body_velocity))
    blown = 0.0 if disturbance is None else float(np.linalg.norm(disturbance))
    reached = np.array([farthest(problem, speed, blown, time) for time in times[1:]])
    met = []
    for hazard in hazards:
        apart = clearances(hazard, odometry.position[None], times)
        # In the course of a step a hazard may come closer than at both of its ends.
        if (apart[:-1] - _fastest(hazard) * problem.step <= reached).any():
            met.append((float(apart.min()), hazard))
    met.sort(key=lambda each: each[0])
    return tuple(hazard for _, hazard in met[:MAX_HAZARDS]), max(0, len(met) - MAX_HAZARDS)


def clearances(hazard: Hazard, points: Array, times: Array) -> Array:
    """Return how far points are outside of a hazard at times, shape (M,) [m]; negative inside.

    Args:
        hazard: with its own time.
        points: shape (M, n), or (1, n) for all times [m].
        times: shape (M,) [s].
    """
    return np.asarray(-hazard.body.depth(points - hazard.moved(times)))


def _fastest(hazard: Hazard) -> float:
    speeds = np.linalg.norm(np.diff(hazard.shifts, axis=0), axis=1) / np.diff(hazard.times)
    return float(speeds.max())


def clearance(problem: Problem, state: State, positions: Array) -> float:
    """Return the least distance of a plan from hazards and obstacles at the ends of its steps.

    Infinite without any; from a box, the distance from the face that it is farthest beyond [m].

    Args:
        problem: has the obstacles, and the step.
        state: that the plan starts from, with its hazards.
        positions: of the plan, s_0..s_N, shape (N + 1, n) [m].
    """
    times = problem.step * np.arange(len(positions))
    moving = [clearances(each, positions, times).min() for each in state.hazards]
    still = [-each.depth(positions).max() for each in problem.obstacles]
    return float(min([*moving, *still], default=math.inf))
