# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The commands to a simulated vehicle: a twist, and a thrust at translation order 2."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

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
    """A complete command."""

    stamp: int  # of the odometry that it answers [ns]
    fraction: float  # share of full speed or thrust
    body_rate: Array  # shape (1,) or (3,) [rad/s]


class Orders:
    """Turns messages into orders, at translation order 2 two messages with the same stamp."""

    def __init__(self, model: Model, frames: Frames) -> None:
        self._model, self._frames = model, frames
        self._twist: Order | None = None  # at translation order 2 without its thrust
        self._thrust = -1, 0.0  # a stamp [ns], and a share of full thrust

    def take_twist(self, message: TwistStamped, now: int) -> Order | None:
        """Take in ``cmd_vel`` at ``now`` [ns] and return the order that it completes, if any.

        Raises:
            BadInput: a stamp, a number or a range is not acceptable.
        """
        stamp, speed, body_rate = read_speed_and_rate(message, self._model.dimension, self._frames)
        _require_past(stamp, now)
        fastest = math.pi / self._model.step  # a faster turn looks like a slower one
        if float(np.linalg.norm(body_rate)) > fastest * (1.0 + SLACK):
            allowed = f'at most pi / step = {fastest:.6g} rad/s'
            raise BadInput('twist.angular', body_rate.tolist(), allowed)
        share = 0.0
        if self._model.translation_order == 1:
            share = self._share(speed, self._model.forward, 'twist.linear', 'm/s')
        self._twist = Order(stamp, share, body_rate)
        return self._complete()

    def take_force(self, message: WrenchStamped, now: int) -> Order | None:
        """Take in ``cmd_thrust``, like :meth:`take_twist`."""
        stamp, force = read_force(message, self._frames)
        _require_past(stamp, now)
        full = self._model.mass * self._model.forward
        self._thrust = stamp, self._share(force, full, 'wrench.force', 'N')
        return self._complete()

    def _share(self, value: float, full: float, field: str, unit: str) -> float:
        share = value / full
        if not -SLACK <= share <= 1.0 + SLACK:
            culprit = f'{field}.{self._frames.thrust_axis}'
            raise BadInput(culprit, value, f'0 to full speed or thrust, {full:g} {unit}')
        return share

    def _complete(self) -> Order | None:
        order, (stamp, share) = self._twist, self._thrust
        if order is None or self._model.translation_order == 1:
            return order
        return replace(order, fraction=share) if stamp == order.stamp else None


def _require_past(stamp: int, now: int) -> None:
    if stamp > now + AHEAD * SECOND:
        ahead = (stamp - now) / SECOND
        raise BadInput('header.stamp', f'{ahead:g} s in the future', f'at most {AHEAD:g} s')
