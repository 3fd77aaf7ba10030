# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The approach: a cone of directions that the last heading of a plan has to be in.

It is about where the vehicle points at the end, R_N e1, not about how it moves past what it meets:
velocities, its own and the goal's, have no part in it. A heading shorter than ``SLOWEST``, or than
the floor, has no direction to speak of; it is demanded to be as far along as that one would be.
What is demanded is convex:

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
LEEWAY = 3e-7  # [rad] on the last heading of the plane: for plans that just reach the cone


@dataclass(frozen=True)
class Approach:
    """The directions in which a goal may be come to.

    Attributes:
        cone: largest angle of the last heading from the direction [rad], 0 for any.
        direction: in the world frame, n numbers, of any length; empty for the first axis of the
            rotation that the state wants: the goal's own.
    """

    cone: float = 0.0
    direction: tuple[float, ...] = ()

    @cached_property
    def exists(self) -> bool:
        """Return whether there is a cone at all."""
        return self.cone > 0.0

    @cached_property
    def is_the_goals(self) -> bool:
        """Return whether the goal's own attitude says the direction."""
        return self.exists and not self.direction

    def validate(self, dimension: int) -> None:
        """Refuse a cone or a direction that there is not in a dimension.

        Raises:
            BadInput: out of range, not n numbers, or no direction at all.
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
