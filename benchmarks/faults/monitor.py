# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The monitor: judges every command by its content and its time of sending."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped

from orbimpc_ros.ros.messages import WARN

About = Mapping[str, int]  # message information of DDS: time of sending on the system's clock
SLACK = 1e-6  # relative tolerance on limits
STILL = 1e-9  # [m/s], [rad/s]: standstill


class HeardCommand(NamedTuple):
    """A command: time of sending [s], forward speed [m/s], turn rates [rad/s]."""

    at: float
    speed: float
    rates: tuple[float, float, float]

    @property
    def safe(self) -> bool:
        """Return whether it stops the vehicle."""
        return abs(self.speed) <= STILL and all(abs(rate) <= STILL for rate in self.rates)


class HeardStatus(NamedTuple):
    """A diagnostic status: time of sending [s], level, message and values."""

    at: float
    level: bytes
    message: str
    values: dict[str, str]


@dataclass
class Monitor:
    """Records everything that a planner publishes.

    Times are those of sending, on the monotonic clock: a delay of the monitor does not count as
    a delay of the planner.
    """

    speed: float  # limit of every command, fault or not [m/s]
    rate: float  # limit of its body rate [rad/s]
    commands: list[HeardCommand] = field(default_factory=list)  # received so far
    ticks: list[HeardStatus] = field(default_factory=list)  # reports on ``tick``
    health: list[HeardStatus] = field(default_factory=list)  # diagnostics

    def on_command(self, message: TwistStamped, about: About) -> None:
        """Record a command."""
        turn = message.twist.angular
        rates = (turn.x, turn.y, turn.z)
        self.commands.append(HeardCommand(_sent(about), message.twist.linear.x, rates))

    def broken(self, since: float = -math.inf) -> int:
        """Return the number of commands that are not finite or exceed a limit."""
        return sum(each.at >= since and not self._keeps_limits(each) for each in self.commands)

    def _keeps_limits(self, command: HeardCommand) -> bool:
        slow = -STILL <= command.speed <= self.speed * (1.0 + SLACK)  # False for NaN
        return slow and math.hypot(*command.rates) <= self.rate * (1.0 + SLACK)

    def moving(self, since: float, until: float = math.inf) -> int:
        """Return the number of commands in a time interval that are not safe."""
        return sum(since < each.at <= until and not each.safe for each in self.commands)

    def moving_again(self, since: float, due: float) -> int:
        """Return the number of unsafe commands after the first safe one or, without one, ``due``.

        Args:
            since: time from which inputs from before the fault are stale [s]. Until then a planner
                that was safe for another reason, as on a busy machine, may plan with them again.
            due: latest time of a safe command [s].
        """
        safe = self.first_safe(since)
        return self.moving(safe if safe < math.inf else due)

    def first_safe(self, since: float) -> float:
        """Return the time of sending of the first safe command [s]; infinity without one."""
        safe = (each.at for each in self.commands if each.at >= since and each.safe)
        return next(safe, math.inf)


# Returns the time of the first occurrence since a time [s]; infinity without one.
Event = Callable[[Monitor, float], float]


def complaint(word: str = '', level: bytes = WARN) -> Event:
    """Return the event of a diagnostic of at least a level that contains a word."""

    def first(monitor: Monitor, since: float) -> float:
        heard = (each for each in monitor.health if each.at >= since and each.level >= level)
        found = (each.at for each in heard if word in ' '.join((each.message, *each.values)))
        return next(found, math.inf)

    return first


def _sent(about: About) -> float:
    """Return the time of sending of a message on the monotonic clock [s]."""
    return time.monotonic() - 1e-9 * (time.time_ns() - about['source_timestamp'])


def record(into: list[HeardStatus], message: DiagnosticArray, about: About) -> None:
    """Record a report in the ticks or the health of a monitor."""
    for each in message.status:
        values = {pair.key: pair.value for pair in each.values}
        into.append(HeardStatus(_sent(about), each.level, each.message, values))
