# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Planner processes over DDS: start-up time, memory, latency, and many planners on one machine.

A driver in this process publishes odometry and receives commands. A command has the stamp of the
odometry that it answers, so that each latency is from publication to receipt, on one clock.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Odometry
from scenarios import retrieval_problem

from benchmarks.bench.instances import around
from benchmarks.bench.interleaved import OURS
from benchmarks.bench.results import LATE, BenchRow, percentiles
from benchmarks.machine import busy, resident
from benchmarks.session import PLANNER, Session
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Frames, Stamp, stamp_of
from orbimpc_ros.ros.process import qos
from orbimpc_ros.sim.vehicle import measured
from orbimpc_ros.tool.bags import fields

FRAMES = Frames('odom', 'base_link')
POINTS = 100  # ticks of the replayed flight around the rope
AHEAD = 5_000_000  # [ns] by which a goal's stamp, from another sensor, precedes odometry's
MEETING = 60.0  # [s] for every planner to answer
FAST, FASTEST, SLOW = 50.0, 200.0, 5.0  # [Hz]
SETTLED = 50  # answers before measurements
WARM_UP = 2.0  # [s], for many planners at once
PLANNERS = (1, 5, 20)
TRAILING = 10.0  # [s] for the last answers
BARE = 'a node that only answers'
ECHO = 'benchmarks.bench.echo'
PARAMETERS = {
    'trigger': 'odom',
    'floor.shape': 'polygon',
    'floor.fraction': 0.5477225575,
    'odom_timeout': 5.0,
    'goal_timeout': 60.0,
}
START, AT_ONCE = 'node: start to first command', 'planners at 5 Hz'


class Driver(Session):
    """Starts nodes for the paper's UAV problem and publishes odometry and goals to each in turns.

    Args:
        modules: of the nodes, by namespace.
        executor: of all nodes and of this process.

    Attributes:
        sent: times of publication of odometry [s], by its stamp [ns], for each node.
    """

    def __init__(self, modules: Mapping[str, str], executor: str = 'wait_set') -> None:
        super().__init__(executor, executor)
        self.sent = [dict[int, float]() for _ in modules]
        # Receipt of the command that answers a stamp [s], and the solve time reported for it [ms].
        self._came, self._solved = dict[int, float](), dict[int, float]()
        create, self._publishers = self.node.create_publisher, list[tuple[Any, Any]]()
        for name in modules:
            self.subscribe(TwistStamped, f'{name}/cmd_vel', self._on_command, qos(100))
            self.subscribe(DiagnosticArray, f'{name}/tick', self._on_tick, qos(100))
            outputs = (
                create(Odometry, f'{name}/odom', qos()),
                create(PoseStamped, f'{name}/goal', qos()),
            )
            self._publishers.append(outputs)
        self._flights = [flight for flight, _ in around(retrieval_problem(), POINTS)]
        self._count, self._stamp = 0, 0
        for name, module in modules.items():
            self.launch(module, PARAMETERS, name)

    def _on_command(self, message: TwistStamped) -> None:
        self._came.setdefault(stamp_of(message), time.monotonic())

    def _on_tick(self, message: DiagnosticArray) -> None:
        self._solved[stamp_of(message)] = float(fields(message)['solve_time_ms'])

    def trips(self, i: int) -> Array:
        """Return latencies and solve times of a planner's ticks, shape (M, 2) [ms].

        The latency is that of the command, infinite without one; an unknown solve time is NaN.
        """
        known = [
            (1e3 * (self._came.get(at, math.inf) - sent), self._solved.get(at, math.nan))
            for at, sent in self.sent[i].items()
        ]
        return np.reshape(known, (-1, 2))

    @property
    def _answered(self) -> bool:
        """Return whether all commands have arrived, and all reports of nodes that report."""
        came, solved = self._came.keys(), self._solved.keys()
        asked = [each.keys() for each in self.sent]
        reported = (each <= solved or each.isdisjoint(solved) for each in asked)
        return all(each <= came for each in asked) and all(reported)

    def drive(self, rate: float, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        """Publish odometry at a rate [Hz] for a while, or until ``done``."""
        gap = 1.0 / (rate * len(self._publishers))
        begin, sent = time.monotonic(), 0
        while sent * gap < seconds and not done():
            self._publish(sent % len(self._publishers))
            sent += 1
            self.spin(begin + sent * gap - time.monotonic(), done)

    def until_answered(self, rate: float) -> None:
        """Drive until every planner has answered.

        Raises:
            OrbimpcError: one has not answered in time.
        """

        def silent() -> int:
            return sum(self._came.keys().isdisjoint(each) for each in self.sent)

        self.drive(rate, MEETING, lambda: not silent())
        if silent():
            raise OrbimpcError(f'{silent()} planners have not answered')

    def measure(self, rate: float, seconds: float, warm_up: float) -> None:
        """Drive for a while after a warm-up [s], and wait for the last answers."""
        self.drive(rate, warm_up)
        for each in self.sent:
            each.clear()
        self.drive(rate, seconds)
        self.spin(TRAILING, lambda: self._answered)

    def _publish(self, i: int) -> None:
        odometry, goal = self._publishers[i]
        flight = self._flights[(self._count // len(self._publishers)) % len(self._flights)]
        self._count += 1
        self._stamp = max(self._stamp + 1, time.time_ns())
        goal.publish(messages.goal_message(Stamp(self._stamp - AHEAD, FRAMES), flight.goal))
        message = messages.odometry_message(Stamp(self._stamp, FRAMES), measured(flight.vehicle))
        self.sent[i][self._stamp] = time.monotonic()
        odometry.publish(message)


def measurements(
    wanted: Sequence[str], quick: bool
) -> Iterator[tuple[str, Callable[[], list[BenchRow]]]]:
    """Yield title and measurement of ``start``, ``latency`` and ``planners``, if wanted."""
    if 'start' in wanted:
        yield START, partial(_start, 2 if quick else 5)
    if 'latency' in wanted:
        for rate in (FAST, FASTEST):
            for executor in ('wait_set', 'events'):
                title = f'node: odometry to command, {rate:g} Hz, {executor}'
                yield title, partial(latency, title, rate, executor, 2.0 if quick else 20.0)
    if 'planners' in wanted:
        for count in PLANNERS[-1:] if quick else PLANNERS:
            seconds = 60.0 if count == PLANNERS[-1] and not quick else 10.0
            yield f'{AT_ONCE}, {count} at once', partial(fleet, count, seconds)


def _start(count: int) -> list[BenchRow]:
    """Return the rows of the time to the first command and of memory."""
    times, sizes = [], []
    for _ in range(count):
        with closing(Driver({'': PLANNER})) as driver:
            begin = time.perf_counter()
            driver.until_answered(FAST)
            times.append(1e3 * (time.perf_counter() - begin))
            driver.drive(FAST, 1.0)
            sizes.append(1e-6 * resident(driver.processes[0].pid))
    title, limits = 'node: resident memory [MB]', {'objective': 250.0}
    memory = BenchRow(title, OURS, count, objective=max(sizes), required=limits)
    return [BenchRow(START, OURS, count, *percentiles(times), required={'p50_ms': 1000.0}), memory]


def latency(title: str, rate: float, executor: str, seconds: float) -> list[BenchRow]:
    """Return the rows of a planner and of a node that answers without planning.

    They are driven in turns within a period, under the same load of the machine: the planner's
    latency without its solve, less that of the other node, is its overhead.
    """
    with closing(Driver({'/ours': PLANNER, '/bare': ECHO}, executor)) as driver:
        driver.until_answered(FAST)
        before = [busy(process.pid) for process in driver.processes]
        driver.measure(rate, seconds, SETTLED / rate)
        after = [busy(process.pid) for process in driver.processes]
        ours, bare = driver.trips(0), driver.trips(1)[:, 0]
    done = ours[np.isfinite(ours).all(axis=1)]
    beside, floor = percentiles(done[:, 0] - done[:, 1]), percentiles(bare[np.isfinite(bare)])
    # If a planner is faster by chance, its overhead is too small to measure, but not negative.
    added = max(0.0, beside[0] - floor[0]), max(0.0, beside[1] - floor[1])
    limits = {'p50_ms': 0.6, 'p99_ms': 2.0} if rate == FAST else None
    lost, ticks = float(np.isinf(ours[:, 0]).sum()), SETTLED + len(ours)
    count, echoed = len(done), int(np.isfinite(bare).sum())
    return [
        BenchRow(title, OURS, count, *percentiles(done[:, 0])),
        BenchRow(title, 'the solve alone', count, *percentiles(done[:, 1])),
        BenchRow(title, 'without the solve', count, *beside),
        BenchRow(title, BARE, echoed, *floor),
        BenchRow(title, 'difference of the two', count, *added, required=limits),
        BenchRow(f'{title}: lost', OURS, len(ours), objective=lost, required={'objective': 0.0}),
        *(
            BenchRow(f'{title}: processor [ms]', who, len(ours), objective=1e3 * time / ticks)
            for who, time in zip((OURS, BARE), np.subtract(after, before).tolist(), strict=True)
        ),
    ]


def fleet(count: int, seconds: float) -> list[BenchRow]:
    """Return the row of many planners at once.

    A tick is missed if its command takes longer than a period after the odometry, or never comes.
    """
    with closing(Driver({f'/p{i}': PLANNER for i in range(count)})) as driver:
        driver.until_answered(SLOW)
        driver.measure(SLOW, seconds, WARM_UP)
        times = np.concatenate([driver.trips(i)[:, 0] for i in range(count)])
    late, reached = float((times > 1e3 / SLOW).sum()), percentiles(times[np.isfinite(times)])
    title = f'{AT_ONCE}, {count} at once: {LATE}'
    required = {'objective': 0.0} if count == PLANNERS[-1] else None
    return [BenchRow(title, OURS, len(times), *reached, objective=late, required=required)]
