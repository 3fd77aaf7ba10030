"""The safe command: what the vehicle is told when there is no plan to follow."""

from __future__ import annotations

import math

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.command import Command, stop
from orbimpc_ros.mpc.problem import Problem, largest_fraction
from orbimpc_ros.mpc.rotations import exp

CIRCLE_STEPS = 16  # a loitering vehicle closes its circle in so many steps


def safe_command(kind: str, problem: Problem, attitude: Array, fraction: float) -> Command:
    """Return a safe command.

    Args:
        kind: ``stop``: no speed or thrust, no turning; ``hold_rate_zero``: the present speed, yet
            at least the floor, no turning (with thrust, at translation order 2, that is to
            coast); ``loiter``: a level circle at the least speed, or at full speed without a floor.
        problem: gives floor and limits.
        attitude: the present one, shape (n, n).
        fraction: share of full speed commanded last, in [0, 1].
    """
    if kind == 'stop':
        return stop(attitude)
    rate = np.zeros(1 if problem.dimension == 2 else 3)
    if kind == 'hold_rate_zero':
        least = 0.0 if problem.floor.shape == 'none' else problem.floor.fraction
        kept = max(fraction, least) if problem.translation_order == 1 else 0.0
        return Command(kept, rate, np.array(attitude))
    circling = 2.0 * math.pi / (CIRCLE_STEPS * problem.step)
    rate[-1] = min(circling, problem.max_rate) if problem.max_rate > 0.0 else circling
    return Command(_circling_fraction(problem), rate, attitude @ exp(problem.step * rate))


def _circling_fraction(problem: Problem) -> float:
    """Return the least share of full speed that keeps to the floor in every heading.

    A polygon (or solid) demands that R e1 lies beyond one of its faces. Half-way between two of
    them that takes fraction / cos(pi / m), the radius of its corners, and a circle leads through
    every heading.
    """
    floor = problem.floor
    if floor.shape == 'none':
        return 1.0
    if floor.shape == 'circle':
        return floor.fraction
    return min(1.0, floor.fraction / largest_fraction(problem.dimension, floor.faces))
