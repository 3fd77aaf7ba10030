# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Searches for any feasible trajectory, or for one that catches the goal."""

from __future__ import annotations

from dataclasses import dataclass

from orbimpc_ros.mpc.arrays import Array, ByContent
from orbimpc_ros.mpc.problem.problem import Problem
from orbimpc_ros.mpc.problem.state import State


@dataclass(frozen=True, eq=False)
class Sought(ByContent):
    """A problem and the kind of trajectory to find in it.

    Attributes:
        problem: model and constraints, with the cone of approach of a catch.
        state: where plans start.
        goals: g_1..g_N, shape (N, n) [m].
        radius: largest distance |s_k - g_k| at which the goal is caught at step k [m]; 0 to find
            any feasible trajectory.
    """

    problem: Problem
    state: State
    goals: Array
    radius: float = 0.0
