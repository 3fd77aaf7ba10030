# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bodies that are seen again and again under their names: where they are, and how they move."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from orbimpc_ros.loop.traffic.track import along, centre
from orbimpc_ros.mpc.arrays import Array, ByContent
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Ball, Box, Hazard

LATEST = 3  # sightings that a velocity is fitted to
MOST = 1000  # bodies remembered


@dataclass(frozen=True, eq=False)
class Seen(ByContent):
    """A sighting of a body.

    Attributes:
        name: by which the body is known again.
        time: when it was there [s].
        body: what it is and where.
        lifetime: after which it is gone unless it is seen again [s]; infinite if it stays.
    """

    name: str
    time: float
    body: Box | Ball
    lifetime: float = math.inf


class Bodies:
    """Bodies by name, each going straight on as its latest sightings say."""

    def __init__(self) -> None:
        self._tracks: dict[str, deque[Seen]] = {}

    def __len__(self) -> int:
        return len(self._tracks)

    def see(self, seen: Seen, fastest: float) -> str:
        """Take in a sighting; return what is odd about it, in words, or an empty string.

        A body that would have moved faster than ``fastest`` [m/s] is taken for a new one of the
        same name, which stands still until it is seen again. Another size keeps the velocity.

        Raises:
            BadInput: older than the one before; another place at the same time; too many bodies.
        """
        track, words = self._tracks.get(seen.name), ''
        if track is None:
            if len(self._tracks) >= MOST:
                raise BadInput('count', seen.name, f'one of {MOST} bodies')
        elif not _news(track[-1], seen):
            return ''
        else:
            speed = _speed(track[-1], seen)
            if speed > fastest:
                track = None
                words = f'{seen.name} jumped at {speed:.3g} m/s: taken for a new body at rest'
        if track is None:
            track = self._tracks[seen.name] = deque(maxlen=LATEST)
        track.append(seen)
        return words

    def remove(self, name: str) -> None:
        """Forget a body, if it is known."""
        self._tracks.pop(name, None)

    def clear(self) -> None:
        """Forget every body."""
        self._tracks.clear()

    def expire(self, at: float) -> None:
        """Forget the bodies whose lifetime is over at a time [s]."""
        over = [n for n, track in self._tracks.items() if at - track[-1].time > track[-1].lifetime]
        for name in over:
            del self._tracks[name]

    def hazards(self, at: float, unseen: float = 0.0) -> list[Hazard]:
        """Return the bodies that are there at a time [s], and where they go from then on.

        Args:
            at: the time [s].
            unseen: how fast one may be that was seen but once [m/s].
        """
        return [
            _hazard(track, at, unseen)
            for track in self._tracks.values()
            if at - track[-1].time <= track[-1].lifetime
        ]


def _news(last: Seen, seen: Seen) -> bool:
    """Return whether a sighting is a later one, not the last one again.

    Raises:
        BadInput: it is neither.
    """
    if seen.time > last.time:
        return True
    if seen.time < last.time:
        raise BadInput('reordered stamp', seen.time, f'after {last.time:g} s, the one before')
    if seen.body != last.body:
        raise BadInput('duplicate id', seen.name, 'one place at a time')
    return False


def _speed(last: Seen, seen: Seen) -> float:
    way = centre(seen.body) - centre(last.body)
    return float(np.linalg.norm(way)) / (seen.time - last.time)


def _velocity(track: deque[Seen]) -> Array:
    """Return the slope of the straight line that fits the sightings best, shape (n,) [m/s]."""
    places = np.array([centre(seen.body) for seen in track])
    times = np.array([seen.time for seen in track])
    past = times - times.mean()
    moved: Array = past @ places / (past @ past) if len(track) > 1 else 0.0 * places[0]
    return moved


def _hazard(track: deque[Seen], at: float, unseen: float) -> Hazard:
    last = track[-1]
    place, velocity = centre(last.body), _velocity(track)
    times, places = last.time + np.array([0.0, 1.0]), np.array([place, place + velocity])
    return replace(along(last.body, times, places, at), unsure=0.0 if len(track) > 1 else unseen)
