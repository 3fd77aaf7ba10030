# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Primal heuristics: solves beside a path; the incumbent.

Beside a *path* all choices are made as on the path: beyond the tangent of a round floor at its
heading, which implies |v| >= floor, or the face that it violates least; of a body on the side on
which it passes. The solution is the next path. Paths are the solutions of nodes, previous plans,
and with a turn limit a plan without bodies, in space one in a plane.

Mathematics: docs/mathematics.md, 4.9 and 4.11.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import terminal_violations
from orbimpc_ros.mpc.geometry.rotations import margin
from orbimpc_ros.mpc.model.dynamics import trajectory_of
from orbimpc_ros.mpc.solve.regions import ALWAYS, Regions, Rows
from orbimpc_ros.mpc.solve.relaxation import Relaxation, Relaxed
from orbimpc_ros.mpc.solve.stand_ins import in_time, sound, turning
from orbimpc_ros.mpc.solve.turns import KEPT

BESIDE = 2.0  # in units of a step's length: bodies farther from a path are not constrained by it
FOLLOWED = 10  # solves beside a path, each with the solution before as its path
WORTH = 1e-3  # relative reduction of the cost that is worth another solve
ACCURATE = 1e-6  # the check's tolerance of orbitopes
LEAST = 1e-9  # smallest denominator of a relative gap


class Dives:
    """Primal heuristics of one request, and the best trajectory found so far.

    Args:
        program: the relaxation of the problem.
        regions: of the request, whose guess is the first trajectory.
        tolerance: relative gap at which the search stops.

    Attributes:
        solved: number of relaxations solved.
        x: rotation coordinates, shape (N, d); None without a trajectory.
        cost: its objective; infinite without a trajectory.
    """

    def __init__(self, program: Relaxed, regions: Regions, tolerance: float) -> None:
        self._program, self._regions, self._request = program, regions, regions.request
        self._problem, self._turns = regions.problem, regions.turns
        self._tolerance, self.solved = tolerance, 0
        self.x: Array | None = None
        self.cost = np.inf
        self._guess = self._request.guess

    def recall(self) -> None:
        """Accept the guess, if it passes the check of plans, when a search first needs it."""
        if self._guess is not None:
            self._take([self._guess])
            self._guess = None

    def _take(self, candidates: Iterable[Array | None]) -> None:
        """Accept the first of several trajectories that passes the check of plans."""
        best = next(sound(self._problem, self._request, candidates), None)
        if best is not None and best[0] < self.cost:
            self.cost, self.x = best

    @property
    def cutoff(self) -> float:
        """Return the bound from which on nodes are pruned: the cost less the tolerance."""
        if self.x is None:
            return np.inf
        return self.cost - self._tolerance * max(abs(self.cost), LEAST)

    def relax(self, rows: Rows, chords: Array | None = None) -> Relaxation:
        """Solve the relaxation within half-spaces; ``chords`` as in :meth:`Relaxed.relax`."""
        self.solved += 1
        held = [row for each in rows.values() for row in each]
        return self._program.relax(self._request, held, chords)

    def offer(self, x: Array) -> tuple[Array, float]:
        """Accept rotation coordinates, shape (N, d), if they are cheaper and feasible.

        After an interrupted or inaccurate solve they may be outside of their orbitopes.

        Returns:
            Their headings R_0 e1..R_N e1, shape (N + 1, n), and their cost.
        """
        regions, goals = self._regions, self._request.goals
        trajectory = trajectory_of(self._problem, self._request.state, goals, x)
        headings = trajectory.rotations[:, :, 0]
        if (
            trajectory.objective < self.cost
            and not regions.missed(headings)
            and regions.turns_in_time(headings)
            and margin(trajectory.rotations[1:]).min() >= -ACCURATE
            and not terminal_violations(self._problem, goals, trajectory)
        ):
            self.x, self.cost = x, trajectory.objective
        return headings, trajectory.objective

    def stand_in(self) -> None:
        """Accept the first trajectory found without a search that passes the check of plans."""
        request = self._request
        every = turning(self._problem, request.state, request.goals)
        self._take(in_time(every, request.out_of_time))

    def dive(self, headings: Array, rows: Rows) -> None:
        """Follow the solution of a node, as far as turns allow; see :meth:`follow`."""
        if self._turns is not None and not self._request.late:
            self.follow(self._turns.followed(self._request.state, headings), rows, 0.0)
        self.follow(headings, rows)

    def follow(self, headings: Array, rows: Rows, share: float = KEPT) -> None:
        """Solve beside a path; repeat with the solution as the path while the cost falls.

        Until a path is feasible, only the choices that it violates are made, and stay. A feasible
        path satisfies its half-spaces in the next solve, so from then on the cost cannot rise. The
        best path so far is followed on with free speeds, if turns are limited.

        Args:
            headings: of the path, R_0 e1..R_N e1, shape (N + 1, n).
            rows: half-spaces of the node.
            share: of the speeds on the path that is kept in the first solve, with a turn limit.
        """
        regions, held, cost = self._regions, rows, np.inf
        slow = coned = False
        for _ in range(FOLLOWED):
            if self._request.late:
                return
            missed = regions.missed(headings)
            if missed:
                # At first all floors, too: beside bodies the path would slow down and turn back.
                floors = regions.floors if held is rows else []
                held = held | regions.tangents(headings, [*missed, *floors], rows)
            else:
                flat = held is not rows and not any(map(regions.is_round, held))
                if flat or slow:  # flat sides stay where they are: there is little to gain
                    if coned or self._turns is None or self.cost < (1.0 - WORTH) * cost:
                        return
                    coned = True
                near = regions.beside(headings, BESIDE * self._problem.maps.unit)
                held = rows | regions.tangents(headings, [*regions.floors, *near], rows)
            x = self._solved(held, headings, share, coned)
            if x is None:
                return
            before, share = cost, KEPT
            headings, cost = self.offer(x)
            slow = not missed and cost > (1.0 - WORTH) * before

    def _solved(self, rows: Rows, headings: Array, share: float, coned: bool) -> Array | None:
        """Return the solution within half-spaces, shape (N, d); None if there is none.

        With a turn limit, headings are in cells about the path's, and chords between consecutive
        ones so short that no turn is too wide; but speeds can hardly change. If ``coned``, they are
        within cones about the path's, which has no wide turns: speeds are free.

        Args:
            rows: half-spaces by choice.
            headings: of a path, as in :meth:`follow`.
            share: of their speeds that is kept.
            coned: whether directions are limited instead of chords.
        """
        turns, state, chords = self._turns, self._request.state, None
        if turns is not None and coned:
            rows = rows | {ALWAYS: (*rows[ALWAYS], *turns.cones(state, headings))}
        elif turns is not None:
            cells = turns.cells(headings, share)
            chords, narrow = turns.close(cells), turns.rows(state, narrow=True)
            faced = {row.place: (row,) for row in cells}
            rows = rows | faced | {ALWAYS: (*rows[ALWAYS], *narrow)}
        relaxed = self.relax(rows, chords)
        return relaxed.x if relaxed.is_accurate else None
