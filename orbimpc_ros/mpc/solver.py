"""One problem in, one plan out: which method solves it, and how well it is proved."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.disjunction import disjunctions_of
from orbimpc_ros.mpc.errors import BadInput, SolverFailure
from orbimpc_ros.mpc.orbitopes import coordinates
from orbimpc_ros.mpc.plan import FEASIBLE, Plan, assemble, violations
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.program import Program
from orbimpc_ros.mpc.search import Found, Search, inverse_curvature

SEARCH_SHARE = 0.01  # a search stops at this share of the gap that counts as proved


class Solver:
    """Solves one problem for any state and goals; compiled at construction.

    Args:
        problem: what to solve.
        projection: ``nearest`` or ``thrust_aligned``, how plans become rotations.
        gap_tolerance: relative gap within which a plan counts as proved optimal.
        coasting: whether states will come with a ``coasted`` rotation (rotation order 2).
    """

    def __init__(
        self,
        problem: Problem,
        *,
        projection: str = 'thrust_aligned',
        gap_tolerance: float = 1e-4,
        coasting: bool = False,
    ) -> None:
        self.problem = problem
        self._projection, self._tolerance = projection, gap_tolerance
        disjunctions = disjunctions_of(problem)
        coasting = coasting and problem.rotation_order == 2
        self._program = Program(problem, disjunctions, coasting=coasting)
        self._curvature = [inverse_curvature(problem, d) for d in disjunctions]

    def solve(
        self,
        state: State,
        goals: Array,
        guess: Plan | None = None,
        out_of_time: Callable[[], bool] | None = None,
    ) -> Plan:
        """Return the best plan found, with its proof.

        Args:
            state: where the plan starts; its dimension is the problem's.
            goals: g_1..g_N, shape (N, n) [m].
            guess: a plan from this very state to start the search from; used if it is feasible.
            out_of_time: polled during long searches; True makes them return their best.

        Raises:
            BadInput: goals of another shape.
            Infeasible: no trajectory satisfies the constraints.
            SolverFailure: no trajectory was found, and none was proved not to exist.
        """
        wanted = (self.problem.horizon, self.problem.dimension)
        if np.shape(goals) != wanted:
            raise BadInput('goals', np.shape(goals), f'an array of shape {wanted}')
        self._program.bind(state, goals)
        search = Search(
            self._program,
            self._curvature,
            state,
            goals,
            tolerance=SEARCH_SHARE * self._tolerance,
            guess=self._usable(state, goals, guess),
        )
        return self._plan(state, goals, search.run(out_of_time))

    def _usable(self, state: State, goals: Array, guess: Plan | None) -> tuple[Array, float] | None:
        if guess is None or violations(self.problem, state, goals, guess):
            return None
        return coordinates(guess.rotations[1:]), guess.objective

    def _plan(self, state: State, goals: Array, found: Found) -> Plan:
        if found.x is None:
            raise SolverFailure(f'no trajectory found in {found.nodes} relaxations')
        plan = assemble(
            self.problem,
            state,
            goals,
            found.x,
            status=FEASIBLE,
            lower_bound=found.lower_bound,
            nodes=found.nodes,
            projection=self._projection,
        )
        return plan.proved() if plan.gap <= self._tolerance else plan
