# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Trajectories for a search to begin with: along ways, near solutions, and turning in time.

A *dive* holds all that a solution misses at its nearest cell, and solves again; of a round floor
it holds the tangent in the direction of v, beyond which |v| is surely above the floor. A *way* is
followed on the sides on which it passes what is round or moves.

Mathematics: docs/mathematics.md, 4.9 and 4.11.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.cells import Cell
from orbimpc_ros.mpc.model.dynamics import Trajectory, translation_rollout
from orbimpc_ros.mpc.solve.disjunction import Disjunction
from orbimpc_ros.mpc.solve.incumbent import Incumbent
from orbimpc_ros.mpc.solve.posed import Choice, Missed, Posed

DIVE_STEPS = 4
PASSING_STEPS = 10  # of a dive among what is round or moves
BESIDE = 2.0  # steps' lengths from a way: what is farther away does not guide it
FOLLOWED = 8  # times that a way is followed anew
WORTH = 1e-3  # share of the cost that makes it worth while


class Dives:
    """Looks for trajectories of one request.

    Args:
        posed: what is searched.
        best: which is offered them.
    """

    def __init__(self, posed: Posed, best: Incumbent) -> None:
        self._posed, self._best = posed, best

    def follow(self, headings: Array) -> None:
        """Hold tangents where a way passes, solve, and go on from what that finds.

        Each time costs less: where the way satisfies all that it is held by, so does it again.

        Args:
            headings: R_1 e1..R_N e1 of the way, shape (N, n).
        """
        ahead, cost = self._posed.request.state.rotation[:, 0], np.inf
        for _ in range(FOLLOWED):
            if self._posed.late:
                return
            x = self._beside(np.vstack([ahead, headings]))
            if x is None:
                return
            trajectory = self._posed.flown(x)
            if not self._posed.missed(trajectory):
                self._best.offer(x, trajectory)
            if trajectory.cost > (1.0 - WORTH) * cost:
                return
            headings, cost = trajectory.headings[1:], trajectory.cost

    def dive(self, choice: Choice, trajectory: Trajectory, missed: Missed) -> None:
        """Look for a trajectory: hold whatever is missed at its nearest cell, and solve again.

        Args:
            choice: of the node that the trajectory solves.
            trajectory: which misses something.
            missed: what it misses.
        """
        posed = self._posed
        if posed.turns is not None:
            self.turn(choice, trajectory)
            if self._best.x is not None:
                return
        held = list(choice)
        for _ in range(DIVE_STEPS if posed.passages is None else PASSING_STEPS):
            if posed.late:
                return
            for j, (_, values) in missed.items():
                held[j] = posed.nearest(j, values, held[j])
            x = self._solved(held)
            if x is None:
                return
            trajectory = posed.flown(x)
            missed = posed.missed(trajectory)
            if not missed:
                self._best.offer(x, trajectory)
                missed = posed.round_floors(trajectory)  # tangents there may descend further
                if not missed:
                    return

    def turn(self, choice: Choice, trajectory: Trajectory) -> None:
        """Look for a trajectory that turns in time, near this one's headings, then its speeds."""
        turns = self._posed.turns
        assert turns is not None
        reached = turns.reached(self._posed.request.state, trajectory.headings)
        for around in (reached, turns.kept(trajectory.headings)):
            self._turn_from(choice, trajectory, around)

    def _turn_from(self, chosen: Choice, trajectory: Trajectory, around: list[Cell]) -> None:
        """Look for a trajectory that turns in time, near cells of the floor, one for each step.

        Consecutive headings are held so close to each other that no angle is too wide.
        """
        posed, held = self._posed, list(chosen)
        assert posed.turns is not None
        for _ in range(DIVE_STEPS):
            if posed.late:
                return
            missed = posed.missed(trajectory)
            for j, choice in enumerate(posed.alternatives):
                if isinstance(choice, Disjunction) and choice.on == 'heading':
                    held[j] = around[choice.steps[0] - 1]
                elif j in missed:
                    held[j] = posed.nearest(j, missed[j][1], held[j])
            x = self._solved(held, posed.turns.close(around))
            if x is None:
                return
            trajectory = posed.flown(x)
            if not posed.missed(trajectory):
                self._best.offer(x, trajectory)
            if not posed.turns_in_time(trajectory):
                return
            around = posed.turns.kept(trajectory.headings)

    def _beside(self, headings: Array) -> Array | None:
        """Return the best trajectory, shape (N, d), that passes where a way does; None without.

        Args:
            headings: of the way, R_0 e1..R_N e1, shape (N + 1, n).
        """
        posed, turns = self._posed, self._posed.turns
        positions, _ = translation_rollout(posed.problem, posed.request.state, headings)
        held: list[Cell | None] = list(posed.undecided)
        around = [] if turns is None else turns.kept(headings)
        for j, each in enumerate(posed.disjunctions):
            if around and each.on == 'heading':
                held[j] = around[each.steps[0] - 1]
            else:
                held[j] = posed.nearest(j, each.values(headings, positions), None)
        assert posed.passages is not None
        near = posed.passages.tangents(headings[1:], BESIDE * posed.problem.length_unit)
        for j, cell in near:
            held[posed.fixed + j] = cell
        return self._solved(held, None if turns is None else turns.close(around))

    def _solved(self, held: list[Cell | None], chords: Array | None = None) -> Array | None:
        """Return the solution with cells held, shape (N, d); None without one."""
        try:
            relaxed = self._posed.relax(held, chords, narrow=chords is not None)
        except Infeasible:
            return None
        return relaxed.x if relaxed.is_accurate else None
