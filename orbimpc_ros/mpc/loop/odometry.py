"""Measurements of the vehicle, and the states of the planning problem that they mean.

Mathematics: docs/mathematics.md, 7.1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array, ByContent, sealed
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Problem, State

NOISE = 0.05  # of full speed: by so much a speed may be out of range unsaid


@dataclass(frozen=True, eq=False)
class Odometry(ByContent):
    """A measurement of the vehicle's motion.

    Attributes:
        time: stamp [s].
        position: in the world frame, shape (n,) [m].
        attitude: body to world rotation, shape (n, n).
        body_velocity: in the body frame, shape (n,) [m/s].
        body_rate: in the body frame, shape (1,) or (3,) [rad/s].
    """

    time: float
    position: Array
    attitude: Array
    body_velocity: Array
    body_rate: Array

    def __post_init__(self) -> None:
        for array in (self.position, self.attitude, self.body_velocity, self.body_rate):
            sealed(array)


def state_of(problem: Problem, odometry: Odometry, thrust_fraction: float) -> State:
    """Return the state that a plan starts from: R_0 = sigma_0 Q_0, always in conv SO(n).

    Args:
        problem: gives the orders, the step and the full speed.
        odometry: the measurement.
        thrust_fraction: the share of thrust now applied, in [0, 1]; at translation order 2 odometry
            does not show it. At order 1 sigma_0 is the measured share of full speed.
    """
    if not problem.inertial:
        fraction = float(np.clip(odometry.body_velocity[0] / problem.forward, 0.0, 1.0))
        velocity = None
    else:
        fraction = thrust_fraction
        velocity = odometry.attitude @ odometry.body_velocity
    coasted = None
    if problem.rotation_order == 2:
        coasted = odometry.attitude @ exp(problem.step * odometry.body_rate)
    return State.at(
        position=odometry.position,
        rotation=fraction * odometry.attitude,
        velocity=velocity,
        attitude=odometry.attitude,
        coasted=coasted,
    )


def odd_speed(problem: Problem, odometry: Odometry) -> str:
    """Return that the measured speed is not one that the model knows, in words; else empty.

    Such a speed counts as the nearest that it does: none, or full speed.
    """
    speed, full = float(odometry.body_velocity[0]), problem.forward
    if problem.inertial or -NOISE * full <= speed <= (1.0 + NOISE) * full:
        return ''
    taken = full if speed > 0.0 else 0.0
    return f'measured a forward speed of {speed:.3g} m/s, taken as {taken:g} m/s'
