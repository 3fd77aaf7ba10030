"""Clocks that jump or stand still, and ticks that take too long or come too late."""

from __future__ import annotations

import statistics
from collections import deque

RECENT = 15  # ticks
LATE = 1.5  # steps from one tick to the next


class Drift:
    """Tells when a clock jumps, against a steady one."""

    def __init__(self) -> None:
        self._offset: tuple[float, float] | None = None

    def jump(self, before: float, clock: float, after: float) -> float:
        """Return by how much the clock has jumped at least since the last look [s].

        Args:
            before: on the steady clock, just before the other was read [s].
            clock: what the other showed [s].
            after: on the steady clock, just after [s].
        """
        low, high = clock - after, clock - before
        last_low, last_high = self._offset or (low, high)
        self._offset = low, high
        return max(low - last_high, 0.0) + min(high - last_low, 0.0)


class Standstill:
    """Tells for how long a clock has stood still."""

    def __init__(self) -> None:
        self._shown: int | None = None
        self._since = 0.0

    def lasted(self, shown: int | None, now: float) -> float:
        """Return how long a clock has shown the same [s]; ``now`` is of the steady clock [s]."""
        if shown != self._shown:
            self._shown, self._since = shown, now
        return now - self._since


class Timing:
    """How long ticks take.

    Attributes:
        misses: ticks that took longer than their deadline.
        overruns: ticks that took longer than a step.
        late: ticks of the timer that came late, whatever held them up.
    """

    def __init__(self) -> None:
        self.misses = self.overruns = self.late = 0
        self._recent: deque[float] = deque(maxlen=RECENT)
        self._last: float | None = None

    @property
    def expected(self) -> float:
        """Return how long a tick usually takes [s]."""
        return statistics.median(self._recent) if self._recent else 0.0

    def began(self, clock: float, step: float) -> None:
        """Note a tick of the timer, at a time of the timer's clock [s]."""
        if self._last is not None and clock - self._last > LATE * step:
            self.late += 1
        self._last = clock

    def took(self, duration: float, deadline: float, step: float) -> None:
        """Note how long a tick took, and how long it may and must not take [s]."""
        self._recent.append(duration)
        self.misses += duration > deadline
        self.overruns += duration > step
