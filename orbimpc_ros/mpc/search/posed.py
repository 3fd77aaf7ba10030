# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A problem as the search takes it: one quadratic of R_1 e1..R_N e1, and the limits of each step.

Mathematics: docs/mathematics.md, 4.3.
"""

from __future__ import annotations

import math

import numpy as np

from orbimpc_ros.mpc.model.condensed import Condensed, regular
from orbimpc_ros.mpc.model.cost import length_weights
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.approach import LEEWAY
from orbimpc_ros.mpc.problem.pace import entry_speed
from orbimpc_ros.mpc.search.relax import Quadratic
from orbimpc_ros.mpc.search.ring import Ring
from orbimpc_ros.mpc.solve.request import Request

RANK = 1e-9  # share of the greatest weight from which on others count


class Posed:
    """What of a problem is the same at every tick.

    Args:
        problem: in natural units, of the plane.

    Attributes:
        hessian: H, made regular, shape (N, N).
        excess: what that adds to the cost at most.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, self._condensed = problem, Condensed(problem)
        self.hessian, self._inverse, self.excess = regular(self._condensed.hessian)
        self._lengths = length_weights(problem)[1:].astype(float)
        self._rank = problem.horizon
        if not self._lengths.any():
            values = np.abs(np.linalg.eigvalsh(self._condensed.hessian))
            self._rank = int(np.count_nonzero(values > RANK * values.max()))
        floor = problem.floor
        fraction = float(floor.fraction) if floor.exists else 0.0
        self._floor = fraction, floor.faces if floor.shape == 'polygon' else 0
        self._widest = problem.widest_turn if floor.exists else math.pi
        self._entering = problem.max_acceleration > 0.0

    def quadratic(self, request: Request) -> Quadratic:
        """Return the cost."""
        q, constant = self._condensed.affine(request.state, request.goals)
        return Quadratic(self.hessian, self._inverse, q, self._lengths, constant, self._rank)

    def ring(self, state: State) -> Ring:
        """Return the floor, and what limits headings and speeds from a state on."""
        problem, ahead = self._problem, state.attitude[:, 0]
        entry = entry_speed(problem, state) if self._entering else 1.0
        last, within = 0.0, math.pi
        if problem.approach.exists:
            axis = problem.approach.axis(state)
            last, within = math.atan2(axis[1], axis[0]), problem.approach.cone + LEEWAY
        first = math.atan2(ahead[1], ahead[0])
        change = problem.speed_change if self._entering else np.inf
        return Ring(*self._floor, self._widest, first, entry, change, last, within)
