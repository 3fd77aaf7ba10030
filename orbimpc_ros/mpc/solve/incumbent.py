# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The best trajectory of a search so far, and what may take its place.

Mathematics: docs/mathematics.md, 4.9.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.orbitopes import margin
from orbimpc_ros.mpc.model.dynamics import Trajectory
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.solve.posed import Posed

ACCURATE = 1e-6  # on the orbitope, and on an arrival in units of a step's length: as the check's
ROUNDING = 1e-15  # of the coordinates of goals far from the origin
LEAST = 1e-9  # cost that a gap is measured against


class Incumbent:
    """The best trajectory found.

    Args:
        posed: what is searched, with a guess to begin with.
        tolerance: relative gap at which the search stops.

    Attributes:
        x: its rotation coordinates, shape (N, d); None as long as there is none.
        cost: of it, infinite as long as there is none.
    """

    def __init__(self, posed: Posed, tolerance: float) -> None:
        self._posed, self._tolerance, guess = posed, tolerance, posed.request.guess
        self.x = None if guess is None else guess.x
        self.cost = np.inf if guess is None else guess.cost

    @property
    def cutoff(self) -> float:
        """Return the bound from which on a node cannot improve on it by enough."""
        if self.x is None:
            return np.inf
        return self.cost - self._tolerance * max(abs(self.cost), LEAST)

    def offer(self, x: Array, trajectory: Trajectory) -> None:
        """Take a trajectory that misses no choice, if it is better, turns in time and arrives."""
        posed = self._posed
        if (
            trajectory.cost < self.cost
            and posed.turns_in_time(trajectory)
            and is_accurate(posed.problem, posed.request.goals, trajectory)
        ):
            self.x, self.cost = x, trajectory.cost


def is_accurate(problem: Problem, goals: Array, trajectory: Trajectory) -> bool:
    """Return whether a relaxation's solution holds what is not branched on as well as plans must.

    One that was interrupted, or is not accurate, proves a bound all the same.
    """
    inside = bool(margin(trajectory.rotations[1:]).min() >= -ACCURATE)
    return inside and arrives(problem, goals, trajectory)


def arrives(problem: Problem, goals: Array, trajectory: Trajectory) -> bool:
    """Return whether a terminal constraint, if there is one, is met as well as plans must."""
    if problem.terminal != 'constraint':
        return True
    missed = np.abs(trajectory.positions[-1] - goals[-1]).max()
    if problem.inertial:
        missed = max(missed, problem.step * np.abs(trajectory.velocities[-1]).max())
    rounding = ROUNDING * np.abs(goals[-1]).max()
    return bool(missed <= ACCURATE * problem.length_unit + rounding)
