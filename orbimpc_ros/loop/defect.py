# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What a vehicle that follows a plan does, and the plan's steps do not.

An ``exact`` step takes the chord between the thrust axes at its ends, and the speed changes evenly
in it. A vehicle turns along the arc, and its speed follows the command of the step with a lag. At
the end of a plan the two are a *defect* apart: whoever wants to be at a place plans for one that is
moved by as much the other way, and so on (iterated defect correction).

Mathematics: docs/mathematics.md, 7.10.
"""

from __future__ import annotations

import math

import numpy as np

from orbimpc_ros.loop.delay import turned
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import log
from orbimpc_ros.mpc.model.dynamics import drift
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem, State


def defect(problem: Problem, state: State, plan: Plan, lag: float) -> Array:
    """Return how far from the end of a plan a vehicle gets that follows it, shape (n,) [m].

    Zero where thrust is an acceleration, where rates are commanded a step ahead, and with ``euler``
    steps, whose vehicle obeys as they have it.

    Args:
        problem: that the plan solves.
        state: where it starts.
        plan: to be followed.
        lag: of the speed [s].
    """
    if problem.inertial or problem.rotation_order == 2 or problem.discretisation == 'euler':
        return np.zeros(problem.dimension)
    flown = _speeds(problem.step, plan.speed_fraction, lag) @ _means(plan.projected)
    way = problem.step * problem.forward * flown
    return np.asarray(drift(problem, state)[-1] + way - plan.positions[-1])


def _means(attitudes: Array) -> Array:
    """Return the mean of the thrust axis in each step, shape (N, n), of one that turns evenly.

    Args:
        attitudes: at the ends of the steps, shape (N + 1, n, n).
    """
    turns = np.swapaxes(attitudes[:-1], 1, 2) @ attitudes[1:]
    if turns.shape[-1] == 2:
        half = 0.5 * np.arctan2(turns[:, 1, 0], turns[:, 0, 0])
        reached = np.stack([np.cos(half), np.sin(half)], axis=1) * np.sinc(half / np.pi)[:, None]
    else:
        ahead = np.eye(3)[0]
        reached = np.array([turned(log(each), ahead)[0] for each in turns])
    return np.einsum('kij,kj->ki', attitudes[:-1], reached)


def _speeds(step: float, told: Array, lag: float) -> Array:
    """Return the mean share of full speed in each step, of one that follows what is told at it.

    Args:
        step: [s].
        told: share now, and at the end of each step, shape (N + 1,).
        lag: of a first-order response [s].
    """
    left = math.exp(-step / lag) if lag else 0.0
    spread = lag / step * (1.0 - left)
    now, means = float(told[0]), []
    for wanted in told[1:].tolist():
        means.append(wanted + spread * (now - wanted))
        now = wanted + left * (now - wanted)
    return np.array(means)
