# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner's voice on the console: each trouble when it begins, seldom while it lasts."""

from __future__ import annotations

import re
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from orbimpc_ros.loop.controller import Tick
from orbimpc_ros.mpc.outcome import Fallback

FIRST, LONGEST = 10.0, 600.0  # [s] until the same is said again; doubled each time
KINDS = 256  # remembered: text may hold what a stranger sent
MANY = 5  # lines in a second, beyond which the rest is left to the counts on /diagnostics
NUMBER = re.compile(r'(?<![\w/])[-+]?\d+(\.\d+)?(e[-+]?\d+)?')


@dataclass
class _Said:
    """A line that was said: when, when it was last due, and how long it is not repeated [s]."""

    at: float
    due: float
    pause: float = FIRST


class Announcer:
    """Says lines on the console, and the same line at growing intervals only.

    Lines that differ in numbers alone are the same: an age, a distance, a count.

    Args:
        logger: of the node.
        now: the steady clock [s].
    """

    def __init__(self, logger: Any, now: Callable[[], float] = time.monotonic) -> None:
        self._logger, self._now = logger, now
        self._said: OrderedDict[str, _Said] = OrderedDict()
        self._recent: deque[float] = deque(maxlen=MANY)
        self._troubles: dict[str, str] = {}
        self._introduced = ''
        self._planning = self._begun = False

    def introduce(self, vehicle: str) -> None:
        """Say what vehicle the parameters describe, at the start and when that has changed."""
        if not self._introduced:
            self._logger.info(vehicle)
        elif vehicle != self._introduced:
            self.say(f'from now on {vehicle}')
        self._introduced = vehicle

    def note(self, tick: Tick) -> None:
        """Say what is wrong with a tick, and that planning begins or goes on."""
        if tick.reason:
            self.warn(': '.join(filter(None, (tick.fallback, tick.reason))))
        if tick.fallback is Fallback.SAFE_COMMAND:
            self._planning = False
        elif not tick.fallback and not self._planning:
            self.say('plans again' if self._begun else 'begins to plan')
            self._planning = self._begun = True

    def say(self, text: str) -> None:
        """Say how things are going."""
        if self._due(text):
            self._logger.info(text)

    def warn(self, text: str) -> None:
        """Say what is wrong."""
        if self._due(text):
            self._logger.warning(text)

    def follow(self, troubles: Iterable[str]) -> None:
        """Say which of the troubles of this moment are new or last long, and which are over."""
        current = {_kind(text): text for text in troubles if text}
        for text in current.values():
            self.warn(text)
        for kind, text in self._troubles.items():
            if kind not in current:
                self.say(f'over: {text}')
        self._troubles = current

    def _due(self, text: str) -> bool:
        now, kind = self._now(), _kind(text)
        said = self._said.get(kind)
        if said is not None:
            rested, said.due = now - said.due >= FIRST, now
            if not rested and now - said.at < said.pause:
                return False
        if len(self._recent) == MANY and now - self._recent[0] < 1.0:
            return False
        self._recent.append(now)
        repeated = said is not None and not rested
        pause = min(LONGEST, 2.0 * said.pause) if said is not None and repeated else FIRST
        self._said[kind] = _Said(now, now, pause)
        self._said.move_to_end(kind)
        if len(self._said) > KINDS:
            self._said.popitem(last=False)
        return True


def _kind(text: str) -> str:
    return NUMBER.sub('#', text)
