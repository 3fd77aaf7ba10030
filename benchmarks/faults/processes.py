# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rows of faults of whole processes: deadlines, floods, exceptions, signals, restarts."""

from __future__ import annotations

import itertools
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any
from unittest import mock

import numpy as np
from geometry_msgs.msg import Point
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool

from benchmarks.faults.harness import RATE, STEP, Bench, Harness, Monitored
from benchmarks.faults.injection import MIDWAY, REPEATS, SLOW, until_due
from benchmarks.faults.inputs import STALE
from benchmarks.faults.matrix import FaultCase, Outcome
from benchmarks.faults.monitor import STILL, complaint
from benchmarks.faults.stimulus import SLIP, with_field
from benchmarks.machine import resident
from benchmarks.session import PATIENCE
from orbimpc_ros.ros.process import LATCHED
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.processes import Child
from orbimpc_ros.tool.settings import config

ALTERED = 'benchmarks.faults.altered'  # the planner's module, modified to raise exceptions
LEAVE = 5.0  # [s] in which a process must have ended
FAREWELLS = 3  # safe commands before the exit
LATCH = 0.2  # [s] command_timeout
FLOOD, SETTLED, LATE = 5000.0, 1.0, 5.0  # [Hz], [s] to be discovered, [ms] beyond a period
SOAK, SOAK_STEP, MEBIBYTE, GROWTH = 1000.0, 0.05, 2.0**20, 2.0  # [Hz], [s], [bytes], [MiB]
FLIGHT = 32.0  # [s]: ten times as long as the usual one
SLOWEST = 0.75  # ticks: half a step for a solve, and a quarter for a busy machine


# --- deadlines


def _no_time(bench: Bench, long: bool) -> Iterator[Outcome]:
    """Searches that cannot end before the deadline: every tick has a command nevertheless."""
    with bench.lent(SLOW) as harness:
        for deadline in (0.001, 0.02, 0.05, 0.1) if long else (0.001, 0.1):
            harness.set_live(deadline=0.0)
            harness.until_planned()
            harness.set_live(deadline=deadline)
            begin = time.monotonic()
            harness.spin(10 * STEP)
            unsafe = harness.monitor.broken(begin)
            yield Outcome(f'deadline {deadline:g} s', unsafe, _slowest(harness, begin))
        harness.set_live(deadline=0.0)


def _slowest(harness: Harness, since: float) -> float:
    """Return the longest solve, or the excess of the longest gap between ticks, in ticks."""
    ticks = [tick for tick in harness.monitor.ticks if tick.at >= since]
    if len(ticks) < 2:
        return math.inf
    gap = max(later.at - tick.at for tick, later in itertools.pairwise(ticks))
    slowest = 1e-3 * max(float(tick.values['solve_time_ms']) for tick in ticks)
    return max(slowest / STEP, gap / STEP - 1.0)


# --- floods


@contextmanager
def flooded(harness: Harness, rate: float) -> Iterator[None]:
    """Have another process publish a harness's odometry, at a rate [Hz]."""
    words = [sys.executable, '-m', 'benchmarks.faults.stimulus', str(rate)]
    log = harness.folder / 'flood.log'
    with harness.muted():
        with mock.patch.dict(os.environ, harness.environment):
            child = Child('the flood', words, log)
        try:
            harness.until(lambda: harness.node.count_publishers('odom') > 0, 'the flood')
            harness.spin(SETTLED)
            yield
        finally:
            child.stop(signal.SIGTERM)


def _flood(bench: Bench, long: bool) -> Iterator[Outcome]:
    """Odometry that arrives faster than it can be read: planning goes on, and ticks are in time."""
    with bench.lent({}) as harness:
        harness.until_planned()
        with flooded(harness, FLOOD):
            begin = time.monotonic()
            harness.until_planned()
            harness.spin(30.0 if long else 2.0)
            ticks = [each.at for each in harness.monitor.ticks if each.at >= begin]
            harness.until_planned()
        late = 1e3 * (np.percentile(np.diff(ticks), 99) - STEP)
        yield Outcome('5 kHz', harness.monitor.broken(begin), max(0.0, float(late)))


def _soak(bench: Bench, long: bool) -> Iterator[Outcome]:
    """A planner at 20 Hz with odometry at 1 kHz for a long time: its memory does not grow."""
    with closing(Harness(bench.nodes, {'step': SOAK_STEP})) as harness:
        harness.until_planned()
        with flooded(harness, SOAK):
            begin = time.monotonic()
            harness.until_planned()
            harness.spin(120.0 if long else 2.0)
            settled = resident(harness.planner.pid)
            harness.spin(600.0 if long else 2.0)
            grown = (resident(harness.planner.pid) - settled) / MEBIBYTE
        yield Outcome('1 kHz', harness.monitor.broken(begin), max(0.0, grown))


# --- ends of the planner


def _exceptions(bench: Bench, long: bool) -> Iterator[Outcome]:
    """A controller with exceptions: the planner survives one, and must exit after five in a row."""
    slipping = 'odometry', with_field('twist.twist.linear.y', SLIP)
    for _ in range(REPEATS if long else 1):
        with closing(Harness(bench.nodes, module=ALTERED)) as harness:
            until_due(harness, MIDWAY)
            begin = time.monotonic()
            with harness.spoiling(*slipping):
                harness.spin(2.5 * STEP)
            raised = begin + 1.0 / RATE + STEP  # at the latest: the next odometry, the next tick
            late = max(0.0, harness.monitor.first_safe(begin) - raised) / STEP
            harness.until_planned()
            yield Outcome('raises', harness.monitor.broken(), late)
            begin = time.monotonic()
            with harness.spoiling(*slipping):
                code = _exit_code(harness)
            failure = '' if code == 1 else f'exit code {code} after many in a row'
            # Until odometry is stale, valid messages in transit may be answered.
            moving = harness.monitor.moving_again(begin + STALE, begin + 2 * STEP)
            unsafe = harness.monitor.broken() + moving
            yield Outcome('raises again and again', unsafe, failure=failure)


def _signalled(number: int) -> Any:
    """Return the cases of a signal: three safe commands must follow, and exit code 0."""

    def run(bench: Bench, long: bool) -> Iterator[Outcome]:
        for count in range(50 if long else 1):
            slow = SLOW if (count + number) % 2 else None
            with closing(Harness(bench.nodes, slow)) as harness:
                if count % 10 != 9:  # every tenth receives it at the start
                    harness.until_planned()
                else:  # but not before the first command, since then there is nothing to end
                    harness.until(harness.monitor.commands.copy, 'a command')
                harness.spin(harness.draw.uniform(0.0, STEP))
                yield _ended(harness, number, f'{signal.Signals(number).name} {count + 1}')

    return run


def _exit_code(harness: Harness) -> int | None:
    """Return the exit code of the planner; None if it has not ended."""
    harness.spin(PATIENCE, lambda: harness.planner.poll() is not None)
    return harness.planner.poll()


def _ended(harness: Harness, number: int, case: str) -> Outcome:
    def farewell() -> bool:
        last = harness.monitor.commands[-FAREWELLS:]
        return len(last) == FAREWELLS and all(each.safe for each in last)

    begin = time.monotonic()
    harness.planner.send_signal(number)
    code, took = _exit_code(harness), time.monotonic() - begin
    harness.spin(PATIENCE, farewell)
    failure = '' if code == 0 else f'exit code {code}'
    if not farewell():
        failure = f'{failure} no {FAREWELLS} safe commands at the end'.strip()
    return Outcome(case, harness.monitor.broken(), took, failure)


class Flying(Monitored):
    """The paper's retrieval in real time, five times as fast: planner and simulator."""

    def __init__(self, nodes: str) -> None:
        changes = [
            'clock=wall', 'step=0.2', 'forward=5.0', 'rope.frequency=0.5', 'weights.input=0.002',
            'max_ticks=400', 'odom_timeout=0.0', 'goal_timeout=0.0', 'goal_prediction=harmonic',
            'start.position=[-10.0, 0.0, 0.0]',
        ]  # fmt: skip
        values = settings.resolve(config('retrieval.yaml'), changes) | {'use_sim_time': False}
        super().__init__(nodes, values)
        self._odometry = self.listen(Odometry, 'odom')
        self._captured = self.listen(Bool, 'captured', LATCHED)
        self.launch('orbimpc_ros.sim', values)
        self.start()

    def until_moving(self) -> None:
        """Listen until the vehicle moves.

        Raises:
            OrbimpcError: it does not move.
        """
        heard = self._odometry
        self.until(lambda: heard and _place(heard[0]) != _place(heard[-1]), 'a vehicle that flies')

    def until_over(self) -> str:
        """Listen until the flight has ended, or is long overdue; return the failure, or ''."""
        self.spin(FLIGHT, lambda: bool(self._captured))
        return '' if self._captured and self._captured[-1].data else 'not caught'

    def stands(self) -> bool:
        """Return whether the vehicle is at rest three odometry messages from now."""
        enough = len(self._odometry) + 3
        self.spin(PATIENCE, lambda: len(self._odometry) >= enough)
        before, now = self._odometry[-2:]
        return _place(before) == _place(now) and abs(now.twist.twist.linear.x) <= STILL


def _place(message: Odometry) -> Point:
    return message.pose.pose.position


def _silenced(number: int, revive: Callable[[Flying], None]) -> Any:
    """Return the cases of a signal that silences a planner in flight until it is revived."""

    def run(bench: Bench, long: bool) -> Iterator[Outcome]:
        for count in range(20 if long else 1):
            with closing(Flying(bench.nodes)) as flying:
                flying.until_moving()
                flying.spin(flying.draw.uniform(0.5, 1.5))
                begin = time.monotonic()
                flying.planner.send_signal(number)
                reported = flying.until_first(complaint('stopped'), begin) - begin
                failure = '' if flying.stands() else 'the vehicle moves on'
                revive(flying)
                failure = flying.until_over() or failure
                case = f'{signal.Signals(number).name} {count + 1}'
                yield Outcome(case, flying.monitor.broken(), reported, failure)

    return run


FAULT_CASES = (
    FaultCase('deadline', 'no time to search: longest solve, or time missed', SLOWEST, _no_time),
    FaultCase('flood', 'odometry at 5 kHz: p99 from tick to tick, beyond the period', LATE, _flood,
              'ms'),
    FaultCase('soak', 'odometry at 1 kHz for long: growth of memory', GROWTH, _soak, 'MiB'),
    FaultCase('exceptions', 'exceptions in callbacks: safe, then given up', 1.0, _exceptions),
    FaultCase('sigint', 'SIGINT: three safe commands, exit 0', LEAVE, _signalled(signal.SIGINT),
              's'),
    FaultCase('sigterm', 'SIGTERM: three safe commands, exit 0', LEAVE, _signalled(signal.SIGTERM),
              's'),
    FaultCase('sigkill', 'planner killed: stopped; restarted: the rope is caught', LATCH,
              _silenced(signal.SIGKILL, Flying.start), 's'),
    FaultCase('hung', 'planner hangs for a while: stopped, then flies on', LATCH,
              _silenced(signal.SIGSTOP, lambda each: each.planner.send_signal(signal.SIGCONT)),
              's'),
)  # fmt: skip
