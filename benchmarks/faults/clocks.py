# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rows on a clock that stops or jumps, under simulated time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from benchmarks.faults import injection
from benchmarks.faults.fixtures import Fixtures
from benchmarks.faults.harness import STEP, Harness
from benchmarks.faults.injection import AFTER
from benchmarks.faults.outcome import FaultCase, Outcome

STALE = 0.3  # [s] odom_timeout
JUMPS = {'back 0.5 s': -0.5, 'back 900 s': -900.0, 'reset to 1 s': None, 'forward 600 s': 600.0}
TO_ONE = 1.0  # [s] what a reset clock begins at
SHORT = 2  # jumps that are tried in the short form


def _disturbed(
    harness: Harness, case: str, when: str, begin: Callable[[], None], wait: float
) -> Outcome:
    """Return how soon the planner is safe ``wait`` [s] after the clock is tampered with."""
    at = injection.inject(harness, when, begin)
    harness.spin(wait + STEP)
    safe = harness.until_first(harness.monitor.first_safe, at)
    harness.spin(AFTER * STEP)
    unsafe = harness.monitor.broken(at)
    return Outcome(f'{case}, {when}', unsafe, injection.reaction(safe, at + wait))


def _frozen(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    times = injection.TIMES[1:]
    for harness, when in injection.harnesses(fixtures, long, times, simulated=True):
        outcome = _disturbed(harness, 'frozen', when, harness.freeze, STALE)
        stale = harness.frozen_at + STALE
        moving = harness.monitor.moving_again(stale, stale + STEP)
        harness.thaw()
        outcome = replace(outcome, unsafe=outcome.unsafe + moving)
        yield injection.recovered(harness, outcome)


def _jumped(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    for case, jump in list(JUMPS.items())[: None if long else SHORT]:
        times = injection.TIMES[1:]
        found = injection.harnesses(fixtures, long, times, label=case, simulated=True)
        for harness, when in found:
            outcome = _disturbed(harness, case, when, _jumping(harness, jump), 0.0)
            yield injection.recovered(harness, outcome)


def _jumping(harness: Harness, jump: float | None) -> Callable[[], None]:
    """Return what makes the clock jump by a time, or back to one second."""

    def begin() -> None:
        by = TO_ONE - 1e-9 * harness.now if jump is None else jump
        harness.jump += max(by, TO_ONE - 1e-9 * harness.now)

    return begin


FAULT_CASES = (
    FaultCase('frozen', 'clock frozen: safe after odom_timeout', 1.0, _frozen),
    FaultCase('jumps', 'clock jumps or is reset', 1.0, _jumped),
)
