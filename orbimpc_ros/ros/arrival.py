"""How old a message is, by when it came and by its stamp, and stamps from the future."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, TypeVar

from orbimpc_ros.ros.messages import SECOND, Stamp

T = TypeVar('T')

COMPARABLE = 60.0  # [s] a source whose stamps are farther off goes by another clock than this node


@dataclass(frozen=True)
class RosTime:
    """What the node's ROS clock shows.

    Attributes:
        nanoseconds: the time [ns]; None if it is not known, as before simulated time starts.
        lag: by how much it may trail: simulated time moves only when a message says so [s].
    """

    nanoseconds: int | None = None
    lag: float = 0.0

    def since(self, stamp: int) -> float:
        """Return the time since a stamp [ns], negative before it [s]; NaN if it is not known."""
        if self.nanoseconds is None:
            return math.nan
        return (self.nanoseconds - stamp) / SECOND


UNKNOWN = RosTime()


@dataclass(frozen=True)
class Arrival(Generic[T]):
    """A message taken in.

    Attributes:
        stamp: the sender's.
        value: what it said.
        at: when it came, on the steady clock [s].
        timed: whether its stamp can be compared with the node's clock.
        run: how many messages of its source, itself the last, came one soon after another.
    """

    stamp: Stamp
    value: T
    at: float
    timed: bool = False
    run: int = 1

    def age(self, now: float, ros: RosTime = UNKNOWN) -> float:
        """Return how old it is [s]: by its arrival or its stamp, whichever makes it older."""
        return max(now - self.at, self.delay(ros))

    def delay(self, ros: RosTime) -> float:
        """Return how old it is by its stamp [s]; 0 where that cannot be told."""
        return max(0.0, ros.since(self.stamp.nanoseconds)) if self.timed else 0.0
