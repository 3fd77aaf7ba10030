"""The planar hull, however long the horizon: linear in it, in machine code."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from orbimpc_ros.mpc import dynamics
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.condensed import first_length, input_weight, position_weights
from orbimpc_ros.mpc.general import General
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.chain import minimise
from orbimpc_ros.mpc.method import Found, Guess
from orbimpc_ros.mpc.problem import Problem, State

STIFFNESS = 100.0  # first parameter of the penalties, in proportion to the trace of the Hessian
PRECISION = 1e-9  # on the disks
GAP = 1e-9  # relative
ROUNDING = 1e-15  # of the largest numbers that cancel in a cost


class Hull:
    """Solves SE(2) problems of orders (1, 1) with no constraint but the hull.

    Args:
        problem: what to solve.
        tolerance: relative gap at which the general search stops, where this one is at a loss.
    """

    takes_guess = False  # there is nothing to search
    trusts_guess = True

    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._problem = problem
        self._general = General(problem, tolerance)
        self._along = np.array([[1.0, problem.step * problem.forward], [0.0, 1.0]])
        self._turning = input_weight(problem) / problem.step**2
        self._weights = position_weights(problem)
        reach = dynamics.position_map(problem)[:, 1:]
        trace = 2.0 * (float(self._weights @ (reach * reach).sum(axis=1)) + self._turning)
        self._stiffness = STIFFNESS * trace
        # The first call compiles, or loads what was compiled before: at start-up, not in a tick.
        start = State.at(np.zeros(2), np.eye(2))
        self.solve(start, np.zeros((problem.horizon, 2)))

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether this method applies to a problem, and is fast on this machine."""
        orders = (problem.dimension, problem.rotation_order, problem.translation_order)
        return (
            COMPILED
            and orders == (2, 1, 1)
            and problem.floor.shape == 'none'
            and problem.terminal == 'penalty'
            and problem.weights.length == problem.max_rate == problem.arrival_weight == 0.0
            and problem.weights.input > 0.0
            and not problem.obstacles
        )

    def solve(
        self,
        state: State,
        goals: Array,
        guess: Guess | None = None,
        out_of_time: Callable[[], bool] | None = None,
    ) -> Found:
        """Return the optimum; see :class:`orbimpc_ros.mpc.search.Search` for the rest."""
        targets = goals - state.position
        start = np.array([np.zeros(2), state.rotation[:, 0]])
        constant = float(self._weights @ np.einsum('kc,kc->k', targets, targets))
        x, cost, bound, settled = minimise(
            self._along, start, self._turning, self._weights, targets,
            self._stiffness, PRECISION, GAP, ROUNDING * constant,
        )  # fmt: skip
        if not settled:
            return self._general.solve(state, goals, guess, out_of_time)
        spent = first_length(self._problem, state)
        return Found(x, cost + spent, bound + spent, 1)
