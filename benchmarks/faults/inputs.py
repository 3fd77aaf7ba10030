# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rows on inputs and clocks: none, too late, out of order, out of range; stopped, or reset."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from builtin_interfaces.msg import Time

from benchmarks.faults import injection, stimulus
from benchmarks.faults.harness import STEP, Fixtures, Harness
from benchmarks.faults.injection import AFTER, MIDWAY, SOLVING, START, Expected
from benchmarks.faults.outcome import FaultCase, Outcome
from benchmarks.faults.stimulus import HUGE, Spoiled, shifted, with_field
from orbimpc_ros.loop.planner import FALLBACK_TICKS

ODOMETRY = Expected(wait=0.3, allowed=1.0)  # odom_timeout: 1.5 steps
# goal_timeout of the harness, after which the last plan is flown on for two ticks at most.
GOAL = Expected(wait=0.4 + FALLBACK_TICKS * STEP, allowed=1.0)
HEALTH = 1.2  # [s] in which counts are reported
NAN, INF = math.nan, math.inf
BEYOND = (NAN, INF, -INF, 1e300)
STALE = 0.3  # [s] odom_timeout
JUMPS = {'back 0.5 s': -0.5, 'back 900 s': -900.0, 'reset to 1 s': None, 'forward 600 s': 600.0}
TO_ONE = 1.0  # [s] what a reset clock begins at
SHORT = 2  # jumps that are tried in the short form

STAMPS = {
    'future stamps': shifted(5.0, 1e6),
    'nanosec >= 1e9': with_field('header.stamp.nanosec', 10**9, 2**32 - 1),
    'sec < 0': with_field('header.stamp.sec', -1, -(2**31)),
    'the same stamp': None,  # made anew for every case: it remembers
}
NUMBERS = {
    'position': with_field('pose.pose.position.x', *BEYOND),
    'orientation': with_field('pose.pose.orientation.w', *BEYOND),
    'quaternion not unit': stimulus.scaled_quaternion('odometry'),
    'velocity': with_field('twist.twist.linear.x', *BEYOND),
    'rate': with_field('twist.twist.angular.z', *BEYOND),
    'frame': with_field('header.frame_id', 'map', '', 'x' * HUGE),
    'child frame': with_field('child_frame_id', 'map', '', '\x00' * HUGE),
}
GOALS = {
    'goal position': with_field('pose.position.y', *BEYOND),
    'goal orientation': with_field('pose.orientation.x', *BEYOND),
    'goal quaternion not unit': stimulus.scaled_quaternion('goal'),
    'goal frame': with_field('header.frame_id', 'map', 'x' * HUGE),
    'goal stamp in the future': shifted(5.0, 1e6),
    'goal stamp sec < 0': with_field('header.stamp.sec', -1),
}


def _stamps() -> list[Spoiled]:
    found = {name: spoil or stimulus.repeated() for name, spoil in STAMPS.items()}
    return [Spoiled(name, odometry=spoil) for name, spoil in found.items()]


def _contents() -> list[Spoiled]:
    odometry = [Spoiled(name, odometry=spoil) for name, spoil in NUMBERS.items()]
    return odometry + [Spoiled(name, goal=spoil) for name, spoil in GOALS.items()]


def _fault_case(
    name: str, title: str, variants: Callable[[], Sequence[Spoiled]], *short: str
) -> FaultCase:
    def run(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
        every = itertools.product(variants(), injection.TIMES)
        for spoiled, time in every if long else zip(itertools.cycle(variants()), short):
            expected = GOAL if spoiled.goal is not None else ODOMETRY
            for harness, when in injection.harnesses(fixtures, long, (time,), label=spoiled.name):
                yield injection.spoiling(harness, spoiled, when, expected)

    return FaultCase(name, title, 1.0, run)


def _unset(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """Odometry that loses its stamp: at the start it might be that of simulated time."""
    spoiled = Spoiled('stamps not set', odometry=with_field('header.stamp', Time()))
    for harness, when in injection.harnesses(fixtures, long, (MIDWAY, SOLVING), label='unset'):
        yield injection.spoiling(harness, spoiled, when, ODOMETRY)


def _mixed(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """Old messages and doubles among good ones: refused and counted, planned on all the same."""
    spoiled = Spoiled('old among new', stimulus.interleaved(), stimulus.interleaved())
    for harness, when in injection.harnesses(fixtures, long):
        expected = Expected(0.0, 5.0, strict=False)
        outcome = injection.spoiling(harness, spoiled, when, expected)
        harness.spin(HEALTH)
        yield Outcome(outcome.case, outcome.unsafe, math.nan, _uncounted(harness))


def _uncounted(harness: Harness) -> str:
    counted: dict[str, str] = {}
    for each in harness.monitor.health:
        counted |= each.values
    wanted = itertools.product(('odom', 'goal'), ('duplicate', 'reordered'))
    lacking = [
        f'{topic}: {what}'
        for topic, what in wanted
        if not any(topic in name and what in name for name in counted)
    ]
    return f'not counted: {", ".join(lacking)}' if lacking else ''


def _garbage() -> list[Spoiled]:
    odometry = Spoiled('no odometry message', odometry=stimulus.garbled)
    return [odometry, Spoiled('no goal message', goal=stimulus.garbled)]


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
    _fault_case(
        'odometry',
        'stale odometry',
        lambda: [Spoiled('no odometry', odometry=stimulus.lost)],
        MIDWAY,
        SOLVING,
    ),
    _fault_case('goal', 'stale goal', lambda: [Spoiled('no goal', goal=stimulus.lost)], MIDWAY),
    _fault_case('stamps', 'future, repeated, malformed stamps', _stamps, MIDWAY, SOLVING),
    FaultCase('unset', 'stamps that are not set, after good ones', 1.0, _unset),
    FaultCase('mixed', 'duplicates and older stamps among good ones', 1.0, _mixed),
    _fault_case('garbage', 'bytes that are no message', _garbage, MIDWAY),
    _fault_case(
        'contents', 'NaN, Inf, quaternions, frames, huge strings', _contents, START, MIDWAY, SOLVING
    ),
    FaultCase('frozen', 'clock frozen: safe after odom_timeout', 1.0, _frozen),
    FaultCase('jumps', 'clock jumps or is reset', 1.0, _jumped),
)
