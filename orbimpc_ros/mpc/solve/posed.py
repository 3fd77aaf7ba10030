# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A request, and all that is to be chosen for it: what choices ask for, and which are missed.

Mathematics: docs/mathematics.md, 4.9.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.cells import Cell
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED
from orbimpc_ros.mpc.model.dynamics import Trajectory, trajectory_of
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.problem.cones import relief
from orbimpc_ros.mpc.solve.disjunction import Disjunction, shortfall
from orbimpc_ros.mpc.solve.passages import Passage, Passages
from orbimpc_ros.mpc.solve.relaxation import Halfspace, Relaxation, Relaxed
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.turns import Turns

SATISFIED = 1e-7  # a cell missed by less holds; a tenth of what the plan's check allows

Choice = tuple[Cell | None, ...]
Missed = dict[int, tuple[float, Array]]  # by choice: by how much, and the values it sees


class Posed:
    """One request, with the choices of its problem and of what it passes.

    Args:
        problem: what to solve.
        program: its relaxation.
        disjunctions: the problem's choices.
        turns: where turns are angles.
        request: state, goals, guess and deadline.
        passages: the choices of what is round or moves.

    Attributes:
        solved: relaxations so far.
        alternatives: the choices: disjunctions, then passages.
        fixed: how many of them are the problem's.
    """

    def __init__(
        self,
        problem: Problem,
        program: Relaxed,
        disjunctions: Sequence[Disjunction],
        turns: Turns | None,
        request: Request,
        passages: Passages | None = None,
    ) -> None:
        self.problem, self.request, self.turns, self.passages = problem, request, turns, passages
        self.disjunctions, self.fixed, self.solved = disjunctions, len(disjunctions), 0
        self.alternatives: list[Disjunction | Passage] = [*disjunctions]
        if passages is not None:
            self.alternatives += passages.choices
        self._program = program
        eased = relief(problem, request.state, request.goals).tilt if problem.tilt else ()
        self._upright = [not each for each in eased]

    @property
    def late(self) -> bool:
        """Return whether the deadline has passed."""
        return self.request.late

    @property
    def has_patches(self) -> bool:
        """Return whether patches of a sphere are chosen from: certificates have no words for it."""
        return self.problem.dimension == 3 and any(each.radius for each in self.alternatives)

    @property
    def undecided(self) -> Choice:
        """Return the choice of a root: nothing is chosen."""
        return (None,) * len(self.alternatives)

    def relax(
        self, choice: Sequence[Cell | None], chords: Array | None = None, *, narrow: bool = False
    ) -> Relaxation:
        """Solve the relaxation at a choice.

        Args:
            choice: a cell, or none yet, of each alternative.
            chords: how far headings may turn, where that is to be less than the problem says.
            narrow: whether the first turn is to be surely in time.

        Raises:
            Infeasible: proved that no trajectory satisfies the constraints.
        """
        self.solved += 1
        return self._program.relax(self.request, self._halfspaces(choice, narrow), chords)

    def flown(self, x: Array) -> Trajectory:
        """Return the trajectory of rotation coordinates, shape (N, d)."""
        return trajectory_of(self.problem, self.request.state, self.request.goals, x)

    def cells(self, j: int, held: Cell | None) -> Sequence[Cell]:
        """Return the alternatives that a choice leaves: fewer where the tilt is limited."""
        choice = self.alternatives[j]
        cells = choice.cells if held is None else held.parts()
        if isinstance(choice, Passage):
            return choice.possible(cells)
        if held is None and choice.upright and self._upright[choice.steps[0] - 1]:
            return choice.upright
        return cells

    def nearest(self, j: int, values: Array, held: Cell | None) -> Cell | None:
        """Return the cell that values, shape (K, n), miss least; of a round floor, the tangent."""
        choice = self.alternatives[j]
        if isinstance(choice, Passage):
            return choice.nearest(values)
        if not choice.radius:
            if held is not None:
                return held
            short = shortfall(choice.cells, values).max(axis=1)
            return choice.cells[int(np.argmin(short))]
        norm = float(np.linalg.norm(values[0]))
        return Cell(values[0] / norm, choice.radius) if norm > HEADING_UNDEFINED else held

    def missed(self, trajectory: Trajectory) -> Missed:
        """Return, by choice that is not satisfied, by how much and the values it sees."""
        missed = {}
        for j, disjunction in enumerate(self.disjunctions):
            values = disjunction.values(trajectory.headings, trajectory.positions)
            by = disjunction.missed_by(values)
            if by > SATISFIED:
                missed[j] = (by, values)
        if self.passages is not None:
            near = self.passages.near(trajectory.headings[1:], -SATISFIED)
            missed |= {self.fixed + j: each for j, each in near.items()}
        return missed

    def round_floors(self, trajectory: Trajectory) -> Missed:
        """Return the values that round floors see, as if they were just missed."""
        return {
            j: (0.0, each.values(trajectory.headings, trajectory.positions))
            for j, each in enumerate(self.disjunctions)
            if each.radius
        }

    def turns_in_time(self, trajectory: Trajectory) -> bool:
        """Return whether no turn, which relaxations bound by its chord, is too wide an angle."""
        return self.turns is None or self.turns.hold(self.request.state, trajectory.headings)

    def _halfspaces(self, choice: Sequence[Cell | None], narrow: bool) -> Iterator[Halfspace]:
        slot = 0
        for disjunction, cell in zip(self.disjunctions, choice, strict=False):
            for _ in disjunction.steps:
                if cell is not None:
                    yield slot, cell.normal, cell.offset
                slot += 1
        yield from self._turned(slot, narrow)
        passages = [] if self.passages is None else self.passages.choices
        for passage, cell in zip(passages, choice[self.fixed :], strict=True):
            if cell is not None:
                yield from passage.halfspaces(cell)

    def _turned(self, slot: int, narrow: bool) -> Iterator[Halfspace]:
        """Yield the half-spaces of all turns so far, for the slots after those of disjunctions."""
        turns, ahead = self.turns, self.request.state.attitude[:, 0]
        for i, each in enumerate(turns.slots if turns else ()):
            assert turns is not None
            first = narrow and each.step == 1
            yield slot + i, ahead, turns.narrow if first else turns.ahead(each.step)
