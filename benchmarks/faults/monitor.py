# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The monitor: every command received, judged by its content and by its time of sending."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped

from orbimpc_ros.ros.messages import ERROR, WARN

About = Mapping[str, int]  # message information of DDS: time of sending, of the system's clock
SLACK = 1e-6  # relative, on limits
STILL = 1e-9  # [m/s], [rad/s]: nothing moves


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


@dataclass(frozen=True)
class Limits:
    """Limits of every command, fault or not: full speed [m/s] and greatest rate [rad/s]."""

    speed: float
    rate: float

    def broken(self, command: HeardCommand) -> bool:
        """Return whether a command is not finite or beyond a limit."""
        if not all(map(math.isfinite, (command.speed, *command.rates))):
            return True
        too_fast = not -STILL <= command.speed <= self.speed * (1.0 + SLACK)
        return too_fast or math.hypot(*command.rates) > self.rate * (1.0 + SLACK)


@dataclass
class Monitor:
    """Records everything that a planner publishes.

    Times are of the monotonic clock, of when a message was sent: how long it waited for a
    monitor that was held up is not the planner's delay.
    """

    limits: Limits  # of commands
    commands: list[HeardCommand] = field(default_factory=list)  # received so far
    ticks: list[HeardStatus] = field(default_factory=list)  # reports on ``tick``
    health: list[HeardStatus] = field(default_factory=list)  # diagnostics

    def on_command(self, message: TwistStamped, about: About) -> None:
        """Record a command."""
        turn = message.twist.angular
        rates = (turn.x, turn.y, turn.z)
        self.commands.append(HeardCommand(_sent(about), message.twist.linear.x, rates))

    def on_tick(self, message: DiagnosticArray, about: About) -> None:
        """Record the report of a tick."""
        self.ticks += _statuses(message, about)

    def on_health(self, message: DiagnosticArray, about: About) -> None:
        """Record diagnostics."""
        self.health += _statuses(message, about)

    def broken(self, since: float = -math.inf) -> int:
        """Return how many commands are not finite or beyond a limit."""
        return sum(each.at >= since and self.limits.broken(each) for each in self.commands)

    def moving(self, since: float, until: float = math.inf) -> int:
        """Return how many commands of a time are not the safe one."""
        return sum(since < each.at <= until and not each.safe for each in self.commands)

    def moving_again(self, since: float, due: float) -> int:
        """Return how many commands are not safe though one was, or, if none was, are overdue.

        Args:
            since: when inputs from before the fault are out of date [s]. Until then a planner that
                is safe for another reason, as on a busy machine, may go on with them.
            due: latest time of a safe command [s].
        """
        safe = self.first_safe(since)
        return self.moving(safe if safe < math.inf else due)

    def first_safe(self, since: float) -> float:
        """Return when the first safe command was sent [s]; infinite if none was."""
        safe = (each.at for each in self.commands if each.at >= since and each.safe)
        return next(safe, math.inf)

    def first_error(self, since: float) -> float:
        """Return when the first error was reported [s]; infinite if none was."""
        return self.first_complaint(since, level=ERROR)

    def first_complaint(self, since: float, word: str = '', level: bytes = WARN) -> float:
        """Return when a diagnostic of a level first contained a word [s]; infinite if none did."""
        heard = (each for each in self.health if each.at >= since and each.level >= level)
        found = (each.at for each in heard if word in ' '.join((each.message, *each.values)))
        return next(found, math.inf)

    @property
    def solve_ms(self) -> float:
        """Return how long the last solve took [ms]."""
        return float(self.ticks[-1].values.get('solve_time_ms', 0.0)) if self.ticks else 0.0


def complaint(word: str) -> Callable[[Monitor, float], float]:
    """Return the event of a diagnostic that contains a word."""
    return lambda monitor, since: monitor.first_complaint(since, word)


def _sent(about: About) -> float:
    """Return when a message was sent, on the monotonic clock [s]."""
    return time.monotonic() - 1e-9 * (time.time_ns() - about['source_timestamp'])


def _statuses(message: DiagnosticArray, about: About) -> list[HeardStatus]:
    sent = _sent(about)
    return [
        HeardStatus(sent, each.level, each.message, {v.key: v.value for v in each.values})
        for each in message.status
    ]
