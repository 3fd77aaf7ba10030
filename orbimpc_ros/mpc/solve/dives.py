# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Trajectories for a search: along ways, near solutions, and turning in time; the best of them.

A *dive* holds all that a solution misses by tangents, and solves again: of a round floor the one in
the direction of v, beyond which |v| is surely above the floor, of a body the side that it misses
least. A *way* is followed on the sides on which it passes what is round or moves.

Mathematics: docs/mathematics.md, 4.9 and 4.11.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.faces import Cell
from orbimpc_ros.mpc.geometry.rotations import margin
from orbimpc_ros.mpc.model.dynamics import Trajectory, trajectory_of
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.solve.regions import ALWAYS, Held, Regions
from orbimpc_ros.mpc.solve.relaxation import Relaxation, Relaxed, Row
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.turns import Turns

DIVE_STEPS = 4
PASSING_STEPS = 10  # of a dive among what is round or moves
BESIDE = 2.0  # steps' lengths from a way: what is farther away does not guide it
FOLLOWED = 8  # times that a way is followed anew
WORTH = 1e-3  # share of the cost that makes it worth while
ACCURATE = 1e-6  # on the orbitope, and on an arrival in units of a step's length: as the check's
ROUNDING = 1e-15  # of the coordinates of goals far from the origin
LEAST = 1e-9  # cost that a gap is measured against

Rows = dict[int, Held]  # half-spaces by choice


class NodeProgram:
    """One request, its regions, and the convex program of the problem.

    Args:
        problem: what to solve.
        program: its relaxation.
        turns: where turns are angles.
        request: state, goals, guess and deadline.
        regions: of the request.

    Attributes:
        solved: relaxations so far.
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
            chords: how far headings may turn, where that is to be less than the problem says.

        Raises:
            Infeasible: proved that no trajectory satisfies the constraints.
        """
        self.solved += 1
        return self.program.relax(self.request, [row for each in held for row, _ in each], chords)

    def flown(self, x: Array) -> Trajectory:
        """Return the trajectory of rotation coordinates, shape (N, d)."""
        return trajectory_of(self.problem, self.request.state, self.request.goals, x)

    def missed(self, trajectory: Trajectory) -> dict[int, float]:
        """Return, by choice that a trajectory does not satisfy, by how much."""
        return self.regions.missed(trajectory.headings[1:])

    def turns_in_time(self, trajectory: Trajectory) -> bool:
        """Return whether no turn, which relaxations bound by its chord, is too wide an angle."""
        return self.turns is None or self.turns.hold(self.request.state, trajectory.headings)


class Incumbent:
    """The best trajectory found.

    Args:
        posed: what is searched, with a guess to begin with.
        tolerance: relative gap at which the search stops.

    Attributes:
        x: its rotation coordinates, shape (N, d); None as long as there is none.
        cost: of it, infinite as long as there is none.
    """

    def __init__(self, posed: NodeProgram, tolerance: float) -> None:
        self._posed, self._tolerance, guess = posed, tolerance, posed.request.guess
        self.x = None if guess is None else guess.x
        self.cost = np.inf if guess is None else guess.cost

    @property
    def cutoff(self) -> float:
        """Return the bound from which on a node cannot improve on it by enough."""
        if self.x is None:
            return np.inf
        return self.cost - self._tolerance * max(abs(self.cost), LEAST)

    def offer(self, x: Array, trajectory: Trajectory) -> None:
        """Take a trajectory that misses no choice, if it is better, turns in time and arrives."""
        posed = self._posed
        if (
            trajectory.cost < self.cost
            and posed.turns_in_time(trajectory)
            and is_accurate(posed.problem, posed.request.goals, trajectory)
        ):
            self.x, self.cost = x, trajectory.cost


def is_accurate(problem: Problem, goals: Array, trajectory: Trajectory) -> bool:
    """Return whether a relaxation's solution holds what is not branched on as well as plans must.

    One that was interrupted, or is not accurate, proves a bound all the same.
    """
    inside = bool(margin(trajectory.rotations[1:]).min() >= -ACCURATE)
    return inside and arrives(problem, goals, trajectory)


def arrives(problem: Problem, goals: Array, trajectory: Trajectory) -> bool:
    """Return whether a terminal constraint, if there is one, is met as well as plans must."""
    if problem.terminal != 'constraint':
        return True
    missed = np.abs(trajectory.positions[-1] - goals[-1]).max()
    if problem.inertial:
        missed = max(missed, problem.step * np.abs(trajectory.velocities[-1]).max())
    rounding = ROUNDING * np.abs(goals[-1]).max()
    return bool(missed <= ACCURATE * problem.length_unit + rounding)


class Dives:
    """Looks for trajectories of one request.

    Args:
        posed: what is searched.
        best: which is offered them.
        passing: whether anything is round or moves.
    """

    def __init__(self, posed: NodeProgram, best: Incumbent, *, passing: bool) -> None:
        self._posed, self._best = posed, best
        self._steps = PASSING_STEPS if passing else DIVE_STEPS

    def follow(self, headings: Array, rows: Rows) -> None:
        """Hold tangents where a way passes, solve, and go on from what that finds.

        Each time costs less: where the way satisfies all that it is held by, so does it again.

        Args:
            headings: R_1 e1..R_N e1 of the way, shape (N, n).
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
            if not self._posed.missed(trajectory):
                self._best.offer(x, trajectory)
            if trajectory.cost > (1.0 - WORTH) * cost:
                return
            headings, cost = trajectory.headings[1:], trajectory.cost

    def dive(self, rows: Rows, trajectory: Trajectory) -> None:
        """Look for a trajectory: hold whatever is missed by tangents, and solve again.

        Args:
            rows: half-spaces of the node that the trajectory solves.
            trajectory: which misses something, or is not accurate.
        """
        posed, regions = self._posed, self._posed.regions
        if posed.turns is not None:
            self.turn(rows, trajectory)
            if self._best.x is not None:
                return
        held = rows
        for _ in range(self._steps):
            if posed.request.late:
                return
            missed = list(posed.missed(trajectory)) or regions.round_floors
            if not missed:
                return
            held = held | regions.tangents(trajectory.headings[1:], missed, rows)
            x = self._solved(held)
            if x is None:
                return
            trajectory = posed.flown(x)
            if not posed.missed(trajectory):  # tangents of round floors there may descend further
                self._best.offer(x, trajectory)
                if not regions.round_floors:
                    return

    def turn(self, rows: Rows, trajectory: Trajectory) -> None:
        """Look for a trajectory that turns in time, near this one's headings, then its speeds."""
        turns = self._posed.turns
        assert turns is not None
        reached = turns.reached(self._posed.request.state, trajectory.headings)
        for around in (reached, turns.kept(trajectory.headings)):
            self._turn_from(rows, trajectory, around)

    def _turn_from(self, rows: Rows, trajectory: Trajectory, around: list[Cell]) -> None:
        """Look for a trajectory that turns in time, near cells of the floor, one for each step.

        Consecutive headings are held so close to each other that no angle is too wide.
        """
        posed, held = self._posed, dict(rows)
        assert posed.turns is not None
        for _ in range(DIVE_STEPS):
            if posed.request.late:
                return
            missed = [c for c in posed.missed(trajectory) if c >= len(around)]
            held |= posed.regions.tangents(trajectory.headings[1:], missed, rows)
            x = self._solved(held | _faced(around), posed.turns.close(around))
            if x is None:
                return
            trajectory = posed.flown(x)
            if not posed.missed(trajectory):
                self._best.offer(x, trajectory)
            if not posed.turns_in_time(trajectory):
                return
            around = posed.turns.kept(trajectory.headings)

    def _beside(self, headings: Array, rows: Rows) -> Array | None:
        """Return the best trajectory, shape (N, d), that passes where a way does; None without.

        Args:
            headings: of the way, R_1 e1..R_N e1, shape (N, n).
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
        """Return the solution within half-spaces, shape (N, d); None without one."""
        posed = self._posed
        if chords is not None:
            assert posed.turns is not None
            narrow = posed.turns.rows(posed.request.state, narrow=True)
            rows = rows | {ALWAYS: (*rows.get(ALWAYS, ()), *((row, -1) for row in narrow))}
        try:
            relaxed = posed.relax(rows.values(), chords)
        except Infeasible:
            return None
        return relaxed.x if relaxed.is_accurate else None


def _faced(cells: list[Cell]) -> Rows:
    """Return the half-spaces that headings are held beyond."""
    units = np.eye(len(cells))
    return {k: ((Row(k, units[k], cell.normal, cell.offset), -1),) for k, cell in enumerate(cells)}
