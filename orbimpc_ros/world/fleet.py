"""A fleet: vehicles in a ring that fly outwards, each after a rope of its own, from a seed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array, whole
from orbimpc_ros.world.rope import Rope

MOST = 64  # vehicles
RING = 1.5  # [m] from the middle to each start
AHEAD = (7.0, 9.0)  # [m] from a start to the middle of its swing
SWING = 0.5  # [m] reach of a rope along each axis
FREQUENCIES = (0.02, 0.3)  # [Hz]


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
