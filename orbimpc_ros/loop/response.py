# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Lags of a vehicle's response: where it stands once they are over.

A body rate that follows its command by a first-order lag, :math:`\tau\dot\omega = c - \omega`,
leaves the vehicle on the way that one without a lag takes a time :math:`\tau` later, from

.. math::
    \hat\theta = \theta + \tau\omega, \qquad \dot{\hat\theta} = c.

So a plan that starts from there, at that time, is made of commands: a vehicle that is sent them
follows it, within all limits, and nothing is multiplied by the inverse of a lag.

Mathematics: docs/mathematics.md, 7.8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbimpc_ros.loop.delay import Interval, advanced
from orbimpc_ros.loop.odometry import Odometry
from orbimpc_ros.mpc.arrays import Array, number
from orbimpc_ros.mpc.command import Command
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem

LONGEST = 1e3  # [s]


@dataclass(frozen=True)
class Response:
    """First-order lags of a vehicle that obeys at once.

    Attributes:
        speed: time constant of the speed, or at translation order 2 of the thrust [s].
        rate: of the body rate [s].
    """

    speed: float = 0.0
    rate: float = 0.0

    def __post_init__(self) -> None:
        number(self.speed, 'response.speed', 0.0, LONGEST)
        number(self.rate, 'response.rate', 0.0, LONGEST)

    @property
    def lags(self) -> bool:
        """Return whether there is any lag."""
        return self.speed > 0.0 or self.rate > 0.0

    def lead(self, problem: Problem) -> float:
        """Return by how long a plan starts ahead of the vehicle [s].

        Half a step of it the ``euler`` model has already: it keeps R_k for the whole step in which
        a vehicle turns on to R_{k+1}.
        """
        known = 0.5 * problem.step if problem.discretisation == 'euler' else 0.0
        return max(0.0, self.rate - known)

    def settled(
        self,
        problem: Problem,
        odometry: Odometry,
        thrust: tuple[float, float] = (0.0, 0.0),
        disturbance: Array | None = None,
        velocity_source: str = 'ground',
    ) -> Odometry:
        """Return where a vehicle that does not lag would have to be to fly the same, a lag later.

        Args:
            problem: gives the orders and the full speed or thrust.
            odometry: the measurement.
            thrust: shares of full thrust, applied now and commanded (translation order 2).
            disturbance: a wind or an acceleration, shape (n,); None for none.
            velocity_source: what odometry measures: velocity over ``ground`` or through ``air``.
        """
        if not problem.inertial:
            time = self.lead(problem)
            coming = [Interval(time, None, None)] if time > 0.0 else []
            return advanced(problem, odometry, coming, disturbance, velocity_source)
        return self._settled_thrust(problem, odometry, thrust, disturbance)

    def _settled_thrust(
        self,
        problem: Problem,
        odometry: Odometry,
        thrust: tuple[float, float],
        disturbance: Array | None,
    ) -> Odometry:
        """Return the same for a vehicle that is pushed.

        What a thrust that settles from f to c leaves is a speed of z tau (f - c), whenever it is
        looked at; the turn that is left over turns the axis of it meanwhile.
        """
        applied, commanded = thrust
        time = self.lead(problem)
        pushed = problem.forward * (odometry.attitude @ exp(0.5 * time * odometry.body_rate))[:, 0]
        left = self.speed * (applied - commanded) * pushed
        push = commanded * pushed + (0.0 if disturbance is None else disturbance)
        velocity = odometry.attitude @ odometry.body_velocity + left
        position = odometry.position + time * velocity + 0.5 * time * time * push
        position = position - self.speed * left
        velocity = velocity + time * push
        attitude = odometry.attitude @ exp(time * odometry.body_rate)
        body = attitude.T @ velocity
        return Odometry(odometry.time + time, position, attitude, body, odometry.body_rate)


def held_back(problem: Problem, plan: Plan, before: Command | None, command: Command) -> Command:
    """Return what to send a vehicle that obeys at once, for the step that begins.

    At second order the model takes a command over at the end of a step: what is due in this one is
    what was commanded before. With ``exact`` steps thrust changes evenly from one to the other.

    Args:
        problem: gives the orders.
        plan: whose first step begins.
        before: the command before; None if there is none.
        command: of the plan's first step.
    """
    fraction, rate, rotation = command.speed_fraction, command.body_rate, command.rotation
    if problem.inertial:
        due = (
            problem.floor.clearance(problem.dimension) if before is None else before.speed_fraction
        )
        late = {'euler': 0.0, 'exact': 0.5, 'held': 1.0}[problem.discretisation]
        fraction = (1.0 - late) * due + late * fraction
    if problem.rotation_order == 2:
        rate = np.zeros(len(rate)) if before is None else before.body_rate
        rotation = np.array(plan.projected[1])
    return Command(fraction, np.array(rate), np.array(rotation))
