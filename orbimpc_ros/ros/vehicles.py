"""A fleet in ROS's terms: a namespace for each vehicle, and what its simulator has of its own."""

from __future__ import annotations

import math
from typing import Any

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.world.fleet import Member, members


def vehicles(count: int, seed: int = 0) -> dict[str, dict[str, Any]]:
    """Return the parameters in which the simulators of a fleet differ, by namespace: /uav1, ...

    Raises:
        BadInput: as :func:`orbimpc_ros.world.fleet.members`.
    """
    found = enumerate(members(count, seed), start=1)
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
