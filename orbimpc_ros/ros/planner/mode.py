# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The vehicle's mode, in which it takes commands or not: how often it has changed."""

from __future__ import annotations

from collections import deque

MANY = 4  # changes within a while, beyond which they are not a pilot's
WHILE = 1.0  # [s]


class ModeChanges:
    """Counts changes of the mode.

    Attributes:
        count: so far.
    """

    def __init__(self) -> None:
        self.count = 0
        self._recent: deque[float] = deque(maxlen=MANY)

    def note(self, now: float) -> None:
        """Note a change at ``now``, on the steady clock [s]."""
        self.count += 1
        self._recent.append(now)

    def restless(self, now: float) -> str:
        """Return that the mode changes all the time, in words; empty if it does not."""
        if len(self._recent) < MANY or now - self._recent[0] > WHILE:
            return ''
        return f'the mode has changed {MANY} times within {WHILE:g} s: each time from a fresh start'
