"""The stamp under which a message is recorded: its own, unless that cannot be meant."""

from __future__ import annotations

import struct

SECOND = 1_000_000_000  # [ns]
STAMP_AT = 4  # after CDR's own four bytes, where a message begins with its stamp
STAMP_ELSEWHERE = {'std_msgs/msg/Bool': None, 'visualization_msgs/msg/MarkerArray': 8}
LEAP = 60 * SECOND  # further off, a stamp is believed once a second one says the same


class Stamps:
    """Stamps in the order in which messages come.

    Attributes:
        now: the last one that was believed [ns]; None before the first.
    """

    def __init__(self) -> None:
        self.now: int | None = None
        self._told: int | None = None

    def of(self, data: bytes, kind: str) -> int | None:
        """Return the stamp [ns] to record a message under; None before the first.

        Args:
            data: the message in CDR.
            kind: its type.
        """
        told, before = carried(data, kind), self._told
        if told is None:
            return self.now
        self._told = told
        near = (each for each in (self.now, before) if each is not None)
        if before is None or any(abs(told - each) <= LEAP for each in near):
            self.now = told
        return self.now


def carried(data: bytes, kind: str) -> int | None:
    """Return the stamp [ns] that a serialised message carries; None if it has none that is valid.

    Args:
        data: the message in CDR.
        kind: its type.
    """
    place = STAMP_ELSEWHERE.get(kind, STAMP_AT)
    if place is None or len(data) < place + 8:
        return None
    seconds, nanoseconds = struct.unpack_from('<iI' if data[1] & 1 else '>iI', data, place)
    return seconds * SECOND + nanoseconds if seconds >= 0 and nanoseconds < SECOND else None
