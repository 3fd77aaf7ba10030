# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What is known of trajectories in a part of a split."""

from __future__ import annotations

from fractions import Fraction
from typing import NamedTuple

from .exact import Vector
from .motion import Place


class Sector(NamedTuple):
    """Directions from ``low`` to ``high`` [rad]."""

    low: Fraction
    high: Fraction


class Speeds(NamedTuple):
    """Shares of full speed from ``low`` to ``high``."""

    low: Fraction
    high: Fraction


class Side(NamedTuple):
    """What is known of where a vehicle is: normal . place is at least so much."""

    place: Place
    normal: Vector
    least: Fraction


class Region(NamedTuple):
    """What is known in a part of a split: a face or a sector of each step, None if neither.

    And how fast it is; and of positions, beside the bodies that tell the parts apart.
    """

    faces: tuple[int | None, ...]
    sectors: tuple[Sector | None, ...]
    speeds: tuple[Speeds, ...]
    rows: tuple[Side, ...] = ()
    passed: tuple[tuple[int, int, Sector], ...] = ()  # discs, at which step, and on which side
