r"""Lags of a vehicle's response: where it stands once they are over.

A body rate that follows its command by a first-order lag, :math:`\\tau\\dot\\omega = c - \\omega`, leaves the
vehicle on the way that one without a lag takes from

.. math::
    \\hat\\theta = \\theta + \\tau\\omega, \\qquad \\dot{\\hat\\theta} = c,

a time :math:`\\tau` later. So a plan that starts from there, at that time, is made of commands: whoever
is sent them follows it, within all limits, and nothing is multiplied by the inverse of a lag.

Mathematics: docs/mathematics.md, 7.8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array, number
from orbimpc_ros.mpc.loop.delay import Interval, advanced
from orbimpc_ros.mpc.loop.odometry import Odometry
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
