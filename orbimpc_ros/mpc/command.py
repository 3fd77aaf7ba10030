"""From a plan to the command for its first step."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.rotations import exp, log


@dataclass(frozen=True)
class Command:
    """What the vehicle does next: turn at a rate during the step, take over a speed at its end.

    Attributes:
        speed_fraction: share of full speed (translation order 1) or thrust (order 2), in [0, 1].
        body_rate: angular velocity in the body frame, shape (1,) or (3,) [rad/s].
        rotation: attitude commanded for the end of the step, shape (n, n).
    """

    speed_fraction: float
    body_rate: Array
    rotation: Array

    def __post_init__(self) -> None:
        sealed(self.body_rate)
        sealed(self.rotation)


def stop(rotation: Array) -> Command:
    """Return the safe command: no speed, no turning, the present attitude, shape (n, n)."""
    return Command(0.0, np.zeros(1 if len(rotation) == 2 else 3), np.array(rotation))


def command_of(problem: Problem, state: State, plan: Plan, step: int = 0) -> Command:
    """Return the command for a step of ``plan``, the first by default.

    Rotation order 1: body rate log(Q_k^T Q_{k+1})/h. Order 2: the present body rate already carries
    Q_k to Q_{k+1} in this step, so the rate taken over at its end is log(Q_{k+1}^T Q_{k+2})/h. The
    rate never exceeds ``max_rate``; where it has to be cut, the commanded rotation is the one then
    reached.

    Args:
        problem: gives step and limits.
        state: the state that the plan starts from.
        plan: a checked plan.
        step: k, in 0..N-1.
    """
    fraction = min(1.0, float(plan.speed_fraction[step + 1]))
    first = step + problem.rotation_order - 1
    start, end = plan.projected[first], plan.projected[min(first + 1, plan.horizon)]
    rate = log(start.T @ end) / problem.step
    size = math.sqrt(rate @ rate)
    if problem.max_rate > 0.0 and size > problem.max_rate:
        rate = rate * (problem.max_rate / size)
        end = start @ exp(rate * problem.step)
    return Command(fraction, rate, np.array(end))
