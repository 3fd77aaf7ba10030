# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What no headings lead to.

Mathematics: docs/mathematics.md, (7.10b).
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.dynamics import translation_rollout
from orbimpc_ros.mpc.problem import Problem, State

SURE = 1e-12  # by so much more than can be reached is surely out of reach


class Reach:
    """How far headings lead a vehicle.

    Args:
        problem: how it moves.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, self._unit = problem, problem.length_unit
        self._reach = np.abs(problem.maps.reach[:, 1:]).sum(axis=1) / self._unit

    def misses(self, state: State, goals: Array, radius: float) -> np.ndarray:
        """Return of which steps the end is surely not within a radius of the goal, shape (N,).

        Args:
            state: where the vehicle starts.
            goals: g_1..g_N, shape (N, n) [m].
            radius: of a catch [m].
        """
        still = np.zeros((len(goals) + 1, len(state.position)))
        still[0] = state.rotation[:, 0]
        flown, _ = translation_rollout(self._problem, state, still)
        free, reach = (flown[1:] - state.position) / self._unit, self._reach
        here, wanted, near = (each / self._unit for each in (state.position, goals, radius))
        off = wanted - here - free
        sizes = np.abs(here).sum() + (np.abs(wanted) + np.abs(free)).sum(axis=1)
        away = np.sqrt(np.einsum('kc,kc->k', off, off))
        return np.asarray(away > near + reach + SURE * (1.0 + sizes + reach))
