"""When a fault sets in, and how soon the planner is safe after that."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orbimpc_ros.lab.faults.fixtures import Lab
from orbimpc_ros.lab.faults.harness import STEP, Stand
from orbimpc_ros.lab.faults.monitor import Watch
from orbimpc_ros.lab.faults.outcome import Outcome
from orbimpc_ros.lab.faults.stimulus import Spoiled

START, MIDWAY, SOLVING = 'start', 'mid-run', 'during a solve'
ONSETS = (START, MIDWAY, SOLVING)
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
    'delay_compensation': False,  # the feed does not obey commands: foreseen, it is no problem
}
HEALTHY = Spoiled('nothing')


@dataclass(frozen=True)
class Expected:
    """What a fault of the feed must lead to.

    Attributes:
        wait: until an input counts as stale [s].
        allowed: ticks after that.
        strict: whether the planner must be safe as long as the fault lasts.
    """

    wait: float
    allowed: float
    strict: bool = True


def stand_for(lab: Lab, onset: str) -> Stand:
    """Return a stand with a healthy planner, one that searches long if that matters."""
    if onset == SOLVING:
        return lab.shared('slow', SLOW)
    return lab.shared('plain')


def set_in(stand: Stand, onset: str, begin: Callable[[], None]) -> float:
    """Make a healthy planner's fault begin and return when that was [s]."""
    stand.until_planned()
    if onset == SOLVING:
        heard = len(stand.watch.ticks)
        stand.until(lambda: len(stand.watch.ticks) > heard, 'a tick')
        solved = stand.watch.ticks[-1].at
        stand.spin(solved - 1e-3 * stand.watch.solve_ms + STEP + INTO - time.monotonic())
    else:
        stand.spin(stand.draw.uniform(0.0, STEP))
    begin()
    return time.monotonic()


def spoiling(stand: Stand, spoiled: Spoiled, onset: str, expected: Expected) -> Outcome:
    """Spoil a planner's feed for a while and return what came of it; healthy again at the end."""
    if onset == START:
        return _from_the_start(stand, spoiled, expected)
    begin = set_in(stand, onset, lambda: setattr(stand, 'spoiled', spoiled))
    due = begin + expected.wait
    stand.spin(due + expected.allowed * STEP - time.monotonic())
    if expected.strict:
        stand.spin_until_safe(begin)
    stand.spin(AFTER * STEP)
    unsafe = unsafe_commands(stand.watch, begin, expected)
    outcome = Outcome(
        f'{spoiled.name}, {onset}', unsafe, reaction(stand.watch.first_safe(begin), due)
    )
    return recovered(stand, outcome)


def unsafe_commands(watch: Watch, begin: float, expected: Expected) -> int:
    """Return how many commands should not have been sent since a fault began [s]."""
    unsafe = watch.broken(begin)
    if expected.strict:
        due = begin + expected.wait
        unsafe += watch.moving_again(due, due + expected.allowed * STEP)
    return unsafe


def reaction(safe: float, due: float) -> float:
    """Return how many ticks after it was due something happened; 0 if before."""
    return max(0.0, (safe - due) / STEP)


def recovered(stand: Stand, outcome: Outcome) -> Outcome:
    """Return the outcome once the planner, healthy again, commands to move."""
    stand.spoiled = HEALTHY
    stand.planner.require_health()
    stand.until_planned()
    return outcome


def _from_the_start(stand: Stand, spoiled: Spoiled, expected: Expected) -> Outcome:
    stand.planner.stop()
    stand.spin(0.1)
    stand.spoiled, begin = spoiled, time.monotonic()
    stand.start()
    stand.until(lambda: stand.watch.first_complaint(begin, 'wait') < math.inf, 'its diagnostics')
    stand.spin(expected.wait + (expected.allowed + AFTER) * STEP)
    unsafe = stand.watch.broken(begin)
    if expected.strict:
        unsafe += stand.watch.moving(begin)
    return recovered(stand, Outcome(f'{spoiled.name}, {START}', unsafe))


def cases(
    long: bool, variants: Sequence[Spoiled], short: Sequence[str]
) -> list[tuple[Spoiled, str, int]]:
    """Return variants with onsets and seeds: all of them, or one for each onset in ``short``."""
    if long:
        return [(each, onset, seed) for each in variants for onset in ONSETS for seed in SEEDS]
    return [(variants[i % len(variants)], onset, 1) for i, onset in enumerate(short)]
