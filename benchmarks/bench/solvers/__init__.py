# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The interface of a solver, and its refusal to take part."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.mpc.problem import State


class Declined(OrbimpcError):
    """A solver cannot take a problem, such as one beyond the size its licence allows."""


@dataclass(frozen=True)
class Solution:
    """The result of one instance.

    Attributes:
        objective: of its trajectory; NaN if it found none.
        gap: relative, as it proved it; NaN if it proves nothing.
        capped: whether it ran into its time limit.
        relaxed: whether it is of the convex relaxation: a bound, below every trajectory's.
    """

    objective: float
    gap: float = math.nan
    capped: bool = False
    relaxed: bool = False


class Solver(Protocol):
    """A solver set up for one problem. Only :meth:`solve` is timed."""

    def solve(self, state: State, goals: Array) -> None:
        """Put the data of an instance in and solve.

        Args:
            state: where the plan starts.
            goals: g_1..g_N, shape (N, n) [m].
        """

    def solution(self) -> Solution:
        """Return the result of the last solve."""
