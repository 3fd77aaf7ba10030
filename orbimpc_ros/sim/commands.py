# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The commands to a simulated vehicle: a twist, and a thrust at translation order 2."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import TwistStamped, WrenchStamped

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.messages import SECOND, Frames, read_force, read_speed_and_rate
from orbimpc_ros.sim.vehicle import Model

SLACK = 1e-3  # of a share or a rate: what rounding may add, and a controller not notice
AHEAD = 1.0  # [s] a command's stamp may be ahead of this clock


@dataclass(frozen=True)
class Order:
    """A complete command.

    Attributes:
        stamp: of the odometry that it answers [ns].
        fraction: share of full speed or thrust.
        body_rate: shape (1,) or (3,) [rad/s].
    """

    stamp: int
    fraction: float
    body_rate: Array


class Orders:
    """Turns messages into orders, at translation order 2 two messages with the same stamp.

    Args:
        model: of the vehicle.
        frames: name the body axis that pushes.

    Attributes:
        latest: the last complete order, if any.
    """

    def __init__(self, model: Model, frames: Frames) -> None:
        self._model, self._frames = model, frames
        self._twist: tuple[int, float, Array] | None = None
        self._force: tuple[int, float] | None = None
        self.latest: Order | None = None

    def take_twist(self, message: TwistStamped, now: int) -> bool:
        """Take in ``cmd_vel`` at ``now`` [ns] and return whether it completes an order.

        Raises:
            BadInput: a stamp, a number or a range is not acceptable.
        """
        stamp, speed, body_rate = read_speed_and_rate(message, self._model.dimension, self._frames)
        _require_past(stamp, now)
        fastest = math.pi / self._model.step  # a faster turn looks like a slower one
        if float(np.linalg.norm(body_rate)) > fastest * (1.0 + SLACK):
            allowed = f'at most pi / step = {fastest:.6g} rad/s'
            raise BadInput('twist.angular', body_rate.tolist(), allowed)
        if self._model.translation_order == 1:
            full = self._model.forward
            _require_share(
                speed / full, f'twist.linear.{self._frames.thrust_axis}', speed, full, 'm/s'
            )
        self._twist = stamp, speed, body_rate
        return self._complete()

    def take_force(self, message: WrenchStamped, now: int) -> bool:
        """Take in ``cmd_thrust`` at ``now`` [ns] and return whether it completes an order.

        Raises:
            BadInput: a stamp, a number or a range is not acceptable.
        """
        stamp, force = read_force(message, self._frames)
        _require_past(stamp, now)
        full = self._model.mass * self._model.forward
        _require_share(force / full, f'wrench.force.{self._frames.thrust_axis}', force, full, 'N')
        self._force = stamp, force
        return self._complete()

    def _complete(self) -> bool:
        if self._twist is None:
            return False
        stamp, speed, body_rate = self._twist
        if self._model.translation_order == 1:
            self.latest = Order(stamp, speed / self._model.forward, body_rate)
            return True
        if self._force is None or self._force[0] != stamp:
            return False
        fraction = self._force[1] / (self._model.mass * self._model.forward)
        self.latest = Order(stamp, fraction, body_rate)
        return True


def _require_past(stamp: int, now: int) -> None:
    if stamp > now + AHEAD * SECOND:
        ahead = (stamp - now) / SECOND
        raise BadInput('header.stamp', f'{ahead:g} s in the future', f'at most {AHEAD:g} s')


def _require_share(share: float, culprit: str, value: float, full: float, unit: str) -> None:
    if not -SLACK <= share <= 1.0 + SLACK:
        raise BadInput(culprit, value, f'0 to full speed or thrust, {full:g} {unit}')
