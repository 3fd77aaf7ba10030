"""The search for the commonest problems of SE(2), in machine code where numba is installed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.condensed import Condensed, suits_dense_code
from orbimpc_ros.mpc.floors.cells import faces
from orbimpc_ros.mpc.general import General
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.cells import branch_and_bound
from orbimpc_ros.mpc.method import Found, Guess
from orbimpc_ros.mpc.problem import Problem, State

NODES = (200, 4000)  # room for the first attempt, and for one more where that was too little


class Planar:
    """Solves SE(2) problems with no constraint but the hull and a polygonal floor.

    What the kernel cannot settle, it leaves to the general search.

    Args:
        problem: what to solve.
        tolerance: relative gap at which a search stops.
    """

    takes_guess = False  # checking one costs more than it saves
    trusts_guess = True

    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._problem, self._tolerance = problem, tolerance
        self._condensed = Condensed(problem)
        self._inverse = np.linalg.inv(self._condensed.hessian)
        count = problem.floor.faces if problem.floor.shape == 'polygon' else 0
        self._cells = faces(count, problem.floor.fraction)
        self._general = General(problem, tolerance)
        # The first call compiles, or loads what was compiled before: at start-up, not in a tick.
        self._run(np.zeros((problem.horizon, 2)), 0.0, 1)

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether this method applies to a problem, and is fast on this machine."""
        return (
            COMPILED
            and (problem.dimension, problem.rotation_order) == (2, 1)
            and problem.floor.shape != 'circle'
            and problem.terminal == 'penalty'
            and problem.weights.length == problem.max_rate == problem.arrival_weight == 0.0
            and not problem.obstacles
            and suits_dense_code(problem)
        )

    def solve(
        self,
        state: State,
        goals: Array,
        guess: Guess | None = None,
        out_of_time: Callable[[], bool] | None = None,
    ) -> Found:
        """Return the best trajectory with the bound proved.

        See :class:`orbimpc_ros.mpc.search.Search` for the rest.
        """
        q, constant = self._condensed.affine(state, goals)
        for room in NODES:
            x, reached, bound, nodes, complete = self._run(q, constant, room)
            if complete and reached < np.inf:
                return Found(x, reached + constant, bound + constant, nodes)
            if out_of_time is not None and out_of_time():
                break
        if out_of_time is not None and reached < np.inf:
            # Who has a deadline is better off with this than with a search that is slower.
            return Found(x, reached + constant, bound + constant, nodes)
        return self._general.solve(state, goals, guess, out_of_time)

    def _run(self, q: Array, constant: float, room: int) -> tuple:
        return branch_and_bound(
            self._condensed.hessian,
            self._inverse,
            q,
            constant,
            *self._cells,
            np.inf,
            self._tolerance,
            room,
        )
