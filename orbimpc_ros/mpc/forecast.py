"""Where the goal will be, from where it was seen: the targets g_1..g_N of a plan."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.errors import BadInput


@dataclass(frozen=True)
class Sighting:
    """Where the goal was seen.

    Attributes:
        time: stamp [s].
        position: in the world frame, shape (n,) [m].
    """

    time: float
    position: Array

    def __post_init__(self) -> None:
        sealed(self.position)


class Forecast(Protocol):
    """Predicts a goal from its sightings."""

    def observe(self, sighting: Sighting) -> None:
        """Take in a sighting; sightings come in order of time."""

    def at(self, times: Array) -> Array:
        """Return where the goal will be at ``times``, shape (N,) [s], as shape (N, n) [m]."""

    def reset(self) -> None:
        """Forget every sighting."""


@dataclass
class Hold:
    """The paper's forecast: the goal stays where it was seen last."""

    last: Sighting | None = field(default=None, init=False)

    def observe(self, sighting: Sighting) -> None:
        """Take in a sighting."""
        self.last = sighting

    def at(self, times: Array) -> Array:
        """Return the last position seen, once per time."""
        assert self.last is not None
        return np.tile(self.last.position, (len(times), 1))

    def reset(self) -> None:
        """Forget every sighting."""
        self.last = None


FORECASTS: dict[str, type[Forecast]] = {'hold': Hold}


def forecast_named(kind: str) -> Forecast:
    """Return a fresh forecast of a kind.

    Raises:
        BadInput: no such kind.
    """
    if kind not in FORECASTS:
        raise BadInput('goal_prediction', kind, ' | '.join(FORECASTS))
    return FORECASTS[kind]()


@dataclass(frozen=True)
class Itinerary:
    """A forecast that somebody else made: stamped future positions, interpolated in between.

    Attributes:
        times: increasing stamps, shape (M,) [s].
        positions: shape (M, n) [m].
    """

    times: Array
    positions: Array

    def __post_init__(self) -> None:
        if len(self.times) == 0 or np.any(np.diff(self.times) <= 0.0):
            raise BadInput('goal_path stamps', self.times.tolist(), 'one or more, increasing')
        sealed(self.times)
        sealed(self.positions)

    def at(self, times: Array) -> Array:
        """Return the positions at ``times``, shape (N, n); the ends are held beyond the ends."""
        return np.column_stack(
            [np.interp(times, self.times, column) for column in self.positions.T]
        )
