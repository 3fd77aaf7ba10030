# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planar hull, however long the horizon: linear in it, in machine code.

Mathematics: docs/mathematics.md, 4.2.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.penalty import BEST, PAUSED, SETTLED, begun
from orbimpc_ros.mpc.kernels.riccati import Chain, settle, within
from orbimpc_ros.mpc.model.dynamics import (
    adrift,
    attitude_weight,
    first_length,
    input_weight,
    position_weights,
    wanted_coordinates,
)
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.tree import one
from orbimpc_ros.mpc.solve.registry import General
from orbimpc_ros.mpc.solve.request import Found, Request

STIFFNESS = 100.0  # first parameter of the penalties, in proportion to the trace of the Hessian
PRECISION = 1e-9  # on the disks
GAP = 1e-9  # relative
CANCELLED = 1e-12  # what a bound allows for of the largest numbers that cancel in it
LARGEST = 1e7  # sigma, in proportion to the first
SLICE = 2000  # steps of the horizon times steps of the method, in about a millisecond
ROUNDING = 1e-15  # of the largest numbers that cancel in a cost


class HullRiccati:
    """Solves SE(2) problems of orders (1, 1) with no constraint but the hull.

    Args:
        problem: what to solve.
        tolerance: relative gap at which the general search stops, where this one is at a loss.
    """

    takes_guess = False  # there is nothing to search
    trusts_guess = True

    def __init__(self, problem: Problem, tolerance: float, *, coasting: bool = False) -> None:
        self._problem = problem
        self._general = General(problem, tolerance)
        self._along = np.array([[1.0, problem.step * problem.forward], [0.0, 1.0]])
        self._turning = input_weight(problem) / problem.step**2
        self._weights, self._steadying = position_weights(problem), attitude_weight(problem)
        reach = problem.maps.reach[:, 1:]
        trace = 2.0 * (float(self._weights @ (reach * reach).sum(axis=1)) + self._turning)
        self._stiffness = STIFFNESS * trace
        self._slice = max(1, SLICE // problem.horizon)
        # The first call compiles, or loads what was compiled before: at start-up, not in a tick.
        start = State.at(np.zeros(2), np.eye(2))
        self.solve(Request(start, np.zeros((problem.horizon, 2))))

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether this method applies to a problem, and is fast on this machine."""
        orders = (problem.dimension, problem.rotation_order, problem.translation_order)
        return (
            COMPILED
            and orders == (2, 1, 1)
            and problem.discretisation == 'euler'  # a chain in which R_{k+1} moves no s_{k+1}
            and not problem.floor.exists
            and problem.terminal == 'penalty'
            and problem.weights.length == problem.max_rate == problem.arrival_weight == 0.0
            and problem.weights.input > 0.0
            and not problem.obstacles
            and not problem.approach.exists
        )

    def solve(self, request: Request) -> Found:
        """Return the optimum; the rest as in ``branch_and_bound.BranchAndBound``."""
        found, settled = self.relaxed(request)
        if settled or request.hurried:
            return found
        return self._general.solve(request)

    def relaxed(self, request: Request) -> tuple[Found, bool]:
        """Return the best within the disks and its bound, and whether that is the optimum."""
        state, goals = request.state, request.goals
        targets = goals - adrift(self._problem, state)
        start = np.zeros((len(self._along), 2))
        start[-1] = state.rotation[:, 0]
        wish = np.append(self._steadying, wanted_coordinates(self._problem, state))
        chain = Chain(self._along, start, self._turning, self._weights, targets, wish)
        constant = float(self._weights @ np.einsum('kc,kc->k', targets, targets)) + self._steadying
        rounding = ROUNDING * constant
        limits = (PRECISION, GAP, rounding, LARGEST * self._stiffness)
        progress, lowest = begun(len(goals), 2, self._stiffness), np.empty_like(targets)
        while True:
            cost, status = settle(chain, limits, progress, lowest, self._slice)
            if status != PAUSED:
                break
            if request.late:
                cost = within(chain, progress.x)
                break
        spent = first_length(self._problem, state)
        bound = float(progress.numbers[BEST]) - CANCELLED * constant
        proof = one(lowest, np.zeros(len(goals)))
        return Found(progress.x, cost + spent, bound + spent, 1, proof=proof), status == SETTLED
