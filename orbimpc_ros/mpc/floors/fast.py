"""The circular floor without an arrival, in machine code.

Local optima first, and the proof by their own multipliers. What those leave open, typically a goal
about to pass the vehicle, so that two ways round cost nearly the same, is settled by branch and
bound: the floor is cut into arcs, and beyond the chord of an arc the problem is convex.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.condensed import Condensed, suits_dense_code
from orbimpc_ros.mpc.floors.cells import Table, arcs, faces
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.annulus import certified
from orbimpc_ros.mpc.kernels.cells import branch_and_bound
from orbimpc_ros.mpc.method import Found, Guess
from orbimpc_ros.mpc.problem import Problem, State

FURTHER_STARTS = 30
FACES, NODES = 16, 500  # of the polygon that is searched where those prove nothing
ROOMS = (1000, 5000, 25000)  # nodes for the searches over arcs that prove the rest
SETTLED = 50.0  # tolerances at which that search may stop


class Fast:
    """Local optima from the guess, from the hull and from all around, and what proves one global.

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
        self._arcs = arcs(problem.floor.fraction)
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
            out_of_time: polled between searches; True returns what is known so far.
        """
        q, constant = self._condensed.affine(state, goals)
        starts = [] if guess is None else [guess.x]
        found = self._search(q, constant, starts)
        if found.gap <= self._tolerance:
            return found
        found = self._searched_from_outside(q, constant, found)
        if found.gap <= self._tolerance:
            return found
        for room in ROOMS:
            found = self._searched_by_arcs(q, constant, found, room)
            if self.settles(found) or (out_of_time is not None and out_of_time()):
                break
        return found

    def settles(self, found: Found) -> bool:
        """Return whether what was found is proved as well as the search over arcs does."""
        return found.gap <= SETTLED * self._tolerance

    def _search(self, q: Array, constant: float, starts: list[Array]) -> Found:
        hull = self._within(faces(0, 0.0), q, constant, 1)[0]
        return self._certified(q, constant, [*starts, hull], FURTHER_STARTS)

    def _searched_from_outside(self, q: Array, constant: float, found: Found) -> Found:
        """Return the better of what was found and the optimum nearest to that beyond a polygon.

        The polygon lies inside the floor's circle, so that its global optimum, found by search, is
        near the circle's even where no local search from elsewhere leads there.
        """
        apothem = self._problem.floor.fraction * math.cos(math.pi / FACES)
        outside, reached = self._within(faces(FACES, apothem), q, constant, NODES)[:2]
        return found if reached == np.inf else self._better(found, q, constant, outside)

    def _better(self, found: Found, q: Array, constant: float, start: Array) -> Found:
        """Return the better of what was found and the local optimum near a start."""
        other = self._certified(q, constant, [start], 0)
        best = min(found, other, key=lambda each: each.cost)
        bound = max(found.lower_bound, other.lower_bound)
        return replace(best, lower_bound=bound, nodes=found.nodes + other.nodes)

    def _searched_by_arcs(self, q: Array, constant: float, found: Found, room: int) -> Found:
        """Return the better of what was found and where a search over arcs leads, with its bound.

        It does not see path length, of which there is at least the floor's.
        """
        least = constant + self._problem.floor.fraction * float(self._length.sum())
        x, _, bound, nodes, _ = branch_and_bound(
            self._condensed.hessian,
            self._inverse,
            q,
            least,
            *self._arcs,
            found.cost - least,
            SETTLED * self._tolerance,
            room,
        )
        found = replace(
            found,
            lower_bound=max(found.lower_bound, bound + least),
            nodes=found.nodes + nodes,
        )
        return found if self.settles(found) else self._better(found, q, constant, x)

    def _within(self, cells: Table, q: Array, constant: float, room: int) -> tuple:
        """Return the best x in the disk and within one of the cells, its cost, and more."""
        return branch_and_bound(
            self._condensed.hessian, self._inverse, q, constant, *cells, np.inf, 1e-6, room
        )

    def _certified(self, q: Array, constant: float, starts: list[Array], more: int) -> Found:
        x, cost, bound, tried = certified(
            self._condensed.hessian,
            q,
            constant,
            self._length,
            self._problem.floor.fraction,
            self._tolerance,
            np.array(starts),
            more,
        )
        return Found(x, cost + constant, bound + constant, tried)
