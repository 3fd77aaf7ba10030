"""The circular floor without an arrival, in machine code."""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.condensed import Condensed, suits_dense_code
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.annulus import certified
from orbimpc_ros.mpc.kernels.faces import branch_and_bound
from orbimpc_ros.mpc.method import Found, Guess
from orbimpc_ros.mpc.problem import Problem, State

FURTHER_STARTS = 30


class Fast:
    """Local optima from the guess, from the hull and from all around, until one is proved global.

    Args:
        problem: what to solve.
        tolerance: relative gap at which to stop.
    """

    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._problem, self._tolerance = problem, tolerance
        self._condensed = Condensed(problem)
        self._inverse = np.linalg.inv(self._condensed.hessian)
        spent = problem.weights.length * problem.step * problem.forward
        self._length = np.full(problem.horizon, spent)
        self._length[-1] = 0.0
        self._search(np.ones((problem.horizon, 2)), 0.0, [])  # compiles, or loads compiled code

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether this applies to a problem that :class:`Circle` solves."""
        return (
            COMPILED
            and problem.dimension == 2
            and problem.terminal == 'penalty'
            and suits_dense_code(problem)
        )

    def solve(self, state: State, goals: Array, guess: Guess | None) -> Found:
        """Return the best trajectory found, with the best bound proved."""
        q, constant = self._condensed.affine(state, goals)
        starts = [] if guess is None else [guess.x]
        x, cost, bound, tried = self._search(q, constant, starts)
        return Found(x, cost + constant, bound + constant, tried)

    def _search(self, q: Array, constant: float, starts: list[Array]) -> tuple:
        hessian, nothing = self._condensed.hessian, np.zeros((0, 2))
        hull = branch_and_bound(hessian, self._inverse, q, constant, nothing, 0.0, 1e-6, 1)[0]
        return certified(
            hessian,
            q,
            constant,
            self._length,
            self._problem.floor.fraction,
            self._tolerance,
            np.array([*starts, hull]),
            FURTHER_STARTS,
        )
