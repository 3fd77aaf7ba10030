# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The approach: a cone of directions that contains the last heading of a plan.

It constrains the direction R_N e1 that the vehicle finally points in, not a velocity, be it its own
or relative to the goal. Headings shorter than ``least``, the larger of ``SLOWEST`` and the floor,
have no well-defined direction: they need the same component along d as one of that length. The
constraint is convex:

    R_N e1 . d >= cos(cone) max(|R_N e1|, least).

Mathematics: docs/mathematics.md, 3.10.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from orbimpc_ros.mpc.arrays import Array, number
from orbimpc_ros.mpc.errors import BadInput

if TYPE_CHECKING:
    from orbimpc_ros.mpc.problem.state import State

WIDEST_APPROACH = 1.4  # [rad] beyond it the cone is nearly a half-space, and ill-conditioned
SLOWEST = 0.01  # speed fraction below which a heading has no direction
LEEWAY = 3e-7  # [rad] tolerance of the cone in the plane, for plans that only just reach it


@dataclass(frozen=True)
class Approach:
    """The cone of directions in which a goal may be approached.

    Attributes:
        cone: largest angle between the last heading and the direction [rad]; 0: unconstrained.
        direction: axis of the cone in the world frame, n numbers, not necessarily a unit vector;
            empty: the first axis of the goal's attitude, ``State.wanted``.
    """

    cone: float = 0.0
    direction: tuple[float, ...] = ()

    @cached_property
    def exists(self) -> bool:
        """Return True if the last heading is constrained."""
        return self.cone > 0.0

    @cached_property
    def is_the_goals(self) -> bool:
        """Return True if the goal's attitude gives the direction."""
        return self.exists and not self.direction

    def validate(self, dimension: int) -> None:
        """Check the cone, and the direction for a dimension.

        Raises:
            BadInput: out of range, not n numbers, or a vector too short or too long.
        """
        number(self.cone, 'approach.cone', 0.0, WIDEST_APPROACH)
        if not self.direction:
            return
        found, wanted = self.direction, f'{dimension} numbers, not all of them 0, or none'
        for each in found:
            number(each, 'approach.direction')
        if len(found) != dimension or not 1e-6 < math.hypot(*found) < 1e6:
            raise BadInput('approach.direction', list(found), wanted)

    def axis(self, state: State) -> Array:
        """Return the direction d of approach, a unit vector of shape (n,)."""
        if self.direction:
            return np.array(self.direction) / math.hypot(*self.direction)
        assert state.wanted is not None
        return state.wanted[:, 0]
