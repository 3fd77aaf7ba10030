"""The commands a simulated vehicle gets: twist, joined by thrust at translation order 2."""

from __future__ import annotations

from dataclasses import dataclass

from geometry_msgs.msg import TwistStamped, WrenchStamped

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.ros.messages import read_force, read_speed_and_rate
from orbimpc_ros.world.vehicle import Model


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
    """Makes orders of messages; at translation order 2 of two messages with the same stamp.

    Attributes:
        latest: the last complete order, if any.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self._twist: tuple[int, float, Array] | None = None
        self._force: tuple[int, float] | None = None
        self.latest: Order | None = None

    def take_twist(self, message: TwistStamped) -> None:
        """Take in ``cmd_vel``.

        Raises:
            BadInput: a stamp or a number is not acceptable.
        """
        self._twist = read_speed_and_rate(message, self._model.dimension)
        self._complete()

    def take_force(self, message: WrenchStamped) -> None:
        """Take in ``cmd_thrust``.

        Raises:
            BadInput: a stamp or a number is not acceptable.
        """
        self._force = read_force(message)
        self._complete()

    def _complete(self) -> None:
        if self._twist is None:
            return
        stamp, speed, body_rate = self._twist
        if self._model.translation_order == 1:
            self.latest = Order(stamp, speed / self._model.forward, body_rate)
        elif self._force is not None and self._force[0] == stamp:
            fraction = self._force[1] / (self._model.mass * self._model.forward)
            self.latest = Order(stamp, fraction, body_rate)
