"""The true floor where the cost sees R e1 alone: a local optimum, and the proof that it is global.

That is all of R for n = 2. For n = 3 it takes an input weight of zero; the other columns are then
free, and are carried along by the shortest turns from one thrust axis to the next.

A local optimum is sought from the shifted previous plan, then from the relaxed plan. Its own
multipliers nearly always prove it global (:mod:`annulus`). Where they do not, a search over arcs
does, in machine code (:mod:`fast`); where that does not apply, the lifted relaxation (:mod:`lift`)
gives another start, and a bound that holds in any case.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import SolverFailure
from orbimpc_ros.mpc.floors.annulus import Annulus
from orbimpc_ros.mpc.floors.fast import Fast
from orbimpc_ros.mpc.floors.lift import Lift
from orbimpc_ros.mpc.method import Found, Guess
from orbimpc_ros.mpc.orbitopes import coordinates
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.program import Program
from orbimpc_ros.mpc.rotations import turned_onto


class Circle:
    """Solves problems of rotation order 1 with a circular floor and no limits but a terminal one.

    Args:
        problem: what to solve.
        tolerance: relative gap at which a plan is good enough to stop.
    """

    takes_guess, trusts_guess = True, False  # anywhere is good enough to start from

    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._problem, self._tolerance = problem, tolerance
        self._program, self._annulus = Program(problem), Annulus(problem)
        liftable = problem.horizon > 1 and problem.translation_order == 1
        self._lift = Lift(problem) if liftable else None
        self._fast = Fast(problem, tolerance) if Fast.solves(problem) else None

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether this method applies to a problem."""
        arrives = problem.terminal == 'constraint' or problem.arrival_weight > 0.0
        return (
            problem.floor.shape == 'circle'
            and problem.rotation_order == 1
            and (problem.translation_order == 1 or not arrives)
            and (problem.dimension == 2 or problem.weights.input == 0.0)
            and problem.max_rate == 0.0
            and not problem.obstacles
        )

    def solve(
        self,
        state: State,
        goals: Array,
        guess: Guess | None = None,
        out_of_time: Callable[[], bool] | None = None,
    ) -> Found:
        """Return the best trajectory found, with the best bound proved.

        Args:
            state: where the plan starts.
            goals: g_1..g_N, shape (N, n) [m].
            guess: a trajectory to start from.
            out_of_time: polled between starts; True returns the best so far.

        Raises:
            Infeasible: no trajectory satisfies the constraints.
        """
        best = Found(None, np.inf, -np.inf, 0)
        if self._fast is not None:
            best = self._fast.solve(state, goals, guess, out_of_time)
            if self._fast.settles(best):
                return best
        self._annulus.bind(state, goals)
        for start, bound in self._starts(state, goals, guess):
            best = self._improved(best, start, bound)
            if best.x is not None and best.gap <= self._tolerance:
                break
            if best.x is not None and out_of_time is not None and out_of_time():
                break
        if best.x is None or self._problem.dimension == 2:
            return best
        return replace(best, x=_carried(state.attitude, best.x))

    def _starts(
        self, state: State, goals: Array, guess: Guess | None
    ) -> Iterator[tuple[Array, float]]:
        """Yield headings to start from, cheapest first, each with a bound that came with it."""
        if guess is not None:
            yield guess.x[:, : self._problem.dimension], -np.inf
        self._program.bind(state, goals)
        relaxed = self._program.solve()
        yield relaxed.x[:, : self._problem.dimension], relaxed.bound
        if self._lift is None:
            return
        try:
            lifted = self._lift.solve(state, goals)
        except SolverFailure:
            return
        yield lifted.headings, lifted.lower_bound

    def _improved(self, best: Found, start: Array, bound: float) -> Found:
        point = self._annulus.stationary(start)
        lower = max(best.lower_bound, bound)
        if point is None:
            return Found(best.x, best.cost, lower, best.nodes + 1)
        lower = max(lower, point.lower_bound)
        if point.cost < best.cost:
            return Found(point.headings, point.cost, lower, best.nodes + 1)
        return Found(best.x, best.cost, lower, best.nodes + 1)


def _carried(attitude: Array, headings: Array) -> Array:
    """Return coordinates, shape (N, 9), of |z_k| Q_k, with Q_k turned from Q_{k-1} onto z_k."""
    matrices = []
    for z in headings:
        size = float(np.linalg.norm(z))
        attitude = turned_onto(attitude, z / size)
        matrices.append(size * attitude)
    return coordinates(np.array(matrices))
