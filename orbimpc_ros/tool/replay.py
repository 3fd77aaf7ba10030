# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc replay``: solve a bag's inputs again, tick by tick, and compare with its outputs."""

from __future__ import annotations

import itertools
import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.geometry.rotations import exp, to_quaternion
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.tool import history
from orbimpc_ros.tool.recording import CLOCK, Answer, ReplayedTick, recording_of, replayed

LINES = 20  # differences printed individually
# Solver versions, with and without numba, agree on an optimum within these tolerances. The
# objective is flat at its optimum: it agrees more closely than the command that attains it.
SPEED, RATE, ANGLE = 1e-4, 1e-3, 1e-3  # of full speed or thrust; [rad/s]; [rad]
OBJECTIVE, ROUNDING = 1e-6, 1e-7  # relative; absolute near zero
UNITS = {'speed': 'm/s', 'force': 'N', 'body_rate': 'rad/s', 'rotation': 'rad'}
PLANNED = Status.OPTIMAL, Status.FEASIBLE
WORDS, TURNS = ('status', 'fallback'), ('body_rate', 'rotation')
QUANTITIES = (*WORDS, 'speed', 'force', *TURNS, 'objective', 'gap')


def run(
    bag: str, params: str | None, changes: Sequence[str], tick: int | None, namespace: str
) -> int:
    """Replay a bag and report differences; return 0 if all are within the tolerances."""
    begun, path = time.perf_counter(), Path(bag)
    recording = recording_of(path, namespace, params, changes, tick)
    answers = list(replayed(recording))
    found = list(compared(answers, recording.settings))
    if tick is not None:
        found = [each for each in found if each.tick == tick]
        _show(answers[-1], found)
    else:
        received = sum(each.topic != CLOCK for each in recording.inputs)
        inputs = f'{received}, {sum(len(each.refusals) for each in answers)} refused'
        took = f'in {time.perf_counter() - begun:.2f} s'
        _sum_up(f'{len(answers)} ticks of {path} {took}', inputs, found)
    return int(any(each.differs for each in found))


def _sum_up(replayed: str, inputs: str, found: Sequence[Comparison]) -> None:
    """Print the first differences, and a summary by quantity."""
    differences = [each for each in found if each.differs]
    for each in differences[:LINES]:
        print(each)
    if len(differences) > LINES:
        print(f'... and {len(differences) - LINES} more')
    worst = {each.quantity: each for each in sorted(differences, key=lambda each: each.apart)}
    ticks = len({each.tick for each in differences})
    parts = ', '.join(f'{name} at tick {each.tick}' for name, each in worst.items())
    counts = Counter(each.quantity for each in found)
    rows = {
        'replayed': replayed,
        'inputs': inputs,
        'compared': ', '.join(f'{n} {quantity}' for quantity, n in counts.items()),
        'differences': f'{len(differences)} in {ticks} ticks; worst {parts}' if worst else 'none',
    }
    print(history.lines(rows))


def _show(tick: ReplayedTick, found: Sequence[Comparison]) -> None:
    """Print one tick, recorded and replayed side by side."""
    title = f'tick {found[0].tick} at {found[0].time:.3f} s'
    width = max(20, len(title) + 2)  # of a date more than of simulated time
    print(f'{title:<{width}}{"recorded":<26}replayed')
    for each in found:
        unit = f' [{UNITS[each.quantity]}]' if each.quantity in UNITS else ''
        mark = '  differs' if each.differs else ''
        pair = f'{shown(each.recorded, 4):<26}{shown(each.replayed, 4)}'
        print(f'{each.quantity + unit:<{width}}{pair}{mark}')
    reasons = [each.get('reason', '') for each in (tick.recorded.answer, tick.answer)]
    if any(reasons):
        print('recorded      {}\nreplayed      {}'.format(*map(shown, reasons)))
    for refusal in tick.refusals:
        print(refusal)


# --- differences, and how large they may be


class Comparison(NamedTuple):
    """One quantity of one tick, recorded and replayed."""

    tick: int  # its number
    time: float  # its stamp [s]
    quantity: str  # one of :data:`QUANTITIES`
    recorded: Any  # its value
    replayed: Any  # its value
    apart: float  # distance of the values; infinite if one is missing or words differ
    allowed: float  # largest distance allowed

    @property
    def differs(self) -> bool:
        """Return whether the distance exceeds what is allowed."""
        return not self.apart <= self.allowed

    def __str__(self) -> str:
        unit = UNITS.get(self.quantity, '')
        values = f'{shown(self.recorded)} -> {shown(self.replayed)} {unit}'.rstrip()
        off = f': off by {self.apart:.2g}, allowed {self.allowed:.2g}'
        where = f'tick {self.tick} at {self.time:.3f} s: {self.quantity} {values}'
        return where + (off if math.isfinite(self.apart) else '')


def compared(replayed: Sequence[ReplayedTick], settings: PlannerSettings) -> Iterator[Comparison]:
    """Yield the comparisons of all ticks: one for every quantity that was recorded."""
    for tick, each in enumerate(replayed):
        then, now = each.recorded.answer, each.answer
        for quantity in QUANTITIES:
            before, after = then.get(quantity), now.get(quantity)
            if before is not None:
                apart = distance(quantity, before, after, settings.problem.step)
                allowed = tolerance(quantity, settings, then, now)
                time = each.recorded.stamp / SECOND
                yield Comparison(tick, time, quantity, before, after, apart, allowed)


def tolerance(quantity: str, settings: PlannerSettings, *answers: Answer) -> float:
    """Return the tolerance of a quantity between answers; words must be equal.

    Exact proofs use the time left after the command, and a bound without one is not published:
    unless both answers have one, gaps and ``optimal`` versus ``feasible`` are not compared. Nor
    are two gaps that both remain open: if a search ends before its proof is complete, rounding
    decides which nodes were explored last. If two gaps agree within their tolerance, on both sides
    of that of ``optimal``, so do the statuses.

    A plan determines attitude as a direction of thrust. The smaller the thrust, the less its
    direction matters, and the less precise it is: a turn's tolerance is divided by the share.
    """
    problem, least_gap = settings.problem, settings.gap_tolerance
    gaps = [each['gap'] for each in answers if each.get('gap') is not None]
    planned = all(each.get('status') in PLANNED for each in answers)
    proved = all(each.get('bound_checked', True) for each in answers)
    if quantity in ('status', 'gap') and planned and not proved:
        return math.inf
    known = len(gaps) == len(answers)
    if quantity == 'status' and planned and known:
        at_the_limit = min(gaps) <= least_gap < max(gaps) <= min(gaps) + least_gap
        return math.inf if at_the_limit else 0.0
    if quantity == 'gap':
        left_open = known and all(least_gap < gap < math.inf for gap in gaps)
        return math.inf if left_open else least_gap
    if quantity == 'objective':  # searches may end at different plans within their gaps
        return max(OBJECTIVE, min(max(gaps, default=0.0), least_gap))
    if quantity in TURNS:  # the command depends on these steps of the plan
        steps = slice(1, problem.rotation_order + 1)
        shares = itertools.chain(*(each.get('speed_fraction', [])[steps] for each in answers))
        least = min([1.0, *shares])
        allowed = RATE if quantity == 'body_rate' else ANGLE
        return allowed / least if least > 0.0 else math.inf
    full = {'speed': problem.forward, 'force': problem.forward * settings.mass}
    return SPEED * full.get(quantity, 0.0)


@np.errstate(all='ignore')  # recorded numbers may be of any size
def distance(quantity: str, before: Any, now: Any, step: float) -> float:
    """Return the distance between two values of a quantity; body rates are held for a step [s]."""
    if now is None:
        return math.inf
    if quantity in WORDS:
        return 0.0 if before == now else math.inf
    if quantity == 'rotation':
        return _turned(before, now)
    if quantity == 'body_rate':
        # Compared as rotations: half a turn to the left equals half a turn to the right.
        return _turned(*(to_quaternion(exp(step * rate)) for rate in (before, now))) / step
    if before == now or (math.isnan(before) and math.isnan(now)):  # both infinite, or unknown
        return 0.0
    scale = max(abs(before), ROUNDING / OBJECTIVE) if quantity == 'objective' else 1.0
    apart = abs(before - now) / scale
    return math.inf if math.isnan(apart) else apart


def _turned(before: Any, now: Any) -> float:
    """Return the angle between two quaternions [rad]; q and -q are the same rotation."""
    aligned = now if before @ now >= 0.0 else -now
    half = float(np.linalg.norm(before - aligned)) / 2.0
    return math.inf if math.isnan(half) else 4.0 * math.asin(min(1.0, half))


def shown(value: Any, digits: int = 6) -> str:
    """Return a value as text for comparison by eye; arrays with the given number of digits."""
    if value is None:
        return 'none'
    if isinstance(value, str):
        return value or '-'
    if isinstance(value, (int, float)):
        return f'{value:.9g}'
    return '(' + ', '.join(f'{each:.{digits}g}' for each in value) + ')'
