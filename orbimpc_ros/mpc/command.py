# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""From a plan to the command for its first step.

Mathematics: docs/mathematics.md, 7.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array, ByContent
from orbimpc_ros.mpc.geometry.rotations import exp, log
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.pace import entry_speed

RATE_TOLERANCE = 1e-6  # relative
ROTATION_TOLERANCE = 1e-9
SPEED_TOLERANCE = 1e-6  # as what plans are checked with


@dataclass(frozen=True, eq=False)
class Command(ByContent):
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
        self.body_rate.setflags(write=False)
        self.rotation.setflags(write=False)


def stop(rotation: Array) -> Command:
    """Return the safe command: no speed, no turning, the present attitude, shape (n, n)."""
    return Command(0.0, np.zeros(1 if len(rotation) == 2 else 3), np.array(rotation))


def flaw(
    problem: Problem, command: Command, *, stopping: bool = False, entry: float | None = None
) -> str:
    """Return why a command must not be sent, whatever it came from; empty if it may be.

    The last look before a vehicle gets it: finite, a share of full speed and not below the floor,
    a rate below the limit (without one, below half a turn in a step), a speed that is not changed
    faster than it may be, and a rotation.

    A stop that was asked for (``stopping``) is forbidden by no floor and no limit of the change of
    speed, which counts from the ``entry`` share of full speed; None if that is not known.
    """
    fraction = command.speed_fraction
    rate, rotation = command.body_rate.tolist(), command.rotation
    if not (all(map(math.isfinite, (fraction, *rate))) and np.isfinite(rotation).all()):
        return 'the command is not finite'
    if not 0.0 <= fraction <= 1.0:
        return f'a speed fraction of {fraction:.6g} is not in [0, 1]'
    floor = problem.least_speed
    if not stopping and fraction < floor:
        return f'a speed fraction of {fraction:.6g} is below the floor of {floor:.6g}'
    changed = abs(fraction - entry) if entry is not None and not stopping else 0.0
    if changed > problem.speed_change + SPEED_TOLERANCE:
        most = f'{problem.speed_change:.6g} in a step'
        return f'a speed fraction changed by {changed:.6g} is beyond {most}'
    largest = problem.max_rate or math.pi / problem.step
    if math.hypot(*rate) > largest * (1.0 + RATE_TOLERANCE):
        return f'a body rate of {math.hypot(*rate):.6g} rad/s is beyond {largest:.6g}'
    error = np.abs(rotation.T @ rotation - np.eye(len(rotation))).max()
    if error > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
        return 'the commanded rotation is not a rotation'
    return ''


def command_of(problem: Problem, state: State, plan: Plan, step: int = 0) -> Command:
    """Return the command for a step of ``plan``, the first by default.

    Rotation order 1: body rate log(Q_k^T Q_{k+1})/h. Order 2: the present body rate already carries
    Q_k to Q_{k+1} in this step, so the rate taken over at its end is log(Q_{k+1}^T Q_{k+2})/h. The
    rate never exceeds ``max_rate``. In the plane a floor makes sure that plans do not either; where
    they do (without a floor by a wide angle of a short chord, in space by a roll) the rate is cut,
    and the commanded rotation is the one then reached. Without a floor the vehicle then gets as
    much of the planned speed or thrust as is along the axis reached: at full speed it would miss
    the turn, and could circle its goal for ever. It is not slowed faster than it may be, though.

    Args:
        problem: gives step and limits.
        state: the state that the plan starts from.
        plan: a checked plan.
        step: k, in 0..N-1.
    """
    floor = problem.least_speed
    # What rounding leaves a plan short of its floor, no vehicle is told.
    fraction = min(1.0, max(floor, float(plan.speed_fraction[step + 1])))
    first = step + problem.rotation_order - 1
    start, end = plan.projected[first], plan.projected[min(first + 1, plan.horizon)]
    rate = log(start.T @ end) / problem.step
    size = math.sqrt(rate @ rate)
    if problem.max_rate > 0.0 and size > problem.max_rate:
        rate = rate * (problem.max_rate / size)
        planned, end = end, start @ exp(rate * problem.step)
        if problem.rotation_order == 1 and not problem.floor.exists:
            along = fraction * min(1.0, max(0.0, float(planned[:, 0] @ end[:, 0])))
            before = entry_speed(problem, state) if step == 0 else float(plan.speed_fraction[step])
            fraction = max(along, min(fraction, before - problem.speed_change))
    return Command(fraction, rate, np.array(end))
