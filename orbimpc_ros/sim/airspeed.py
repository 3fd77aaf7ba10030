# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The airspeeds of a flight: how slow it became, and how often it stalled."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from orbimpc_ros.sim.vehicle import Vehicle

ROUNDING = 1e-6  # of the stall speed


@dataclass(frozen=True)
class Airspeeds:
    """What airspeeds there were so far.

    Attributes:
        stall_speed: below which a vehicle has stalled [m/s]; 0 for none.
        least: [m/s]; infinite before anything was seen.
        stalls: how often it fell below the stall speed.
        stalled: whether it was below when last seen.
    """

    stall_speed: float
    least: float = math.inf
    stalls: int = 0
    stalled: bool = False

    def seeing(self, vehicles: Iterable[Vehicle]) -> Airspeeds:
        """Return the record once these, in order of time, are seen as well."""
        seen = self
        for vehicle in vehicles:
            speed = vehicle.airspeed
            stalled = speed < self.stall_speed * (1.0 - ROUNDING)
            stalls = seen.stalls + (stalled and not seen.stalled)
            seen = replace(seen, least=min(seen.least, speed), stalls=stalls, stalled=stalled)
        return seen
