# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A sighting of the goal."""

from __future__ import annotations

from dataclasses import dataclass

from orbimpc_ros.mpc.arrays import Array, sealed


@dataclass(frozen=True)
class Sighting:
    """Where the goal was seen.

    Attributes:
        time: stamp [s].
        position: in the world frame, shape (n,) [m].
        attitude: of the goal, shape (n, n); None where it has none in the plane.
    """

    time: float
    position: Array
    attitude: Array | None = None

    def __post_init__(self) -> None:
        sealed(self.position)
