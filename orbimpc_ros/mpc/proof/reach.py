# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What no headings lead to, by positions that are rolled out step by step.

None of the maps of the methods is used.

Mathematics: docs/mathematics.md, (7.10b).
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.choices import SURE
from orbimpc_ros.mpc.proof.sides import Sides
from orbimpc_ros.mpc.proof.slopes import terms_of


class Reach:
    """How far headings lead a vehicle.

    Args:
        problem: how it moves.
    """

    def __init__(self, problem: Problem) -> None:
        self._sides, self._unit = Sides(problem, terms_of(problem)), problem.length_unit
        self._ends = slice(problem.horizon, 2 * problem.horizon)  # of steps, among places

    def misses(self, state: State, goals: Array, radius: float) -> np.ndarray:
        """Return of which steps the end is surely not within a radius of the goal, shape (N,).

        Args:
            state: where the vehicle starts.
            goals: g_1..g_N, shape (N, n) [m].
            radius: of a catch [m].
        """
        places = self._sides.places(state)
        free, reach = places.free[self._ends], np.abs(places.maps[self._ends]).sum(axis=1)
        here, wanted, near = (each / self._unit for each in (state.position, goals, radius))
        off = wanted - here - free
        sizes = np.abs(here).sum() + (np.abs(wanted) + np.abs(free)).sum(axis=1)
        away = np.sqrt(np.einsum('kc,kc->k', off, off))
        return np.asarray(away > near + reach + SURE * (1.0 + sizes + reach))
