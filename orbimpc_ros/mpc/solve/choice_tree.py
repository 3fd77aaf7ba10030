# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What the bound of a search over choices rests on, noted while it goes on.

A node that was solved has the multipliers of its relaxation. One that was not has those of the node
that it is a part of, and one step along the row of its own that raises the bound the most
(:mod:`orbimpc_ros.mpc.solve.branching`).

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.cells import Cell, Patch
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.proof.grounds import Left
from orbimpc_ros.mpc.solve.branching import Branch
from orbimpc_ros.mpc.solve.choice_nodes import ChoiceNodes, Press, TreeLeaf
from orbimpc_ros.mpc.solve.passages import Passage
from orbimpc_ros.mpc.solve.posed import Posed
from orbimpc_ros.mpc.solve.relaxation import Multipliers, Relaxed


class ChoiceTree:
    """The nodes of one search.

    Args:
        posed: what is searched.
        program: its relaxation.
        inverse: H^-1, shape (N, N).
    """

    def __init__(self, posed: Posed, program: Relaxed, inverse: Array) -> None:
        self._posed, self._program, self._inverse = posed, program, inverse
        turns = posed.turns
        self._always = len(turns.slots) if turns else 0
        planar = posed.problem.dimension == 2
        self._edges = 2 * (planar and posed.problem.first_turn_is_a_cone)
        self._nodes = ChoiceNodes(apart=posed.problem.rotation_order == 1)
        self._cells: list[tuple[int, Cell] | None] = [None]
        self._raised: list[tuple[int, int, float] | None] = [None]
        self._solved: dict[int, TreeLeaf | None] = {}
        self._worse: set[int] = set()

    @property
    def leaves(self) -> int:
        """Return how many nodes are not split."""
        return len(self._nodes.leaves)

    @staticmethod
    def tells(problem: Problem) -> bool:
        """Return whether programs tell of all the multipliers that their bounds rest on."""
        second, limited = problem.rotation_order > 1, problem.max_rate > 0.0
        coned = problem.has_cones and (problem.approach.exists or second or limited)
        return not (coned or (second and limited))

    def solved(self, t: int, *, better: bool = True, empty: bool = False) -> None:
        """Note what the last relaxation, which was that of a node, rests on.

        Args:
            t: number of the node.
            better: whether its bound is no less than what was known of the node.
            empty: whether it proved that nothing is in the node.
        """
        found = self._program.multipliers
        self._solved[t] = None if found is None else self._leaf(t, found, empty)
        if not better:
            self._worse.add(t)

    def split(self, t: int, branch: Branch) -> range:
        """Note the parts of a node that was solved, and return their numbers."""
        self._cells += [(branch.split, cell) for cell in branch.cells]
        steps = zip(branch.rows.tolist(), branch.steps.tolist(), strict=True)
        self._raised += [(t, row, step) for row, step in steps]
        return self._nodes.part(t, branch.split, len(branch.cells))

    def grounds(self, most: int | None = None) -> Left | None:
        """Return all that the bound rests on; None where something is not known.

        Args:
            most: nodes to tell of, the first ones, which prove less; None for all.
        """
        nodes = self._nodes if most is None else self._nodes.first(most)
        leaves = [self._made(t) for t in nodes.leaves]
        known = [leaf for leaf in leaves if leaf is not None]
        if len(known) < len(leaves):
            return None
        return nodes.grounds(self._sides(len(nodes.splits)), known)

    # --- leaves

    def _leaf(self, t: int, found: Multipliers, empty: bool) -> TreeLeaf:
        steps, n = len(found.point), self._posed.problem.dimension
        held = list(zip(found.rows.tolist(), found.sizes.tolist(), strict=True))
        asked = self._asked(t) if any(row >= 0 for row, _ in held) else []
        presses = [(*asked[row], size) for row, size in held if row >= 0]
        tethers = np.zeros((self._program.chords, n))
        for (row, size), normal in zip(held, found.normals, strict=True):
            if -1 - row >= steps:
                tethers[-1 - row - steps] -= size * normal
        presses += self._arrived(found.pull)
        first = self._always + self._edges + 2 * len(found.pull)
        presses += [(0, first + i, each) for i, each in enumerate(found.props.tolist()) if each]
        return TreeLeaf(found.point, tuple(presses), tethers, empty, found.leans, found.ways)

    def _arrived(self, pull: Array) -> list[Press]:
        """Return an arrival's multipliers as those of the half-spaces that leave nothing else."""
        first = self._always + self._edges
        every = enumerate(pull.tolist())
        return [(0, first + 2 * i + int(each > 0.0), abs(each)) for i, each in every if each]

    def _asked(self, t: int) -> list[tuple[int, int]]:
        """Return, of each half-space of a node's relaxation, who holds it, and which it is."""
        posed, asked = self._posed, []
        holders = sorted(self._nodes.holders[t].items())
        for j, holder in holders:
            if j < posed.fixed:
                asked += [(holder, i) for i in range(len(posed.disjunctions[j].steps))]
        asked += [(0, i) for i in range(self._always)]
        for j, holder in holders:
            passage = posed.alternatives[j]
            if isinstance(passage, Passage):
                asked += [(holder, int(i)) for i in np.flatnonzero(passage.moved)]
        return asked + [(0, self._always + i) for i in range(self._edges)]

    def _made(self, t: int) -> TreeLeaf | None:
        """Return what is best known of a leaf."""
        own = self._solved.get(t)
        if own is not None and t not in self._worse:
            return own
        raised = self._raised[t]
        if raised is None:
            return own
        before, row, step = raised
        known = self._solved[before]
        if known is None:
            return None
        if step == 0.0:
            return known
        chosen = self._cells[t]
        assert chosen is not None
        j, cell = chosen
        return known.raised((t, row, step), self._moved(j, row), cell.normal)

    def _moved(self, j: int, row: int) -> Array:
        """Return H^-1 a of a row of a choice, shape (N,)."""
        choice = self._posed.alternatives[j]
        if isinstance(choice, Passage):
            return np.asarray(self._inverse @ choice.rows[row])
        step = choice.steps[row]
        if choice.on == 'position':
            return np.asarray(self._inverse @ self._posed.problem.maps.reach[step - 1, 1:])
        return self._inverse[:, step - 1]

    # --- sides

    def _sides(self, count: int) -> np.ndarray:
        """Return levels and sides of the first nodes, shape (2, T)."""
        told, numbers = [(0, 0)], dict[int, dict[int, int]]()  # of its cells, by choice
        for j, cell in filter(None, self._cells[:count]):
            if isinstance(cell, Patch):
                told.append(_arc(cell) if len(cell.corners) == 2 else self._triangle(j, cell))
                continue
            if j not in numbers:
                cells = self._posed.alternatives[j].cells
                numbers[j] = {id(each): i for i, each in enumerate(cells)}
            told.append((0, numbers[j][id(cell)]))
        return np.array(told, np.int64).T.copy()

    def _triangle(self, j: int, patch: Patch) -> tuple[int, int]:
        """Return how often a patch that a sphere begins with was split, and which part it is."""
        choice = self._posed.alternatives[j]
        begin, first = choice.cells, 0
        upright = () if isinstance(choice, Passage) else choice.upright
        if upright and self._posed.cells(j, None) is upright:
            begin, first = upright, len(begin)
        cells = tuple(each for each in begin if isinstance(each, Patch))
        i = _around(cells, patch.normal)
        level, side = 0, first + i
        while not np.array_equal(cells[i].corners, patch.corners):
            cells = cells[i].parts()
            i = _around(cells, patch.normal)
            level, side = level + 1, len(cells) * side + i
        return level, side


def _around(cells: Sequence[Patch], direction: Array) -> int:
    """Return which of some triangles a direction is in."""
    within = [np.linalg.solve(each.corners.T, direction).min() for each in cells]
    return int(np.argmax(within))


def _arc(patch: Patch) -> tuple[int, int]:
    """Return how often a quarter of a circle was halved, and which part it is."""
    (ax, ay), (bx, by) = patch.corners
    width = math.atan2(ax * by - ay * bx, ax * bx + ay * by)
    level = round(math.log2(0.5 * math.pi / width))
    parts = 4 << level
    middle = math.atan2(patch.normal[1], patch.normal[0]) % (2.0 * math.pi)
    return level, int(middle / (2.0 * math.pi) * parts) % parts
