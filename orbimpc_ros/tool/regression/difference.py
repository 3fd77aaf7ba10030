"""How far two answers may be apart, and in which words that is told."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from orbimpc_ros.tool.regression.answer import Answer

# Solvers of other versions, and numba or not, find the same optimum up to these. An objective is
# flat there: it agrees better than the command that reaches it.
SPEED, RATE, ANGLE = 1e-4, 1e-3, 1e-3  # of full speed or thrust; [rad/s]; [rad]
OBJECTIVE, ROUNDING = 1e-6, 1e-7  # relative, and near zero


@dataclass(frozen=True)
class Tolerances:
    """What two answers may differ by; words must be the same.

    Attributes:
        speed: [m/s].
        force: [N].
        body_rate: [rad/s], about each axis.
        rotation: [rad].
        objective: relative.
        gap: absolute; what counts as proved.
    """

    speed: float = SPEED
    force: float = SPEED
    body_rate: float = RATE
    rotation: float = ANGLE
    objective: float = OBJECTIVE
    gap: float = 1e-4


UNITS = {'speed': 'm/s', 'force': 'N', 'body_rate': 'rad/s', 'rotation': 'rad'}
WORDS = ('status', 'fallback')
QUANTITIES = (*WORDS, *(field.name for field in fields(Tolerances)))


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
        before, now = getattr(recorded, quantity), getattr(replayed, quantity)
        if before is not None:
            allowed = getattr(tolerances, quantity, 0.0)
            apart = math.inf if now is None else float(_apart(quantity)(before, now))
            yield Comparison(tick, time, quantity, before, now, apart, allowed)


def _apart(quantity: str) -> Callable[[Any, Any], float]:
    if quantity in WORDS:
        return _words_apart
    return {'rotation': _turned, 'objective': _relative}.get(quantity, _absolute)


def _words_apart(before: str, now: str) -> float:
    return 0.0 if before == now else math.inf


def _absolute(before: Any, now: Any) -> float:
    """Return the largest difference of any number; two unknown ones (NaN) are the same."""
    first, second = np.asarray(before, dtype=float), np.asarray(now, dtype=float)
    if np.array_equal(first, second, equal_nan=True):
        return 0.0
    apart = np.abs(first - second)
    return math.inf if np.isnan(apart).any() else float(apart.max())


def _relative(before: float, now: float) -> float:
    apart = _absolute(before, now)
    return apart if apart in (0.0, math.inf) else apart / max(abs(before), ROUNDING / OBJECTIVE)


def _turned(before: Any, now: Any) -> float:
    """Return the angle between two quaternions [rad]; q and -q are the same rotation."""
    aligned = now if before @ now >= 0.0 else -now
    half = np.linalg.norm(before - aligned) / 2.0
    return 4.0 * math.asin(min(1.0, half)) if half == half else math.inf


def shown(value: Any) -> str:
    """Return a value as text, to compare it by eye."""
    if value is None:
        return 'none'
    if isinstance(value, str):
        return value or '-'
    if isinstance(value, float):
        return f'{value:.9g}'
    return '(' + ', '.join(f'{each:.6g}' for each in value) + ')'
