# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The differences of two answers, how large they may be, and how they read."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

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
PROVED = 'status', 'gap'
WORDS, TURNS = ('status', 'fallback'), ('body_rate', 'rotation')
QUANTITIES = (*WORDS, 'speed', 'force', *TURNS, 'objective', 'gap')


@dataclass(frozen=True)
class Tolerances:
    """What two answers may differ by; words must be the same.

    But an exact proof is searched as long as there is time after the command, and no bound is
    published without: where there was none, gaps and ``optimal`` or ``feasible`` are not compared.

    A plan gives attitudes as directions of thrust. The less thrust, the less it matters where it
    points, and the less exactly that is known: what a turn may differ by is divided by its share.

    Attributes:
        speed: [m/s].
        force: [N].
        gap: absolute; what counts as proved. Two that are both left open are not compared: where a
            search ends before its proof does, rounding decides which nodes came last.
        step: for which a body rate is commanded [s].
        order: of the rotation, 1 or 2: so many steps of the plan decide the command.
    """

    speed: float = SPEED
    force: float = SPEED
    gap: float = 1e-4
    step: float = 1.0
    order: int = 1

    @classmethod
    def under(cls, settings: PlannerSettings) -> Tolerances:
        """Return what a planner's answers may differ by."""
        problem = settings.problem
        return cls(
            speed=SPEED * problem.forward,
            force=SPEED * problem.forward * settings.mass,
            gap=settings.gap_tolerance,
            step=problem.step,
            order=problem.rotation_order,
        )

    def of(self, quantity: str, *answers: Answer) -> float:
        """Return what a quantity of some answers may differ by."""
        gaps = [each['gap'] for each in answers if each.get('gap') is not None]
        unproved = not all(each.get('bound_checked', True) for each in answers)
        planned = all(each.get('status') in PLANNED for each in answers)
        if quantity in PROVED and unproved and planned:
            return math.inf
        if quantity == 'gap':
            open_ = len(gaps) == len(answers) and all(self.gap < gap < math.inf for gap in gaps)
            return math.inf if open_ else self.gap
        if quantity == 'objective':  # two searches may end at any plans within what they leave open
            return max(OBJECTIVE, min(max(gaps, default=0.0), self.gap))
        if quantity in TURNS:
            parts = (each.get('speed_fraction', [])[1 : self.order + 1] for each in answers)
            least = min([1.0, *itertools.chain(*parts)])
            allowed = RATE if quantity == 'body_rate' else ANGLE
            return allowed / least if least > 0.0 else math.inf
        return float(getattr(self, quantity, 0.0))


@dataclass(frozen=True)
class Comparison:
    """One quantity of one tick, recorded and replayed.

    Attributes:
        tick: its number.
        time: its stamp [s].
        quantity: one of :data:`QUANTITIES`.
        recorded: its value.
        replayed: its value.
        apart: how far these are apart; infinite if one is missing or a word differs.
        allowed: how far they may be.
    """

    tick: int
    time: float
    quantity: str
    recorded: Any
    replayed: Any
    apart: float
    allowed: float

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


def compared(replayed: Sequence[ReplayedTick], settings: PlannerSettings) -> list[Comparison]:
    """Return the comparisons of all ticks."""
    tolerances, found = Tolerances.under(settings), list[Comparison]()
    for tick, each in enumerate(replayed):
        then, now = each.recorded, published(each.messages)
        found += comparisons(tick, then.stamp / SECOND, then.answer, now, tolerances)
    return found


def comparisons(
    tick: int, time: float, recorded: Answer, replayed: Answer, tolerances: Tolerances
) -> Iterator[Comparison]:
    """Yield a comparison for every quantity that was recorded.

    Args:
        tick: its number.
        time: its stamp [s].
        recorded: the answer in the bag.
        replayed: the answer now.
        tolerances: what they may differ by.
    """
    for quantity in QUANTITIES:
        before, now = recorded.get(quantity), replayed.get(quantity)
        if before is not None:
            allowed = tolerances.of(quantity, recorded, replayed)
            apart = math.inf if now is None else _apart(quantity, before, now, tolerances.step)
            yield Comparison(tick, time, quantity, before, now, apart, allowed)


def _apart(quantity: str, before: Any, now: Any, step: float) -> float:
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
