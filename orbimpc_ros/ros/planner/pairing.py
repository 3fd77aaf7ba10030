"""Which sources of the goal belong to the odometry: those that stamp every message like it."""

from __future__ import annotations

from collections import deque

WINDOW = 10  # odometry messages; one of so many may lack its goal


class Pairing:
    """Learns from stamps whether a source accompanies every odometry message.

    A source in lock-step does so from its first message on. One that merely shares the driver's
    clock, yet is slower, shares some stamps: whoever waited for it would answer at its pace.
    """

    def __init__(self) -> None:
        self._shared: deque[bool] = deque(maxlen=WINDOW)

    def note(self, shared: bool) -> None:
        """Note whether the source shared the stamp of an odometry message, now that it is over."""
        if shared or self._shared:
            self._shared.append(shared)

    @property
    def constant(self) -> bool:
        """Return whether the source has so far accompanied every message, but for rare losses."""
        lost = self._shared.count(False)
        return bool(self._shared) and WINDOW * lost <= len(self._shared)
