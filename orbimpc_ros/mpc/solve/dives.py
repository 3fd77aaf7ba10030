# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Primal heuristics: dives, guide paths and turn repair; the incumbent.

A *dive* adds a half-space for each choice that a solution violates, and solves again: for a
round floor the tangent in the direction of v, which implies |v| >= floor; for an obstacle the
side that is violated least. A *guide path* selects the sides on which balls and moving obstacles
are passed.

Mathematics: docs/mathematics.md, 4.9 and 4.11.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import holds
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.rotations import coordinates, margin
from orbimpc_ros.mpc.model.dynamics import Trajectory, trajectory_of
from orbimpc_ros.mpc.plan import UNPROVED, assemble
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.solve.regions import ALWAYS, Held, Regions
from orbimpc_ros.mpc.solve.relaxation import Relaxation, Relaxed, Row
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.stand_ins import in_time, turning
from orbimpc_ros.mpc.solve.turns import Cell, Turns

DIVE_STEPS = 4
PASSING_STEPS = 10  # of a dive among balls and moving obstacles
BESIDE = 2.0  # in units of a step's length: bodies farther from a path are not constrained by it
FOLLOWED = 8  # solves along a path, each with the solution before as its path
WORTH = 1e-3  # relative reduction of the cost that is worth another solve
ACCURATE = 1e-6  # the check's tolerance of orbitopes, and of arrivals in units of a step's length
ROUNDING = 1e-15  # relative to the coordinates of goals far from the origin
LEAST = 1e-9  # smallest denominator of a relative gap

Rows = dict[int, Held]  # half-spaces by choice


class NodeProgram:
    """A request with its regions and the convex program of its problem.

    Args:
        problem: what to solve.
        program: its relaxation.
        turns: the turn limit, if it bounds angles.
        request: state, goals, guess and deadline.
        regions: of the request.

    Attributes:
        solved: number of relaxations solved.
    """

    def __init__(
        self,
        problem: Problem,
        program: Relaxed,
        turns: Turns | None,
        request: Request,
        regions: Regions,
    ) -> None:
        self.problem, self.program, self.turns = problem, program, turns
        self.request, self.regions, self.solved = request, regions, 0

    def relax(self, held: Iterable[Held], chords: Array | None = None) -> Relaxation:
        """Solve the relaxation within half-spaces.

        Args:
            held: half-spaces of choices.
            chords: as in :meth:`orbimpc_ros.mpc.solve.relaxation.Relaxed.relax`.

        Raises:
            Infeasible: it was proved that no trajectory satisfies the constraints.
        """
        self.solved += 1
        return self.program.relax(self.request, [row for each in held for row in each], chords)

    def flown(self, x: Array) -> Trajectory:
        """Return the rollout of rotation coordinates, shape (N, d)."""
        return trajectory_of(self.problem, self.request.state, self.request.goals, x)

    def headings(self, x: Array) -> Array:
        """Return the headings R_0 e1..R_N e1, shape (N + 1, n), of rotation coordinates."""
        return np.concatenate(
            [self.request.state.rotation[None, :, 0], x[:, : self.problem.dimension]]
        )

    def missed(self, headings: Array) -> dict[int, float]:
        """Return the violation of each choice that headings, shape (N + 1, n), violate."""
        return self.regions.missed(headings[1:])

    def turns_in_time(self, headings: Array) -> bool:
        """Return True if every turn is within its angle; relaxations bound only its chord."""
        return self.turns is None or self.turns.hold(self.request.state, headings)


def is_accurate(problem: Problem, goals: Array, trajectory: Trajectory) -> bool:
    """Return True if orbitopes and a terminal constraint hold within the tolerance of plans.

    They may not after an interrupted or inaccurate solve, whose bound is valid nevertheless.
    """
    inside = bool(margin(trajectory.rotations[1:]).min() >= -ACCURATE)
    return inside and arrives(problem, goals, trajectory)


def arrives(problem: Problem, goals: Array, trajectory: Trajectory) -> bool:
    """Return True if there is no terminal constraint, or it holds to the tolerance of plans."""
    if problem.terminal != 'constraint':
        return True
    missed = np.abs(trajectory.positions[-1] - goals[-1]).max()
    if problem.inertial:
        missed = max(missed, problem.step * np.abs(trajectory.velocities[-1]).max())
    rounding = ROUNDING * np.abs(goals[-1]).max()
    return bool(missed <= ACCURATE * problem.length_unit + rounding)


class Dives:
    """Primal heuristics of one request, and the best trajectory found so far.

    Args:
        posed: the request with its regions and relaxation; its guess is the first trajectory.
        tolerance: relative gap at which the search stops.
        passing: whether there are balls or moving obstacles.

    Attributes:
        x: rotation coordinates, shape (N, d); None without a trajectory.
        cost: its objective; infinite without a trajectory.
    """

    def __init__(self, posed: NodeProgram, tolerance: float, *, passing: bool) -> None:
        self._posed, self._tolerance, guess = posed, tolerance, posed.request.guess
        self._steps = PASSING_STEPS if passing else DIVE_STEPS
        self.x = None if guess is None else guess.x
        self.cost = np.inf if guess is None else guess.cost

    @property
    def cutoff(self) -> float:
        """Return the bound from which on nodes are pruned: the cost less the tolerance."""
        if self.x is None:
            return np.inf
        return self.cost - self._tolerance * max(abs(self.cost), LEAST)

    def offer(self, x: Array, trajectory: Trajectory) -> None:
        """Accept a trajectory without violated choices if it is cheaper and feasible otherwise."""
        posed = self._posed
        if (
            trajectory.cost < self.cost
            and posed.turns_in_time(trajectory.headings)
            and is_accurate(posed.problem, posed.request.goals, trajectory)
        ):
            self.x, self.cost = x, trajectory.cost

    def stand_in(self) -> None:
        """Accept the first trajectory found without a search that passes the check of plans."""
        problem, request = self._posed.problem, self._posed.request
        known = problem, request.state, request.goals
        for rotations in in_time(turning(*known), request.out_of_time):
            x = coordinates(rotations)
            plan = assemble(*known, x, projection='nearest', proof=UNPROVED)
            if holds(*known, plan):
                self.x, self.cost = x, plan.objective
                return

    def follow(self, headings: Array, rows: Rows) -> None:
        """Solve with the sides on which a path passes; repeat with the solution as the path.

        A path that satisfies its half-spaces is feasible in that solve, so the cost cannot rise.

        Args:
            headings: R_1 e1..R_N e1 of the path, shape (N, n).
            rows: half-spaces of the root.
        """
        cost = np.inf
        for _ in range(FOLLOWED):
            if self._posed.request.late:
                return
            x = self._beside(headings, rows)
            if x is None:
                return
            trajectory = self._posed.flown(x)
            if not self._posed.missed(trajectory.headings):
                self.offer(x, trajectory)
            if trajectory.cost > (1.0 - WORTH) * cost:
                return
            headings, cost = trajectory.headings[1:], trajectory.cost

    def dive(self, rows: Rows, headings: Array) -> None:
        """Look for a trajectory: add a half-space for each violated choice, and solve again.

        Args:
            rows: half-spaces of the node.
            headings: solution of the node, inaccurate or with violated choices, (N + 1, n).
        """
        posed, regions = self._posed, self._posed.regions
        if posed.turns is not None:
            self.turn(rows, headings)
            if self.x is not None:
                return
        held = rows
        for _ in range(self._steps):
            if posed.request.late:
                return
            missed = list(posed.missed(headings)) or regions.round_floors
            if not missed:
                return
            held = held | regions.tangents(headings[1:], missed, rows)
            x = self._solved(held)
            if x is None:
                return
            headings = posed.headings(x)
            if not posed.missed(headings):  # tangents of round floors here may cost less
                self.offer(x, posed.flown(x))
                if not regions.round_floors:
                    return

    def turn(self, rows: Rows, headings: Array) -> None:
        """Look for a trajectory within the turn limit near headings, then near their speeds."""
        turns = self._posed.turns
        assert turns is not None
        reached = turns.reached(self._posed.request.state, headings)
        for around in (reached, turns.kept(headings)):
            self._turn_from(rows, headings, around)

    def _turn_from(self, rows: Rows, headings: Array, around: list[Cell]) -> None:
        """Look for a trajectory within the turn limit and in cells of the floor, one per step.

        The chords between consecutive headings are bounded so that no turn is too wide.
        """
        posed, held = self._posed, dict(rows)
        assert posed.turns is not None
        for _ in range(DIVE_STEPS):
            if posed.request.late:
                return
            missed = [c for c in posed.missed(headings) if c >= len(around)]
            held |= posed.regions.tangents(headings[1:], missed, rows)
            x = self._solved(held | _faced(around), posed.turns.close(around))
            if x is None:
                return
            headings = posed.headings(x)
            if not posed.missed(headings):
                self.offer(x, posed.flown(x))
            if not posed.turns_in_time(headings):
                return
            around = posed.turns.kept(headings)

    def _beside(self, headings: Array, rows: Rows) -> Array | None:
        """Return the best trajectory, shape (N, d), on the same sides as a path, or None.

        Args:
            headings: of the path, R_1 e1..R_N e1, shape (N, n).
            rows: half-spaces of the root.
        """
        posed, count = self._posed, len(headings)
        near = posed.regions.beside(headings, BESIDE * posed.problem.length_unit)
        if posed.turns is None:
            floors = range(count) if posed.problem.floor.exists else range(0)
            return self._solved(rows | posed.regions.tangents(headings, [*floors, *near], {}))
        around = posed.turns.kept(np.vstack([headings[:1], headings]))
        held = rows | _faced(around) | posed.regions.tangents(headings, near, {})
        return self._solved(held, posed.turns.close(around))

    def _solved(self, rows: Rows, chords: Array | None = None) -> Array | None:
        """Return the solution within half-spaces, shape (N, d); None if there is none."""
        posed = self._posed
        if chords is not None:
            assert posed.turns is not None
            narrow = posed.turns.rows(posed.request.state, narrow=True)
            rows = rows | {ALWAYS: (*rows.get(ALWAYS, ()), *narrow)}
        try:
            relaxed = posed.relax(rows.values(), chords)
        except Infeasible:
            return None
        return relaxed.x if relaxed.is_accurate else None


def _faced(cells: list[Cell]) -> Rows:
    """Return the half-spaces of cells as rows on headings, by step."""
    units = np.eye(len(cells))
    return {k: (Row(k, units[k], cell.normal, cell.offset),) for k, cell in enumerate(cells)}
