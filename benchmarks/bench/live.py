# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Planner processes, live: start, memory, latency over DDS, many at once on one machine.

A driver in this process publishes odometry and hears commands; a command carries the stamp of the
odometry that it answers, so that each latency is from one publish to one receipt, on one clock.
"""

from __future__ import annotations

import importlib.util
import math
import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING
from unittest import mock

from benchmarks.bench.interleaved import OURS, percentiles
from benchmarks.bench.results import LATE, BenchRow
from benchmarks.machine import busy, resident
from orbimpc_ros.tool.run import discovery
from orbimpc_ros.tool.run.processes import Process

if TYPE_CHECKING:
    from benchmarks.bench.driver import Driver

MEETING = 60.0  # [s] until every planner must have answered
FAST, FASTEST, SLOW = 50.0, 200.0, 5.0  # [Hz]
EXECUTORS = ('wait_set', 'events')
SETTLED = 50  # answers before the clock counts
WARM_UP = 2.0  # [s] of many planners at once
PLANNERS = (1, 5, 20)
LEAVE = 5.0  # [s] in which a planner ends
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
LATENCY, START = 'node: odometry to command', 'node: start to first command'
AT_ONCE = 'planners at 5 Hz'
NAMES = {'start': START, 'latency': LATENCY, 'planners': AT_ONCE}


def measurements(
    wanted: Sequence[str], quick: bool
) -> Iterator[tuple[str, Callable[[], list[BenchRow]]]]:
    """Yield name and measurement of those of ``start``, ``latency`` and ``planners`` wanted."""
    present = importlib.util.find_spec('rclpy') is not None
    for key, name in NAMES.items():
        if key in wanted:
            yield from _planned(key, quick) if present else [(name, partial(_absent, name))]


def _absent(name: str) -> list[BenchRow]:
    return [BenchRow(name, OURS, note='absent: ROS 2 Jazzy, or the extra "ros" of this package')]


def _planned(key: str, quick: bool) -> Iterator[tuple[str, Callable[[], list[BenchRow]]]]:
    if key == 'start':
        yield START, partial(_start, 2 if quick else 5)
    elif key == 'latency':
        for rate in (FAST, FASTEST):
            for executor in EXECUTORS:
                title = f'{LATENCY}, {rate:g} Hz, {executor}'
                yield title, partial(_latency, title, rate, executor, 2.0 if quick else 20.0)
    else:
        for count in PLANNERS[-1:] if quick else PLANNERS:
            seconds = 60.0 if count == PLANNERS[-1] and not quick else 10.0
            yield f'{AT_ONCE}, {count} at once', partial(fleet, count, seconds)


@contextmanager
def _driven(
    nodes: Mapping[str, str], executor: str = 'wait_set'
) -> Iterator[tuple[Driver, list[Process], float]]:
    """Yield a driver, its nodes, and when they were started.

    Args:
        nodes: their modules by namespace.
        executor: of all.
    """
    from benchmarks.bench.driver import Driver

    # The environment will name the folder, which goes away: it is restored.
    with tempfile.TemporaryDirectory() as name, mock.patch.dict(os.environ):
        discovery.isolate(Path(name))
        with closing(Driver([*nodes], executor)) as driver:
            begin = time.perf_counter()
            with _running(nodes, executor, Path(name)) as processes:
                yield driver, processes, begin


@contextmanager
def _running(nodes: Mapping[str, str], executor: str, folder: Path) -> Iterator[list[Process]]:
    """Run a node on the paper's UAV problem in each namespace; all are stopped at the end."""
    from orbimpc_ros.tool import settings

    file, processes = folder / 'planner.yaml', list[Process]()
    settings.write(file, PARAMETERS, executor=executor)
    try:
        for i, (name, module) in enumerate(nodes.items()):
            processes.append(Process(module, file, folder / f'node-{i}.log', namespace=name))
        yield processes
    finally:
        for process in processes:  # all at once, so that none waits for another to end
            process.tell(signal.SIGINT)
        for process in processes:
            process.wait(LEAVE)
            process.stop()


def _start(count: int) -> list[BenchRow]:
    times, sizes = [], []
    for _ in range(count):
        with _driven({'': PLANNER}) as (driver, planners, begin):
            driver.until_answered(FAST, MEETING)
            times.append(1e3 * (time.perf_counter() - begin))
            driver.drive(FAST, 1.0)
            sizes.append(1e-6 * resident(planners[0].pid))
    p50, p99 = percentiles(times)
    memory = BenchRow(
        'node: resident memory [MB]', OURS, count, objective=max(sizes),
        required={'objective': 250.0},
    )  # fmt: skip
    return [BenchRow(START, OURS, count, p50, p99, required={'p50_ms': 1000.0}), memory]


def _latency(title: str, rate: float, executor: str, seconds: float) -> list[BenchRow]:
    """Return the rows of a planner, and beside it of a node that answers without any thought.

    They are driven in turns within a period, so that both meet the same machine: what the planner
    adds to the other's latency, its solve left out, is its own.
    """
    with _driven({'/ours': PLANNER, '/bare': ECHO}, executor) as (driver, processes, _):
        driver.until_answered(FAST, MEETING)
        driver.drive(rate, SETTLED / rate)
        driver.forget()
        before = [busy(process.pid) for process in processes]
        driver.drive(rate, seconds)
        taken = [busy(each.pid) - begun for each, begun in zip(processes, before, strict=True)]
        driver.listen(TRAILING)
        ours, bare = driver.ticks_of(0), driver.ticks_of(1)
    pairs = [(1e3 * t.latency, t.solve_ms) for t in ours if t.complete]
    beside = [latency - solve for latency, solve in pairs]
    echoed = [1e3 * t.latency for t in bare if t.latency < math.inf]
    floor, reached = percentiles(echoed), percentiles(beside)
    # Where one is quicker by chance, what it adds is too little to be seen, and not negative.
    added = max(0.0, reached[0] - floor[0]), max(0.0, reached[1] - floor[1])
    limits = {'p50_ms': 0.6, 'p99_ms': 2.0} if rate == FAST else None
    lost = sum(t.latency == math.inf for t in ours)
    return [
        BenchRow(title, OURS, len(pairs), *percentiles([latency for latency, _ in pairs])),
        BenchRow(title, 'the solve alone', len(pairs), *percentiles([solve for _, solve in pairs])),
        BenchRow(title, 'without the solve', len(pairs), *reached),
        BenchRow(title, BARE, len(echoed), *floor),
        BenchRow(title, 'difference of the two', len(pairs), *added, required=limits),
        BenchRow(
            f'{title}: lost', OURS, len(ours), objective=float(lost),
            required={'objective': 0.0},
        ),
        *(
            BenchRow(f'{title}: processor [ms]', who, len(ours), objective=1e3 * time / len(ours))
            for who, time in zip((OURS, BARE), taken, strict=True)
        ),
    ]  # fmt: skip


def fleet(count: int, seconds: float) -> list[BenchRow]:
    """Return the row of many planners at once.

    A tick is missed if its command takes longer than a period after the odometry, or never comes.
    """
    with _driven({f'/p{i}': PLANNER for i in range(count)}) as (driver, _, _):
        driver.until_answered(SLOW, MEETING)
        driver.drive(SLOW, WARM_UP)
        driver.forget()
        driver.drive(SLOW, seconds)
        driver.listen(TRAILING)
        ticks = driver.ticks()
    times = [1e3 * t.latency for t in ticks]
    late = sum(not latency <= 1e3 / SLOW for latency in times)
    p50, p99 = percentiles([t for t in times if t < float('inf')])
    title = f'{AT_ONCE}, {count} at once: {LATE}'
    required = {'objective': 0.0} if count == PLANNERS[-1] else None
    return [BenchRow(title, OURS, len(times), p50, p99, objective=float(late), required=required)]
