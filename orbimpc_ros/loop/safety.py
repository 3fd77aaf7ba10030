# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The safe command, in force while there is no plan to follow.

Mathematics: docs/mathematics.md, 7.7.
"""

from __future__ import annotations

import math

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.command import Command, stop
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.problem.pace import moved_towards

SAFE_COMMANDS = ('auto', 'stop', 'hold_rate_zero', 'loiter', 'hover')
CIRCLE_STEPS = 16  # a loitering vehicle closes its circle in so many steps


def decided(kind: str, problem: Problem, gravity: float = 0.0) -> str:
    """Return the kind of safe command that ``auto`` stands for, and any other kind as it is.

    A vehicle with a minimum speed circles. A minimum thrust does not make it circle: stopping the
    engine is then what coasting is. Under gravity [m/s^2] that is to fall: there it hovers.
    """
    if kind != 'auto':
        return kind
    if gravity and problem.inertial:
        return 'hover'
    floored = problem.floor.exists and not problem.inertial
    return 'loiter' if floored else 'stop'


def may_stop(kind: str, problem: Problem) -> bool:
    """Return whether the safe command may be below the floor: as it was asked for, or coasts."""
    return decided(kind, problem) == 'stop' or problem.inertial


def safe_command(
    kind: str,
    problem: Problem,
    attitude: Array,
    fraction: float,
    disturbance: Array | None = None,
) -> Command:
    """Return a safe command.

    Args:
        kind: ``auto``: as :func:`decided`; ``stop``: no speed or thrust, no turning;
            ``hold_rate_zero``: the present speed, yet
            at least the floor, no turning (with thrust, at translation order 2, that is to
            coast); ``loiter``: a level circle at the least speed, or at full speed without a floor,
            to which the speed changes as ``max_acceleration`` allows;
            ``hover`` (order 2): the thrust that :func:`carrying` has, no turning.
        problem: gives floor and limits.
        attitude: the present one, shape (n, n).
        fraction: share of full speed commanded last, in [0, 1].
        disturbance: the acceleration to hover against, shape (n,) [m/s^2]; None for none.
    """
    kind = decided(kind, problem)
    if kind == 'stop':  # at once: what brakes does so as fast as it can
        return stop(attitude)
    rate = np.zeros(1 if problem.dimension == 2 else 3)
    least = problem.floor.clearance(problem.dimension)
    if kind == 'hover':
        carried = 0.0 if disturbance is None else carrying(problem, attitude, disturbance)
        return Command(max(carried, least), rate, np.array(attitude))
    if kind == 'hold_rate_zero':
        kept = max(fraction, least) if not problem.inertial else 0.0
        return Command(kept, rate, np.array(attitude))
    circling = 2.0 * math.pi / (CIRCLE_STEPS * problem.step)
    rate[-1] = min(circling, problem.max_rate) if problem.max_rate > 0.0 else circling
    circled = problem.floor.circling(problem.dimension)
    told = moved_towards(problem, entry_of_safety(problem, fraction), circled)
    return Command(told, rate, attitude @ exp(problem.step * rate))


def entry_of_safety(problem: Problem, fraction: float) -> float:
    """Return the share of full speed that the change by a safe command counts from.

    That commanded last, or what every heading has at least with a floor: up to it, at once.
    """
    if not problem.floor.exists:
        return fraction
    return max(fraction, problem.floor.circling(problem.dimension))


def carrying(problem: Problem, attitude: Array, acceleration: Array) -> float:
    """Return the share of full thrust that carries a vehicle against an acceleration, in [0, 1].

    Not turned, for an attitude that is not measured any more must not be steered by: so much thrust
    that along the acceleration nothing is left. Tilted so far that full thrust would not do that,
    as much as leaves the least acceleration altogether.

    Args:
        problem: gives the full thrust.
        attitude: the present one, shape (n, n).
        acceleration: to be balanced, shape (n,) [m/s^2].
    """
    weight = float(np.linalg.norm(acceleration))
    if weight == 0.0:
        return 0.0
    upright = -float(acceleration @ attitude[:, 0]) / weight
    if problem.forward * upright >= weight:
        return weight / (problem.forward * upright)
    return max(0.0, weight * upright / problem.forward)
