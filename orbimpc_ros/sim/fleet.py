# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Fleets from a seed: vehicles in a ring that fly outwards, each after a rope, or cross over."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbimpc_ros.loop.capture import closest_approach
from orbimpc_ros.mpc.arrays import Array, whole
from orbimpc_ros.sim.world import Rope, fixed

MOST = 64  # vehicles
RING = 1.5  # [m] from the middle to each start
AHEAD = (7.0, 9.0)  # [m] from a start to the middle of its swing
SWING = 0.5  # [m] reach of a rope along each axis
FREQUENCIES = (0.02, 0.3)  # [Hz]
ROOM = 3.0  # [m] along the ring that a crossing begins on, for each vehicle
LEAST_RING = 5.0  # [m]
ASTRAY = 0.5  # [m] that starts and goals of a crossing are off the ring, along each axis


@dataclass(frozen=True)
class Member:
    """One vehicle of a fleet in the plane, and what it is after.

    Attributes:
        position: where it starts, shape (2,) [m].
        heading: it starts with, counted from x [rad].
        rope: its goal.
    """

    position: Array
    heading: float
    rope: Rope


def members(count: int, seed: int = 0) -> tuple[Member, ...]:
    """Return the vehicles of a fleet: centres, frequencies and phases of their ropes are random.

    Args:
        count: how many, 1 to 64.
        seed: of everything random; the ropes of the first vehicles do not depend on ``count``.

    Raises:
        BadInput: fewer or more vehicles.
    """
    whole(count, 'vehicles', 1, MOST)
    return tuple(_member(2.0 * math.pi * i / count, i, seed) for i in range(count))


def crossing(count: int, seed: int = 0) -> tuple[Member, ...]:
    """Return vehicles in a ring, each with a goal at its other side: all ways lead to the middle.

    Raises:
        BadInput: as :func:`members`.
    """
    whole(count, 'vehicles', 1, MOST)
    ring = max(LEAST_RING, ROOM * count / (2.0 * math.pi))
    return tuple(_crosser(2.0 * math.pi * i / count, i, seed, ring) for i in range(count))


def _crosser(place: float, number: int, seed: int, ring: float) -> Member:
    rng = np.random.default_rng([seed, number])
    outwards = ring * np.array([math.cos(place), math.sin(place)])
    start, goal = rng.uniform(-ASTRAY, ASTRAY, (2, 2)) + np.array([outwards, -outwards])
    x, y = goal - start
    return Member(start, math.atan2(y, x), fixed(goal))


def vehicles(count: int, seed: int = 0) -> dict[str, dict[str, Any]]:
    """Return the parameters in which the simulators of a fleet differ, by namespace: /uav1, ...

    Raises:
        BadInput: as :func:`members`.
    """
    return _named(members(count, seed), seed)


def crossers(count: int, seed: int = 0) -> dict[str, dict[str, Any]]:
    """Return the parameters of vehicles that cross over, as :func:`vehicles` does.

    Raises:
        BadInput: as :func:`crossing`.
    """
    return _named(crossing(count, seed), seed)


def plans(namespaces: Iterable[str]) -> tuple[str, ...]:
    """Return the topics of the plans of vehicles in namespaces."""
    return tuple(f'{namespace}/plan' for namespace in namespaces)


def _named(fleet: Iterable[Member], seed: int) -> dict[str, dict[str, Any]]:
    found = enumerate(fleet, start=1)
    return {f'/uav{number}': _parameters(member, seed + number) for number, member in found}


def _parameters(member: Member, seed: int) -> dict[str, Any]:
    half = 0.5 * member.heading
    return {
        'rope.center': _triple(member.rope.center),
        'rope.amplitude': _triple(member.rope.amplitude),
        'rope.frequency': member.rope.frequency,
        'rope.phase': _triple(member.rope.phase),
        'start.position': _triple(member.position),
        'start.orientation': (0.0, 0.0, math.sin(half), math.cos(half)),
        'seed': seed % 2**31,
    }


def _triple(vector: Array) -> tuple[float, ...]:
    return (*vector.tolist(), 0.0)


def separations(tracks: Mapping[str, tuple[Array, Array]]) -> dict[tuple[str, str], float]:
    """Return the least distance of each pair while both fly [m]; infinite if they never do.

    Args:
        tracks: of each vehicle, increasing times, shape (K,) [s], and positions, shape (K, n) [m],
            between which it moves evenly.
    """
    pairs = itertools.combinations(tracks, 2)
    return {(one, other): _apart(tracks[one], tracks[other]) for one, other in pairs}


def _apart(one: tuple[Array, Array], other: tuple[Array, Array]) -> float:
    begin, end = max(one[0][0], other[0][0]), min(one[0][-1], other[0][-1])
    times = np.union1d(one[0], other[0])
    times = times[(times >= begin) & (times <= end)]
    ways = [
        np.column_stack([np.interp(times, stamps, column) for column in places.T])
        for stamps, places in (one, other)
    ]
    legs = (
        closest_approach((ways[0][k], ways[0][k + 1]), (ways[1][k], ways[1][k + 1]))[0]
        for k in range(len(times) - 1)
    )
    return min(legs, default=math.inf)


def _member(heading: float, number: int, seed: int) -> Member:
    rng = np.random.default_rng([seed, number])
    outwards = np.array([math.cos(heading), math.sin(heading)])
    rope = Rope(
        center=(RING + rng.uniform(*AHEAD)) * outwards,
        amplitude=np.array([SWING, SWING]),
        frequency=float(rng.uniform(*FREQUENCIES)),
        phase=rng.uniform(0.0, 2.0 * math.pi, size=2),
    )
    return Member(RING * outwards, heading, rope)
