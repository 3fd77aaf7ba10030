# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""In what something is looked for: any trajectory, or one that catches the goal."""

from __future__ import annotations

from dataclasses import dataclass

from orbimpc_ros.mpc.arrays import Array, ByContent
from orbimpc_ros.mpc.problem.problem import Problem
from orbimpc_ros.mpc.problem.state import State


@dataclass(frozen=True, eq=False)
class Sought(ByContent):
    """A problem with what is looked for in it.

    Attributes:
        problem: what may be flown, with the cone of approach of a catch.
        state: where plans start.
        goals: g_1..g_N, shape (N, n) [m].
        radius: within which s_k is of g_k where the goal is caught at step k [m]; 0 where any
            trajectory is looked for.
    """

    problem: Problem
    state: State
    goals: Array
    radius: float = 0.0
