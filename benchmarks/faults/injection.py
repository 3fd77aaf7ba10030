# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Injection of faults into a running planner: moments of injection, and reactions."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from benchmarks.faults.harness import STEP, Bench, Harness
from benchmarks.faults.matrix import Outcome
from benchmarks.faults.monitor import Event, Monitor, complaint

START, MIDWAY, SOLVING = 'start', 'mid-run', 'during a solve'
RUNNING = (MIDWAY, SOLVING)
TIMES = (START, *RUNNING)
REPEATS = 3  # of each case in the long form
AFTER = 3  # ticks by which a fault outlasts the latest reaction
INTO = 0.03  # [s] from the start of a solve to an injection
# A search that lasts until its deadline, with a plan at hand: nearly constant speed, limited turns,
# and a gap that it cannot close.
SLOW = {
    'floor.shape': 'circle',
    'floor.fraction': 0.9,
    'horizon': 12,
    'weights.input': 0.0,
    'weights.length': 0.1,
    'gap_tolerance': 1e-9,
    'delay_compensation': False,  # which assumes obeyed commands; the stimulus ignores them
}


@dataclass(frozen=True)
class Fault:
    """A fault, and the reaction that it requires."""

    name: str  # of the fault
    imposed: Callable[[Harness], AbstractContextManager[Any]]  # for as long as the context
    # time after which no earlier plan may be flown: an input has become stale, and the plan that
    # is flown on has used up its ticks [s]
    wait: float = 0.0
    strict: bool = True  # whether the planner must be safe as long as the fault lasts
    event: Event = Monitor.first_safe  # the reaction
    times: Sequence[str] = TIMES  # moments of injection in the long form


def injecting(
    *faults: Fault, short: Sequence[str] = (MIDWAY,), simulated: bool = False
) -> Callable[[Bench, bool], Iterator[Outcome]]:
    """Return the cases of a row: faults that are injected into a running planner.

    Args:
        faults: to inject.
        short: moments of injection in the short form, which takes the faults in turns.
        simulated: whether the harness publishes the planner's clock as well.
    """

    def run(bench: Bench, long: bool) -> Iterator[Outcome]:
        every = [(fault, when) for fault in faults for when in fault.times]
        pairs = REPEATS * every if long else [*zip(itertools.cycle(faults), short)]
        for slow in ({}, SLOW):
            some = [pair for pair in pairs if (pair[1] == SOLVING) == bool(slow)]
            if some:
                with bench.lent(slow, simulated) as harness:
                    yield from (injected(harness, *pair) for pair in some)

    return run


def injected(harness: Harness, fault: Fault, when: str) -> Outcome:
    """Return the outcome of a fault; the planner is healthy again at the end.

    Raises:
        OrbimpcError: it does not recover.
    """
    late = math.nan
    if when == START:
        harness.planner.stop()
        harness.spin(0.1)
    else:
        until_due(harness, when)
    begin = time.monotonic()
    with fault.imposed(harness):
        if when == START:
            harness.start()
            waits = complaint('wait')
            harness.until(lambda: waits(harness.monitor, begin) < math.inf, 'its diagnostics')
        else:
            begin = time.monotonic()
        due = time.monotonic() + fault.wait
        harness.spin(due + STEP - time.monotonic())
        if when != START:
            late = max(0.0, harness.until_first(fault.event, begin) - due) / STEP
        harness.spin(AFTER * STEP)
        unsafe = harness.monitor.broken(begin)
        if fault.strict:
            unsafe += harness.monitor.moving_again(due, due + STEP)
            if when == START:  # there is no earlier plan to be flown
                unsafe += harness.monitor.moving(begin, due)
    harness.planner.require_health()
    harness.until_planned()
    return Outcome(f'{fault.name}, {when}', unsafe, late)


def until_due(harness: Harness, when: str) -> None:
    """Feed a healthy planner until the moment to inject a fault."""
    harness.until_planned()
    if when == SOLVING:
        heard = len(harness.monitor.ticks)
        harness.until(lambda: len(harness.monitor.ticks) > heard, 'a tick')
        tick = harness.monitor.ticks[-1]
        solve = 1e-3 * float(tick.values['solve_time_ms'])
        harness.spin(tick.at - solve + STEP + INTO - time.monotonic())
    else:
        harness.spin(harness.draw.uniform(0.0, STEP))
