# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The differences of two answers, how large they may be, and how they read."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.geometry.rotations import exp, to_quaternion
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.tool.replay.recording import Answer, published
from orbimpc_ros.tool.replay.resolving import ReplayedTick

# Solvers of other versions, and numba or not, find the same optimum up to these. An objective is
# flat there: it agrees better than the command that reaches it.
SPEED, RATE, ANGLE = 1e-4, 1e-3, 1e-3  # of full speed or thrust; [rad/s]; [rad]
OBJECTIVE, ROUNDING = 1e-6, 1e-7  # relative, and near zero
UNITS = {'speed': 'm/s', 'force': 'N', 'body_rate': 'rad/s', 'rotation': 'rad'}
PLANNED = Status.OPTIMAL, Status.FEASIBLE
WORDS, TURNS = ('status', 'fallback'), ('body_rate', 'rotation')
QUANTITIES = (*WORDS, 'speed', 'force', *TURNS, 'objective', 'gap')


class Comparison(NamedTuple):
    """One quantity of one tick, recorded and replayed."""

    tick: int  # its number
    time: float  # its stamp [s]
    quantity: str  # one of :data:`QUANTITIES`
    recorded: Any  # its value
    replayed: Any  # its value
    apart: float  # how far these are apart; infinite if one is missing or a word differs
    allowed: float  # how far they may be

    @property
    def differs(self) -> bool:
        """Return whether the values are further apart than allowed."""
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
        then, now = each.recorded.answer, published(each.messages)
        for quantity in QUANTITIES:
            before, after = then.get(quantity), now.get(quantity)
            if before is not None:
                apart = distance(quantity, before, after, settings.problem.step)
                allowed = tolerance(quantity, settings, then, now)
                time = each.recorded.stamp / SECOND
                yield Comparison(tick, time, quantity, before, after, apart, allowed)


def tolerance(quantity: str, settings: PlannerSettings, *answers: Answer) -> float:
    """Return what a quantity of some answers may differ by; words must be the same.

    But an exact proof is searched as long as there is time after the command, and no bound is
    published without: where there was none, gaps and ``optimal`` or ``feasible`` are not compared.
    Nor are two gaps that are both left open: where a search ends before its proof does, rounding
    decides which nodes came last.

    A plan gives attitudes as directions of thrust. The less thrust, the less it matters where it
    points, and the less exactly that is known: what a turn may differ by is divided by its share.
    """
    problem, least_gap = settings.problem, settings.gap_tolerance
    gaps = [each['gap'] for each in answers if each.get('gap') is not None]
    planned = all(each.get('status') in PLANNED for each in answers)
    proved = all(each.get('bound_checked', True) for each in answers)
    if quantity in ('status', 'gap') and planned and not proved:
        return math.inf
    if quantity == 'gap':
        left_open = len(gaps) == len(answers) and all(least_gap < gap < math.inf for gap in gaps)
        return math.inf if left_open else least_gap
    if quantity == 'objective':  # two searches may end at any plans within what they leave open
        return max(OBJECTIVE, min(max(gaps, default=0.0), least_gap))
    if quantity in TURNS:  # so many steps of the plan decide the command
        steps = slice(1, problem.rotation_order + 1)
        shares = itertools.chain(*(each.get('speed_fraction', [])[steps] for each in answers))
        least = min([1.0, *shares])
        allowed = RATE if quantity == 'body_rate' else ANGLE
        return allowed / least if least > 0.0 else math.inf
    full = {'speed': problem.forward, 'force': problem.forward * settings.mass}
    return SPEED * full.get(quantity, 0.0)


def distance(quantity: str, before: Any, now: Any, step: float) -> float:
    """Return how far two values of a quantity are apart; a step [s] is commanded at a time."""
    if now is None:
        return math.inf
    if quantity in WORDS:
        return 0.0 if before == now else math.inf
    if quantity == 'rotation':
        return _turned(before, now)
    if quantity == 'body_rate':
        # As turns: half a turn to the left is one to the right.
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
    """Return a value as text, to compare it by eye; arrays with so many digits."""
    if value is None:
        return 'none'
    if isinstance(value, str):
        return value or '-'
    if isinstance(value, (int, float)):
        return f'{value:.9g}'
    return '(' + ', '.join(f'{each:.{digits}g}' for each in value) + ')'
