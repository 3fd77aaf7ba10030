# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Planner processes over DDS: start, memory, latency, many at once on one machine.

A driver in this process publishes odometry and receives commands; a command carries the stamp of
the odometry that it answers, so that each latency is from one publish to one receipt, on one clock.
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from harness import Observer
from nav_msgs.msg import Odometry
from scenarios import retrieval_problem

from benchmarks.bench.instances import around
from benchmarks.bench.interleaved import OURS
from benchmarks.bench.results import LATE, BenchRow, percentiles
from benchmarks.machine import busy, resident
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Frames, Stamp
from orbimpc_ros.ros.process import qos
from orbimpc_ros.sim.vehicle import measured
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.bags import fields
from orbimpc_ros.tool.replay.recording import stamp_of
from orbimpc_ros.tool.run import discovery
from orbimpc_ros.tool.run.processes import Process, Processes

FRAMES = Frames('odom', 'base_link')
POINTS = 100  # of the flight around the rope that is replayed
AHEAD = 5_000_000  # [ns] by which a goal's stamp precedes odometry's: from another sensor
MEETING = 60.0  # [s] until every planner must have answered
FAST, FASTEST, SLOW = 50.0, 200.0, 5.0  # [Hz]
SETTLED = 50  # answers before the clock counts
WARM_UP = 2.0  # [s] of many planners at once
PLANNERS = (1, 5, 20)
TRAILING = 10.0  # [s] in which the last answers come, or are lost
BARE = 'a node that only answers'
PLANNER, ECHO = 'orbimpc_ros.ros.planner', 'benchmarks.bench.echo'
PARAMETERS = {
    'trigger': 'odom',
    'floor.shape': 'polygon',
    'floor.fraction': 0.5477225575,
    'odom_timeout': 5.0,
    'goal_timeout': 60.0,
}
START, AT_ONCE = 'node: start to first command', 'planners at 5 Hz'


@dataclass
class RoundTrip:
    """One odometry message and its answer."""

    sent: float  # time of publishing [s]
    latency: float = math.inf  # until the command has arrived [s]; infinite before
    solve_ms: float = math.nan  # solve time that the planner reports [ms]; NaN before


class Driver:
    """Publishes odometry and goals in each namespace, in turns within a period.

    Args:
        namespaces: of the planners.
        executor: of the driver's own node.

    Attributes:
        ticks: round trips by the stamp of their odometry [ns], for each namespace.
    """

    def __init__(self, namespaces: Sequence[str], executor: str) -> None:
        self._observer = Observer(executor=executor)
        self.ticks = [dict[int, RoundTrip]() for _ in namespaces]
        self._answered = [False] * len(namespaces)
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
        tick = self.ticks[i].get(stamp_of(message))
        if tick is not None and tick.latency == math.inf:
            tick.latency, self._answered[i] = now - tick.sent, True

    def _on_tick(self, i: int, message: DiagnosticArray) -> None:
        tick = self.ticks[i].get(stamp_of(message))
        if tick is not None:
            tick.solve_ms = float(fields(message)['solve_time_ms'])

    def drive(self, rate: float, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        """Publish odometry at a rate [Hz] for a while, or until ``done``."""
        gap = 1.0 / (rate * len(self._publishers))
        begin, sent = time.monotonic(), 0
        while sent * gap < seconds and not done():
            self._publish(sent % len(self._publishers))
            sent += 1
            self._observer.spin(begin + sent * gap - time.monotonic(), done)

    def until_answered(self, rate: float) -> None:
        """Drive until every planner has answered.

        Raises:
            OrbimpcError: one has not.
        """
        self.drive(rate, MEETING, lambda: all(self._answered))
        if not all(self._answered):
            raise OrbimpcError(f'{self._answered.count(False)} planners have not answered')

    def measure(self, rate: float, seconds: float, warm_up: float) -> None:
        """Drive for a while after a warm-up [s], and wait for the last answers."""
        self.drive(rate, warm_up)
        for ticks in self.ticks:
            ticks.clear()
        self.drive(rate, seconds)
        self._observer.spin(TRAILING, lambda: all(answered(each.values()) for each in self.ticks))

    def _publish(self, i: int) -> None:
        odometry, goal = self._publishers[i]
        flight = self._flights[(self._count // len(self._publishers)) % len(self._flights)]
        self._count += 1
        self._stamp = max(self._stamp + 1, time.time_ns())
        goal.publish(messages.goal_message(Stamp(self._stamp - AHEAD, FRAMES), flight.goal))
        message = messages.odometry_message(Stamp(self._stamp, FRAMES), measured(flight.vehicle))
        self.ticks[i][self._stamp] = RoundTrip(time.monotonic())
        odometry.publish(message)

    def close(self) -> None:
        """Take the node down."""
        self._observer.close()


def answered(ticks: Any) -> bool:
    """Return whether every command has arrived, and every report of a node that makes any."""
    commanded = all(tick.latency < math.inf for tick in ticks)
    reports = [not math.isnan(tick.solve_ms) for tick in ticks]
    return commanded and (all(reports) or not any(reports))


def measurements(
    wanted: Sequence[str], quick: bool
) -> Iterator[tuple[str, Callable[[], list[BenchRow]]]]:
    """Yield title and measurement of those of ``start``, ``latency`` and ``planners`` wanted."""
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


@contextmanager
def _driven(
    nodes: Mapping[str, str], executor: str = 'wait_set'
) -> Iterator[tuple[Driver, list[Process]]]:
    """Yield a driver and its nodes, on the paper's UAV problem.

    Args:
        nodes: their modules by namespace.
        executor: of all.
    """
    # The environment will name the folder, which goes away: it is restored.
    with tempfile.TemporaryDirectory() as name, mock.patch.dict(os.environ):
        folder = Path(name)
        discovery.isolate(folder)
        file = folder / 'planner.yaml'
        settings.write(file, PARAMETERS, executor=executor)
        with closing(Driver([*nodes], executor)) as driver, Processes() as processes:
            for i, (namespace, module) in enumerate(nodes.items()):
                processes.start(module, file, folder / f'node-{i}.log', namespace=namespace)
            yield driver, processes


def _start(count: int) -> list[BenchRow]:
    """Return the rows of time to the first command, and memory."""
    times, sizes = [], []
    for _ in range(count):
        with _driven({'': PLANNER}) as (driver, planners):
            begin = time.perf_counter()
            driver.until_answered(FAST)
            times.append(1e3 * (time.perf_counter() - begin))
            driver.drive(FAST, 1.0)
            sizes.append(1e-6 * resident(planners[0].pid))
    title, limits = 'node: resident memory [MB]', {'objective': 250.0}
    memory = BenchRow(title, OURS, count, objective=max(sizes), required=limits)
    return [BenchRow(START, OURS, count, *percentiles(times), required={'p50_ms': 1000.0}), memory]


def latency(title: str, rate: float, executor: str, seconds: float) -> list[BenchRow]:
    """Return the rows of a planner, and beside it of a node that answers without planning.

    They are driven in turns within a period, so that both meet the same machine: what the planner
    adds to the other's latency, its solve left out, is its own.
    """
    with _driven({'/ours': PLANNER, '/bare': ECHO}, executor) as (driver, processes):
        driver.until_answered(FAST)
        before = [busy(process.pid) for process in processes]
        driver.measure(rate, seconds, SETTLED / rate)
        taken = [busy(each.pid) - begun for each, begun in zip(processes, before, strict=True)]
        ours, bare = ([*ticks.values()] for ticks in driver.ticks)
    done = [t for t in ours if t.latency < math.inf and not math.isnan(t.solve_ms)]
    whole = [1e3 * t.latency for t in done]
    beside = percentiles([1e3 * t.latency - t.solve_ms for t in done])
    echoed = [1e3 * t.latency for t in bare if t.latency < math.inf]
    # Where one is quicker by chance, what it adds is too little to be seen, and not negative.
    floor = percentiles(echoed)
    added = max(0.0, beside[0] - floor[0]), max(0.0, beside[1] - floor[1])
    limits = {'p50_ms': 0.6, 'p99_ms': 2.0} if rate == FAST else None
    lost = float(sum(t.latency == math.inf for t in ours))
    count, ticks = len(done), SETTLED + len(ours)
    return [
        BenchRow(title, OURS, count, *percentiles(whole)),
        BenchRow(title, 'the solve alone', count, *percentiles([t.solve_ms for t in done])),
        BenchRow(title, 'without the solve', count, *beside),
        BenchRow(title, BARE, len(echoed), *floor),
        BenchRow(title, 'difference of the two', count, *added, required=limits),
        BenchRow(f'{title}: lost', OURS, len(ours), objective=lost, required={'objective': 0.0}),
        *(
            BenchRow(f'{title}: processor [ms]', who, len(ours), objective=1e3 * time / ticks)
            for who, time in zip((OURS, BARE), taken, strict=True)
        ),
    ]


def fleet(count: int, seconds: float) -> list[BenchRow]:
    """Return the row of many planners at once.

    A tick is missed if its command takes longer than a period after the odometry, or never comes.
    """
    with _driven({f'/p{i}': PLANNER for i in range(count)}) as (driver, _):
        driver.until_answered(SLOW)
        driver.measure(SLOW, seconds, WARM_UP)
        times = [1e3 * tick.latency for ticks in driver.ticks for tick in ticks.values()]
    late = float(sum(time > 1e3 / SLOW for time in times))
    reached = percentiles([time for time in times if time < math.inf])
    title = f'{AT_ONCE}, {count} at once: {LATE}'
    required = {'objective': 0.0} if count == PLANNERS[-1] else None
    return [BenchRow(title, OURS, len(times), *reached, objective=late, required=required)]
