# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rows on plans that cannot be made: no way out, no time, a goal that leaps."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from benchmarks.faults import injection
from benchmarks.faults.harness import STEP, Fixtures, Harness
from benchmarks.faults.injection import AFTER
from benchmarks.faults.outcome import FaultCase, Outcome
from benchmarks.faults.stimulus import Spoiled
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.mpc.outcome import Fallback

WALLED_IN = [-50.0, -50.0, 50.0, 50.0]  # everywhere is inside of this box
ELSEWHERE = [10.0, 10.0, 11.0, 11.0]  # a box off the circle
LADDER = 2.0  # ticks that a shifted plan may stand in, and none more
HALF = 0.5  # of a step is what a solve may take
TIMES = (injection.MIDWAY, injection.SOLVING)
BUSY = 0.25  # of a step on top: a machine that is busy with other things


def set_live(harness: Harness, **values: Any) -> None:
    """Set parameters of a running planner.

    Raises:
        OrbimpcError: they are refused.
    """
    if refusals := harness.set_parameters(values):
        raise OrbimpcError(f'refused: {refusals}')


def _infeasible(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """A box grows around the vehicle: no plan is left, the fallback ladder has to end."""
    for harness, when in injection.harnesses(fixtures, long, TIMES):
        begin = injection.inject(harness, when, partial(set_live, harness, obstacles=WALLED_IN))
        harness.spin((LADDER + 1 + AFTER) * STEP)
        ladder = begin + LADDER * STEP
        again = harness.monitor.moving_again(ladder, ladder + STEP)
        unsafe = harness.monitor.broken(begin) + again
        reaction = injection.reaction(harness.monitor.first_safe(begin), begin)
        reported = any(tick.at >= begin and Fallback.SAFE_COMMAND in tick.values['fallback']
                       for tick in harness.monitor.ticks)  # fmt: skip
        set_live(harness, obstacles=ELSEWHERE)
        failure = '' if reported else 'no reason on tick'
        yield injection.recovered(harness, Outcome(f'walled in, {when}', unsafe, reaction, failure))


def _no_time(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """Searches that cannot end: every tick has its command all the same."""
    for deadline in (0.001, 0.02, 0.05, 0.1) if long else (0.001, 0.1):
        harness = injection.harness_for(fixtures, injection.SOLVING)
        set_live(harness, deadline=0.0)
        harness.until_planned()
        set_live(harness, deadline=deadline)
        begin = time.monotonic()
        harness.spin(10 * STEP)
        unsafe = harness.monitor.broken(begin)
        yield Outcome(f'deadline {deadline:g} s', unsafe, _late(harness, begin))
    set_live(harness, deadline=0.0)


def _late(harness: Harness, since: float) -> float:
    """Return the longest solve, or what the longest gap between ticks had too much, in ticks."""
    ticks = [tick for tick in harness.monitor.ticks if tick.at >= since]
    if len(ticks) < 2:
        return math.inf
    gap = max(later.at - tick.at for tick, later in itertools.pairwise(ticks))
    slowest = 1e-3 * max(float(tick.values['solve_time_ms']) for tick in ticks)
    return max(slowest / STEP, gap / STEP - 1.0)


def _leaping(distance: float) -> Callable[..., list[Any]]:
    """Return what moves a goal by ``distance`` [m] in a random direction."""

    def spoil(message: Any, draw: Any) -> list[Any]:
        angle = draw.uniform(0.0, 2.0 * math.pi)
        message.pose.position.x += distance * math.cos(angle)
        message.pose.position.y += distance * math.sin(angle)
        return [message]

    return spoil


def _leaps(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """A goal that is somewhere else at every sighting: refused or clamped, and reported."""
    for distance in (30.0, 1e3, 1e6) if long else (1e6,):
        spoiled = Spoiled(f'goal leaps {distance:g} m', goal=_leaping(distance))
        for harness, when in injection.harnesses(fixtures, long, TIMES, label=spoiled.name):
            begin = injection.inject(harness, when, partial(setattr, harness, 'spoiled', spoiled))
            reported = harness.until_first(harness.monitor.first_complaint, begin, 'goal')
            reaction = injection.reaction(reported, begin)
            outcome = Outcome(f'{spoiled.name}, {when}', harness.monitor.broken(begin), reaction)
            yield injection.recovered(harness, outcome)


FAULT_CASES = (
    FaultCase('leaps', 'goal teleports, out of reach: refused and reported', 1.2 / STEP, _leaps),
    FaultCase('infeasible', 'no plan: shifted plan, then safe', LADDER + 1.0, _infeasible),
    FaultCase(
        'deadline', 'no time to search: longest solve, or time missed', HALF + BUSY, _no_time
    ),
)
