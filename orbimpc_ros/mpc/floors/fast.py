"""The circular floor without an arrival, in machine code."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.condensed import Condensed, suits_dense_code
from orbimpc_ros.mpc.floors.faces import normals
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.annulus import certified
from orbimpc_ros.mpc.kernels.faces import branch_and_bound
from orbimpc_ros.mpc.method import Found, Guess
from orbimpc_ros.mpc.problem import Problem, State

FURTHER_STARTS = 30
FACES, NODES = 16, 500  # of the polygon that is searched where those prove nothing


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
        found = self._search(q, constant, starts)
        if found.cost - found.lower_bound <= self._tolerance * max(abs(found.cost), 1e-9):
            return found
        return self._searched_from_outside(q, constant, found)

    def _search(self, q: Array, constant: float, starts: list[Array]) -> Found:
        hull = self._within(np.zeros((0, 2)), 0.0, q, constant, 1)[0]
        return self._certified(q, constant, [*starts, hull], FURTHER_STARTS)

    def _searched_from_outside(self, q: Array, constant: float, found: Found) -> Found:
        """Return the better of what was found and the optimum nearest to that beyond a polygon.

        The polygon lies inside the floor's circle, so that its global optimum, found by search, is
        near the circle's even where no local search from elsewhere leads there.
        """
        apothem = self._problem.floor.fraction * math.cos(math.pi / FACES)
        outside, reached = self._within(normals(2, FACES), apothem, q, constant, NODES)[:2]
        if reached == np.inf:
            return found
        other = self._certified(q, constant, [outside], 0)
        best = min(found, other, key=lambda each: each.cost)
        bound = max(found.lower_bound, other.lower_bound)
        return replace(best, lower_bound=bound, nodes=found.nodes + other.nodes)

    def _within(self, faces: Array, floor: float, q: Array, constant: float, room: int) -> tuple:
        """Return the best x in the disk and beyond a polygon's faces, its cost, and more."""
        hessian, inverse = self._condensed.hessian, self._inverse
        return branch_and_bound(hessian, inverse, q, constant, faces, floor, 1e-6, room)

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
