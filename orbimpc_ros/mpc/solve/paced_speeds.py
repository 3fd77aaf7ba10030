# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The limit of the change of speed, added to any other method by successive convex programs.

The lower bound of a method that ignores this limit remains valid with it. If its trajectory changes
speed too fast, a convex restriction about its directions is solved, then about the solution's.

Mathematics: docs/mathematics.md, 3.10.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import speed_margin
from orbimpc_ros.mpc.geometry.rotations import project_all
from orbimpc_ros.mpc.model.dynamics import Trajectory, trajectory_of
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.problem import LEEWAY
from orbimpc_ros.mpc.problem.reach import WITHIN, entry_speed, first_change_is_decided
from orbimpc_ros.mpc.search.engine import PlanarSearch
from orbimpc_ros.mpc.solve.conic import Positive
from orbimpc_ros.mpc.solve.dives import FOLLOWED, WORTH
from orbimpc_ros.mpc.solve.program import Program
from orbimpc_ros.mpc.solve.regions import Regions
from orbimpc_ros.mpc.solve.relaxation import Row
from orbimpc_ros.mpc.solve.request import Found, Request, method_for
from orbimpc_ros.mpc.solve.stand_ins import in_time, sound, straight, turning
from orbimpc_ros.mpc.solve.turns import cone, spared

NARROW = 1e-4  # [rad] thinner cones are replaced by their axes, for Clarabel's accuracy


class PacedSpeeds:
    """Solver of problems with a limit of the change of speed that no search handles itself.

    Args:
        problem: what to solve.
        tolerance: relative gap at which the search without the limit stops.
        coasting: whether states come with a ``coasted`` rotation.
        among: whether states come with hazards.
    """

    takes_guess = True

    def __init__(
        self, problem: Problem, tolerance: float, *, coasting: bool = False, among: bool = False
    ) -> None:
        self._problem, freed = problem, replace(problem, max_acceleration=0.0)
        self._method = method_for(freed, tolerance, coasting=coasting, among=among)
        stated = replace(problem, max_rate=0.0) if problem.turns_are_angles else problem
        self._program = Program(stated, coasting=coasting)
        self._regions = Regions(problem)

    @staticmethod
    def solves(problem: Problem, *, coasting: bool = False) -> bool:
        """Return True if there is a limit, and no faster method for it."""
        return problem.max_acceleration > 0.0 and not PlanarSearch.solves(
            problem, coasting=coasting
        )

    def solve(self, request: Request) -> Found:
        """Return the best trajectory found, with the bound of the problem without the limit.

        Raises:
            Infeasible: even without the limit no trajectory satisfies the constraints.
        """
        solutions = [x for _, x in sound(self._problem, request, [request.guess])]
        request = request._replace(guess=solutions[0] if solutions else None)
        result = self._method.solve(request)
        if result.x is not None and self._holds(request, result.x):
            solutions.append(result.x)
        else:
            self._regions.bind(request)
            for x in self._starts(request, result):
                path = self._flown(request, x).rotations
                near = self._followed(request, path, waits=not solutions)
                solutions += near
                if near or request.late:
                    break
        if not solutions:
            return replace(result, x=None, cost=np.inf)
        cost, best = min((self._flown(request, x).objective, i) for i, x in enumerate(solutions))
        return replace(result, x=solutions[best], cost=cost, reason='')

    def _flown(self, request: Request, x: Array) -> Trajectory:
        return trajectory_of(self._problem, request.state, request.goals, x)

    def _holds(self, request: Request, x: Array) -> bool:
        rotations = self._flown(request, x).rotations
        return bool(speed_margin(self._problem, request.state, rotations[:, :, 0]).min() >= 0.0)

    def _starts(self, request: Request, result: Found) -> Iterator[Array]:
        """Yield the coordinates, shape (N, d), of the result, and the guess or fallbacks."""
        if result.x is not None:
            yield result.x
        if request.guess is None:
            posed = self._problem, request.state, request.goals
            every = chain(reversed(list(straight(*posed))), turning(*posed))
            yield from in_time(every, request.out_of_time)
        elif not request.late:
            yield request.guess

    def _followed(self, request: Request, path: Array, *, waits: bool) -> list[Array]:
        """Return coordinates, shape (N, d), of solutions, each near the one before, or ``path``.

        The deadline ends them; if it ``waits``, not the first, without which there is no plan.
        """
        solutions, cost = list[Array](), np.inf
        while len(solutions) < FOLLOWED:
            within = request._replace(out_of_time=None) if waits and not solutions else request
            x = self._beside(within, path)
            if x is None:
                break
            solutions.append(x)
            trajectory = self._flown(request, x)
            if trajectory.objective > (1.0 - WORTH) * cost:
                break
            cost, path = trajectory.objective, trajectory.rotations
        return solutions

    def _beside(self, request: Request, path: Array) -> Array | None:
        """Return the best coordinates, shape (N, d), near a path, shape (N + 1, n, n), or None.

        Bodies are passed on the path's sides, and floors satisfied beyond its tangents or faces.
        """
        state, headings, program = request.state, path[:, :, 0], self._program
        regions = self._regions
        before = state.attitude if state.coasted is None else state.coasted
        units = project_all(path[1:], before, 'thrust_aligned')[:, :, 0]
        spare: Array = np.zeros(0)
        first = self._problem.rotation_order - 1
        if self._problem.turns_are_angles:
            spare = spared(self._problem, state, np.vstack([headings[:1], units]), LEEWAY)
        if (spare < 0.0).any():
            return None
        decided = int(first_change_is_decided(self._problem, state))
        floors = range(decided, len(units)) if self._problem.floor.exists else range(0)
        choices = [*floors, *regions.beside(headings, math.inf)]
        held = [row for each in regions.tangents(headings, choices, {}).values() for row in each]
        rays = list[Row]()
        for k, half in enumerate(spare.tolist(), first):
            wide = half >= NARROW
            (held if wide else rays).extend(cone(k, units, half * wide))
        sizes, offsets = self._limits(state, units)
        paced = program.stated(request).extended((sizes, offsets, [Positive(len(offsets))]))
        paced = program.cut(program.cut(paced, held), rays, equal=True)
        relaxed = program.solved(request, paced)
        return relaxed.x if relaxed.is_accurate else None

    def _limits(self, state: State, units: Array) -> tuple[Array, Array]:
        """Return A and b of A x <= b: limits (3.10a), made convex about directions, (N, n)."""
        problem, program, every = self._problem, self._program, np.arange(len(units))
        most, entry = WITHIN * problem.speed_change, entry_speed(problem, state)
        sizes, along = np.zeros((2, len(units), program.count))
        sizes[every, program.t] = 1.0
        along[every[:, None], program.x[:, : problem.dimension]] = units
        rows = np.vstack([sizes[:1], -along[:1], sizes[1:] - along[:-1], sizes[:-1] - along[1:]])
        offsets = most + np.append([entry, -entry], np.zeros(len(rows) - 2))
        first = 2 * first_change_is_decided(problem, state)
        return rows[first:], offsets[first:]
