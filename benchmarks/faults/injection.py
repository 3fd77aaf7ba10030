# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Injection of faults: the times at which they begin, and the reactions that follow."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from benchmarks.faults.harness import STEP, Fixtures, Harness
from benchmarks.faults.monitor import Monitor
from benchmarks.faults.outcome import Outcome
from benchmarks.faults.stimulus import Spoiled

START, MIDWAY, SOLVING = 'start', 'mid-run', 'during a solve'
TIMES = (START, MIDWAY, SOLVING)
SEEDS = (1, 2, 3)
AFTER = 3  # ticks that a fault lasts beyond the latest reaction
INTO = 0.03  # [s] of a solve
# A search that lasts until its deadline, with a plan at hand: nearly constant speed, limited turns,
# and a gap that it cannot close.
SLOW = {
    'floor.shape': 'circle',
    'floor.fraction': 0.9,
    'horizon': 12,
    'weights.input': 0.0,
    'weights.length': 0.1,
    'gap_tolerance': 1e-9,
    'delay_compensation': False,  # the stimulus does not obey commands: foreseen, it is no problem
}
HEALTHY = Spoiled('nothing')


@dataclass(frozen=True)
class Expected:
    """The reaction that a fault of the stimulus requires.

    Attributes:
        wait: until nothing that was planned may be flown: an input counts as stale, and the plan
            that outlives it has had its ticks [s].
        allowed: ticks after that.
        strict: whether the planner must be safe as long as the fault lasts.
    """

    wait: float
    allowed: float
    strict: bool = True


def harness_for(fixtures: Fixtures, when: str, *, simulated: bool = False) -> Harness:
    """Return a harness with a healthy planner, one that searches long if that matters."""
    name, parameters = ('slow', SLOW) if when == SOLVING else ('plain', {})
    clock = ', simulated time' if simulated else ''
    return fixtures.shared(name + clock, parameters, simulated=simulated)


def harnesses(
    fixtures: Fixtures,
    long: bool,
    times: Sequence[str] = (MIDWAY,),
    *,
    label: str = '',
    simulated: bool = False,
) -> Iterator[tuple[Harness, str]]:
    """Yield harnesses, their draws seeded anew, with the time at which to inject a fault.

    Args:
        fixtures: hand them out.
        long: whether to take every time and every seed, or the first of each.
        times: of injection.
        label: seeds the draws too, so that variants of a fault draw apart.
        simulated: whether the harness is the planner's clock as well.
    """
    for when in times if long else times[:1]:
        for seed in SEEDS if long else SEEDS[:1]:
            harness = harness_for(fixtures, when, simulated=simulated)
            harness.draw.seed(f'{label} {when} {seed}')
            yield harness, when


def inject(harness: Harness, when: str, begin: Callable[[], None]) -> float:
    """Make a healthy planner's fault begin and return when that was [s]."""
    until_due(harness, when)
    begin()
    return time.monotonic()


def until_due(harness: Harness, when: str) -> None:
    """Feed a healthy planner until a fault is to be injected."""
    harness.until_planned()
    if when == SOLVING:
        heard = len(harness.monitor.ticks)
        harness.until(lambda: len(harness.monitor.ticks) > heard, 'a tick')
        solved = harness.monitor.ticks[-1].at
        harness.spin(solved - 1e-3 * harness.monitor.solve_ms + STEP + INTO - time.monotonic())
    else:
        harness.spin(harness.draw.uniform(0.0, STEP))


def spoiling(harness: Harness, spoiled: Spoiled, when: str, expected: Expected) -> Outcome:
    """Spoil a planner's stimulus for a while and return the outcome; healthy again at the end."""
    if when == START:
        return _from_the_start(harness, spoiled, expected)
    begin = inject(harness, when, partial(setattr, harness, 'spoiled', spoiled))
    due = begin + expected.wait
    harness.spin(due + expected.allowed * STEP - time.monotonic())
    if expected.strict:
        harness.until_first(harness.monitor.first_safe, begin)
    harness.spin(AFTER * STEP)
    unsafe = unsafe_commands(harness.monitor, begin, expected)
    late = reaction(harness.monitor.first_safe(begin), due)
    return recovered(harness, Outcome(f'{spoiled.name}, {when}', unsafe, late))


def unsafe_commands(monitor: Monitor, begin: float, expected: Expected) -> int:
    """Return how many commands should not have been sent since a fault began [s]."""
    unsafe = monitor.broken(begin)
    if expected.strict:
        due = begin + expected.wait
        unsafe += monitor.moving_again(due, due + expected.allowed * STEP)
    return unsafe


def reaction(safe: float, due: float) -> float:
    """Return how many ticks after it was due something happened; 0 if before."""
    return max(0.0, (safe - due) / STEP)


def recovered(harness: Harness, outcome: Outcome) -> Outcome:
    """Return the outcome once the planner, healthy again, commands to move."""
    harness.spoiled = HEALTHY
    harness.planner.require_health()
    harness.until_planned()
    return outcome


def _from_the_start(harness: Harness, spoiled: Spoiled, expected: Expected) -> Outcome:
    harness.planner.stop()
    harness.spin(0.1)
    harness.spoiled, begin = spoiled, time.monotonic()
    harness.start()
    waits = partial(harness.monitor.first_complaint, begin, 'wait')
    harness.until(lambda: waits() < math.inf, 'its diagnostics')
    harness.spin(expected.wait + (expected.allowed + AFTER) * STEP)
    unsafe = harness.monitor.broken(begin)
    if expected.strict:
        unsafe += harness.monitor.moving(begin)
    return recovered(harness, Outcome(f'{spoiled.name}, {START}', unsafe))
