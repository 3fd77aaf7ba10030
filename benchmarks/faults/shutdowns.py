# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rows on planners that end, by a signal or an exception, and that come back."""

from __future__ import annotations

import math
import random
import signal
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

from benchmarks.faults import injection
from benchmarks.faults.flights import LATCH, Flying
from benchmarks.faults.harness import PATIENCE, RATE, STEP, Fixtures, Harness
from benchmarks.faults.injection import SLOW
from benchmarks.faults.inputs import ODOMETRY
from benchmarks.faults.outcome import FaultCase, Outcome
from benchmarks.faults.stimulus import SLIP, Spoiled, with_field

FAREWELLS = 3  # safe commands at the end
LOOKED_AT = 3  # steps of a vehicle that should stand still
LEAVE = 5.0  # [s] in which a process must have ended


def _signalled(number: int) -> Any:
    """Return the cases of a signal: after it three safe commands, and exit code 0."""

    def run(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
        draw = random.Random(number)
        for count in range(50 if long else 1):
            slow = SLOW if (count + number) % 2 else None
            with fixtures.harness(slow, seed=count) as harness:
                if count % 10 != 9:  # every tenth receives it at the start
                    harness.until_planned()
                else:
                    harness.until(lambda: bool(harness.monitor.health), 'its diagnostics')
                harness.spin(draw.uniform(0.0, STEP))
                yield _ended(harness, number, f'{signal.Signals(number).name} {count + 1}')

    return run


def _ended(harness: Harness, number: int, case: str) -> Outcome:
    begin = time.monotonic()
    harness.planner.tell(number)
    harness.spin(PATIENCE, lambda: not harness.planner.running)
    code = harness.planner.wait(0.0)
    took = time.monotonic() - begin
    harness.spin(PATIENCE, lambda: _farewell(harness))
    farewell = _farewell(harness)
    failure = '' if code == 0 else f'exit code {code}'
    if not farewell:
        failure = f'{failure} no {FAREWELLS} safe commands at the end'.strip()
    return Outcome(case, harness.monitor.broken(), took, failure)


def _farewell(harness: Harness) -> bool:
    """Return whether the last commands that have arrived are safe ones."""
    last = harness.monitor.commands[-FAREWELLS:]
    return len(last) == FAREWELLS and all(each.safe for each in last)


def _exceptions(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """A controller that raises: one is survived, after five in a row the planner has to leave."""
    slipping = Spoiled('raises', odometry=with_field('twist.twist.linear.y', SLIP))
    for seed in injection.SEEDS if long else injection.SEEDS[:1]:
        with fixtures.harness(seed=seed, module='benchmarks.faults.failing') as harness:
            spoil = partial(setattr, harness, 'spoiled', slipping)
            begin = injection.inject(harness, injection.MIDWAY, spoil)
            harness.spin(2.5 * STEP)
            raised = begin + 1.0 / RATE + STEP  # at the latest: the next odometry, the next tick
            safe = injection.reaction(harness.monitor.first_safe(begin), raised)
            yield injection.recovered(harness, Outcome('raises', harness.monitor.broken(), safe))
            begin = injection.inject(harness, injection.MIDWAY, spoil)
            harness.spin(PATIENCE, lambda: not harness.planner.running)
            code = harness.planner.wait(0.0)
            failure = '' if code == 1 else f'exit code {code} after many in a row'
            stale = begin + ODOMETRY.wait  # until then, sound odometry on its way may be answered
            moving = harness.monitor.moving_again(stale, begin + 2 * STEP)
            unsafe = harness.monitor.broken() + moving
            yield Outcome('raises again and again', unsafe, math.nan, failure)


def _killed(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """The planner is killed in flight: the vehicle stops."""
    for number in range(20 if long else 1):
        with Flying(fixtures.place(), step=1.0 if number % 2 else 0.2, seed=number) as flying:
            yield _silenced(flying, signal.SIGKILL, f'killed {number + 1}')


def _hung(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """The planner hangs for a while, or its link is cut: the vehicle stops, and then flies on."""
    for number in range(6 if long else 1):
        with Flying(fixtures.place(), step=0.2, seed=number) as flying:
            outcome = _silenced(flying, signal.SIGSTOP, f'hung {number + 1}')
            flying.planner.tell(signal.SIGCONT)
            flying.until_over()
            lost = '' if flying.captured else 'not caught'
            unsafe = flying.monitor.broken()
            yield replace(outcome, unsafe=unsafe, failure=outcome.failure or lost)


def _silenced(flying: Flying, number: int, case: str) -> Outcome:
    """Silence a planner in flight by a signal; return whether the vehicle is stopped in time."""
    flying.until_moving()
    flying.spin(flying.draw.uniform(0.5, 1.5))
    begin = time.monotonic()
    flying.planner.tell(number)
    reported = flying.until_first(flying.monitor.first_complaint, begin, 'stopped') - begin
    flying.spin_steps(LOOKED_AT)
    failure = '' if flying.still else 'the vehicle moves on'
    return Outcome(case, flying.monitor.broken(), reported, failure)


def _restarted(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """The planner is killed at a random moment of the retrieval, and started again."""
    for number in range(20 if long else 1):
        with Flying(fixtures.place(), step=0.2, seed=number) as flying:
            flying.until_moving()
            flying.spin(flying.draw.uniform(0.0, flying.usual))
            flying.planner.tell(signal.SIGKILL)
            flying.planner.wait(LEAVE)
            flying.spin(flying.draw.uniform(0.0, 0.5))
            flying.start_planner()
            flying.until_over()
            failure = '' if flying.captured else 'not caught'
            yield Outcome(f'restarted {number + 1}', flying.monitor.broken(), math.nan, failure)


FAULT_CASES = (
    FaultCase('exceptions', 'exceptions in callbacks: safe, then given up', 1.0, _exceptions),
    FaultCase(
        'sigint', 'SIGINT: three safe commands, exit 0', LEAVE, _signalled(signal.SIGINT), 's'
    ),
    FaultCase(
        'sigterm', 'SIGTERM: three safe commands, exit 0', LEAVE, _signalled(signal.SIGTERM), 's'
    ),
    FaultCase('sigkill', 'planner killed: the vehicle is stopped', LATCH, _killed, 's'),
    FaultCase('hung', 'planner hangs for a while: stopped, then flies on', LATCH, _hung, 's'),
    FaultCase('restart', 'planner killed and restarted: the rope is caught', 0.0, _restarted),
)
