# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What the bound of a search among boxes in space rests on, read off its tree.

A node that was solved has its own multipliers. One that was not has those of the node that it is a
part of, and one step along the row of its own that raises the bound the most.

Mathematics: docs/mathematics.md, 4.11, and docs/proofs.md.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels.half_spaces import MADE, NODES, PRECISION, Choices, SideTree, Space
from orbimpc_ros.mpc.proof.grounds import Left
from orbimpc_ros.mpc.solve.choice_nodes import ChoiceNodes, TreeLeaf

Row = tuple[int, int, Array, float]  # which of a side's, its place, normal and offset


class SideGrounds:
    """Reads the grounds of one search.

    Args:
        space: the quadratic that was searched.
        choices: that were to be made.
        tree: of the search.
    """

    def __init__(self, space: Space, choices: Choices, tree: SideTree) -> None:
        self._space, self._choices, self._tree = space, choices, tree
        self._solves = int(tree.counts[NODES])
        self._nodes, self._sides = ChoiceNodes(), [0]
        self._leaves: dict[int, TreeLeaf] = {}

    def grounds(self) -> Left:
        """Return all that the bound rests on."""
        made, nodes = self._children(), {0: 0}
        for solve in range(1, self._solves + 1):
            t = nodes[int(self._tree.made[solve])]
            self._leaves[t] = own = self._own(solve, t)
            group = int(self._tree.split[solve])
            if group >= 0:
                self._part(t, group, own, made.get(solve, {}), nodes)
        leaves = [self._leaves[t] for t in self._nodes.leaves]
        sides = np.array([[0] * len(self._sides), self._sides], np.int64)
        return self._nodes.grounds(sides, leaves)

    def _children(self) -> dict[int, dict[int, int]]:
        """Return the nodes that were made, by the solve they are a part of, and by their side."""
        tree, choices, made = self._tree, self._choices, int(self._tree.counts[MADE])
        found: dict[int, dict[int, int]] = {}
        for node in range(1, made):
            solve = int(tree.parent[node])
            group = int(tree.split[solve])
            side = int(tree.choice[node, group] - choices.first[group])
            found.setdefault(solve, {})[side] = node
        return found

    def _own(self, solve: int, t: int) -> TreeLeaf:
        """Return what a solve proves of a node."""
        tree, presses = self._tree, []
        empty = bool(tree.bounds[solve] == np.inf)
        for group, holder in self._nodes.holders[t].items():
            for i, size in enumerate(tree.pressed[solve, group].tolist()):
                if size > 0.0:
                    presses.append((holder, i, size))
        return TreeLeaf(tree.lowest[solve].copy(), tuple(presses), np.zeros((0, 3)), empty)

    def _part(
        self, t: int, group: int, own: TreeLeaf, made: dict[int, int], nodes: dict[int, int]
    ) -> None:
        """Add the parts of a node, but for those that nothing reaches."""
        reached = [
            side
            for side in range(int(self._choices.sizes[group]))
            if side in made or not self._is_out_of_reach(group, side)
        ]
        self._sides += reached
        places = places_of(self._space, own.point[:, :3])
        for number, side in zip(self._nodes.part(t, group, len(reached)), reached, strict=True):
            self._leaves[number] = self._raised(number, group, side, own, places)
            if side in made:
                nodes[made[side]] = number

    def _rows(self, group: int, side: int) -> list[Row]:
        choices = self._choices
        cell = int(choices.first[group]) + side
        normal, offset = choices.normals[cell], float(choices.offsets[cell])
        places = [(i, int(place)) for i, place in enumerate(choices.places[group]) if place >= 0]
        return [(i, place, normal, offset) for i, place in places]

    def _is_out_of_reach(self, group: int, side: int) -> bool:
        space, count = self._space, len(self._space.start)
        return any(
            offset - space.farthest[place - count] - normal @ space.coasting[place - count]
            > PRECISION
            for _, place, normal, offset in self._rows(group, side)
            if place >= count
        )

    def _raised(self, number: int, group: int, side: int, own: TreeLeaf, places: Array) -> TreeLeaf:
        """Return what is proved of a part by what is of the whole, and a step along a row.

        Args:
            number: of the part.
            group: that it has chosen for.
            side: that it has chosen.
            own: what is proved of the whole.
            places: where that is, shape (2N, 3).
        """
        inverse, best, known = self._space.inverse[0], 0.0, own
        for i, place, normal, offset in self._rows(group, side):
            curvature, short = float(inverse[place, place]), offset - float(normal @ places[place])
            if not (short > 0.0 and curvature > 0.0):
                continue
            step = short / curvature
            if 0.5 * short * step > best:
                best, column = 0.5 * short * step, inverse[: len(own.point), place]
                known = own.raised((number, i, step), column, normal)
        return known


def places_of(space: Space, headings: Array) -> Array:
    """Return headings R_1 e1..R_N e1, shape (N, 3), and where they lead: s_1..s_N, (2N, 3)."""
    return np.vstack([headings, space.coasting + space.reach @ headings])
