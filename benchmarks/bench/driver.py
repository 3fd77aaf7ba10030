# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A node that drives planners with odometry at a fixed rate and takes the time of their answers."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from harness import Observer
from nav_msgs.msg import Odometry
from scenarios import retrieval_problem

from benchmarks.bench.instances import around
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Frames, Stamp
from orbimpc_ros.ros.process import qos
from orbimpc_ros.sim.vehicle import measured

FRAMES = Frames('odom', 'base_link')
POINTS = 100  # of the flight around the rope that is replayed
AHEAD = 5_000_000  # [ns] by which a goal's stamp precedes odometry's: from another sensor


@dataclass
class RoundTrip:
    """One odometry message and its answer.

    Attributes:
        sent: when it was published [s].
        latency: until the command was there [s]; infinite while it is not.
        solve_ms: what its tick took, as the planner reports [ms]; NaN before it does.
    """

    sent: float
    latency: float = math.inf
    solve_ms: float = math.nan

    @property
    def complete(self) -> bool:
        """Return whether command and report are there."""
        return self.latency < math.inf and not math.isnan(self.solve_ms)


def answered(ticks: Collection[RoundTrip]) -> bool:
    """Return whether every command is there, and every report of a node that makes any."""
    reports = any(not math.isnan(tick.solve_ms) for tick in ticks)
    return all(tick.complete if reports else tick.latency < math.inf for tick in ticks)


class Driver:
    """Publishes odometry and goals in each namespace, in turns within a period.

    Args:
        namespaces: of the planners.
        executor: of the driver's own node.
    """

    def __init__(self, namespaces: Sequence[str], executor: str = 'wait_set') -> None:
        self._observer = Observer(executor=executor)
        self._ticks = [dict[int, RoundTrip]() for _ in namespaces]
        self._answered = [0] * len(namespaces)
        self._publishers = [self._wire(i, name) for i, name in enumerate(namespaces)]
        self._flights = [flight for flight, _ in around(retrieval_problem(), POINTS)]
        self._count, self._stamp = 0, 0

    def _wire(self, i: int, namespace: str) -> tuple[Any, Any]:
        subscribe = self._observer.subscribe
        subscribe(TwistStamped, f'{namespace}/cmd_vel', partial(self._on_command, i), qos(100))
        subscribe(DiagnosticArray, f'{namespace}/tick', partial(self._on_tick, i), qos(100))
        publish = self._observer.node.create_publisher
        return (
            publish(Odometry, f'{namespace}/odom', qos()),
            publish(PoseStamped, f'{namespace}/goal', qos()),
        )

    def _on_command(self, i: int, message: TwistStamped) -> None:
        now = time.monotonic()
        tick = self._ticks[i].get(_stamp_of(message))
        if tick is not None and tick.latency == math.inf:
            tick.latency = now - tick.sent
            self._answered[i] += 1

    def _on_tick(self, i: int, message: DiagnosticArray) -> None:
        tick = self._ticks[i].get(_stamp_of(message))
        if tick is not None:
            values = {pair.key: pair.value for pair in message.status[0].values}
            tick.solve_ms = float(json.loads(values['solve_time_ms']))

    def until_answered(self, rate: float, limit: float) -> None:
        """Drive until every planner has answered.

        Raises:
            OrbimpcError: one has not, in ``limit`` seconds.
        """
        self.drive(rate, limit, lambda: all(self._answered))
        if not all(self._answered):
            raise OrbimpcError(f'{self._answered.count(0)} planners have not answered')

    def drive(self, rate: float, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        """Publish odometry at a rate [Hz] for a while, or until ``done``."""
        gap = 1.0 / (rate * len(self._publishers))
        begin, sent = time.monotonic(), 0
        while sent * gap < seconds and not done():
            self._publish(sent % len(self._publishers))
            sent += 1
            self._observer.spin(begin + sent * gap - time.monotonic(), done)

    def _publish(self, i: int) -> None:
        odometry, goal = self._publishers[i]
        flight = self._flights[(self._count // len(self._publishers)) % len(self._flights)]
        self._count += 1
        self._stamp = max(self._stamp + 1, time.time_ns())
        goal.publish(messages.goal_message(Stamp(self._stamp - AHEAD, FRAMES), flight.goal))
        message = messages.odometry_message(Stamp(self._stamp, FRAMES), measured(flight.vehicle))
        self._ticks[i][self._stamp] = RoundTrip(time.monotonic())
        odometry.publish(message)

    def listen(self, seconds: float) -> None:
        """Only listen for a while, or until everything is answered."""

        def done() -> bool:
            return all(answered(ticks.values()) for ticks in self._ticks)

        self._observer.spin(seconds, done)

    def forget(self) -> None:
        """Drop what was measured so far."""
        for ticks in self._ticks:
            ticks.clear()

    def ticks(self) -> list[RoundTrip]:
        """Return everything measured."""
        return [tick for i in range(len(self._ticks)) for tick in self.ticks_of(i)]

    def ticks_of(self, i: int) -> list[RoundTrip]:
        """Return what was measured in the ``i``-th namespace."""
        return [*self._ticks[i].values()]

    def close(self) -> None:
        """Take the node down."""
        self._observer.close()


def _stamp_of(message: Any) -> int:
    stamp = message.header.stamp
    return stamp.sec * messages.SECOND + stamp.nanosec
