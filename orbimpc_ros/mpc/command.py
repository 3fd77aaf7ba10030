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


def command_of(problem: Problem, state: State, plan: Plan) -> Command:
    """Return the command for the first step of ``plan``.

    Rotation order 1: body rate log(Q_0^T Q_1)/h. Order 2: the present body rate already carries
    Q_0 to Q_1 in this step, so the rate taken over at its end is log(Q_1^T Q_2)/h. The rate never
    exceeds ``max_rate``; where it has to be cut, the commanded rotation is the one then reached.

    Args:
        problem: gives step and limits.
        state: the state that the plan starts from.
        plan: a checked plan.
    """
    fraction = min(1.0, float(plan.speed_fraction[1]))
    if problem.rotation_order == 1:
        start, end = state.attitude, plan.projected[1]
    else:
        start = plan.projected[1] if state.coasted is None else state.coasted
        end = plan.projected[min(2, plan.horizon)]
    rate = log(start.T @ end) / problem.step
    size = math.sqrt(rate @ rate)
    if problem.max_rate > 0.0 and size > problem.max_rate:
        rate = rate * (problem.max_rate / size)
        end = start @ exp(rate * problem.step)
    return Command(fraction, rate, np.array(end))
