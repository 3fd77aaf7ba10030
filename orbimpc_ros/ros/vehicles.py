# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A fleet in ROS's terms: a namespace for each vehicle, and what its simulator has of its own."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.sim.fleet import Member, crossing, members


def vehicles(count: int, seed: int = 0) -> dict[str, dict[str, Any]]:
    """Return the parameters in which the simulators of a fleet differ, by namespace: /uav1, ...

    Raises:
        BadInput: as :func:`orbimpc_ros.sim.fleet.members`.
    """
    return _named(members(count, seed), seed)


def crossers(count: int, seed: int = 0) -> dict[str, dict[str, Any]]:
    """Return the parameters of vehicles that cross over, as :func:`vehicles` does.

    Raises:
        BadInput: as :func:`orbimpc_ros.sim.fleet.crossing`.
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
