"""One problem in, one plan out: which method solves it, and how well it is proved."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput, Infeasible, SolverFailure
from orbimpc_ros.mpc.feasibility import reason, too_slow
from orbimpc_ros.mpc.hull import Hull
from orbimpc_ros.mpc.method import Found, Guess, Method
from orbimpc_ros.mpc.orbitopes import coordinates
from orbimpc_ros.mpc.plan import FEASIBLE, OPTIMAL, Plan, assemble, violations
from orbimpc_ros.mpc.planar import Planar
from orbimpc_ros.mpc.problem import Problem, State

SEARCH_SHARE = 0.01  # a search stops at this share of the gap that counts as proved
ROUNDING = 1e-9  # costs that differ by less do so by rounding: at the goal the cost vanishes


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
        self._method = _method_for(problem, gap_tolerance, coasting)

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
        if too_slow(self.problem, state):  # a search might look into every branch before it knows
            raise Infeasible(reason(self.problem, state, goals))
        usable = self._usable(state, goals, guess)
        try:
            found = self._method.solve(state, goals, usable, out_of_time)
        except Infeasible:
            raise Infeasible(reason(self.problem, state, goals)) from None
        return self._plan(state, goals, found)

    @property
    def takes_guess(self) -> bool:
        """Return whether a guess makes this solver faster."""
        return self._method.takes_guess

    def _usable(self, state: State, goals: Array, guess: Plan | None) -> Guess | None:
        if guess is None or not self.takes_guess:
            return None
        if self._method.trusts_guess and violations(self.problem, state, goals, guess):
            return None
        return Guess(coordinates(guess.rotations[1:]), guess.objective)

    def _plan(self, state: State, goals: Array, found: Found) -> Plan:
        if found.x is None:
            raise SolverFailure(f'no trajectory found in {found.nodes} relaxations')
        missing = found.cost - found.lower_bound
        proved = missing <= max(self._tolerance * abs(found.cost), ROUNDING)
        return assemble(
            self.problem,
            state,
            goals,
            found.x,
            status=OPTIMAL if proved else FEASIBLE,
            lower_bound=found.lower_bound,
            nodes=found.nodes,
            projection=self._projection,
            flown=found.flown,
        )


def _method_for(problem: Problem, gap_tolerance: float, coasting: bool) -> Method:
    """Return the fastest method that proves its answer for a problem."""
    if Hull.solves(problem):
        return Hull(problem, SEARCH_SHARE * gap_tolerance)
    if Planar.solves(problem):
        return Planar(problem, SEARCH_SHARE * gap_tolerance)
    # CVXPY takes half of a start-up: only what needs it imports it.
    from orbimpc_ros.mpc.floors.circle import Circle
    from orbimpc_ros.mpc.search import Search

    if Circle.solves(problem):
        return Circle(problem, SEARCH_SHARE * gap_tolerance)
    return Search(problem, SEARCH_SHARE * gap_tolerance, coasting=coasting)
