# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The proof of a search among boxes in space, read off its tree.

A node that was solved has its own multipliers. One that was not has those of the node that it is a
part of, and one step along the row of its own that raises the bound the most.

Mathematics: docs/mathematics.md, 4.10, and docs/proofs.md.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels.half_spaces import MADE, NODES, PRECISION, Choices, SideTree, Space
from orbimpc_ros.mpc.proof.tree import EMPTY, FACES, POINTS, SIDES, ProofTree
from orbimpc_ros.mpc.solve.proof_nodes import Held, Node, Row, tree_of


class SideProof:
    """Reads the proof of one search.

    Args:
        space: the quadratic that was searched.
        choices: that were to be made.
        tree: of the search.
        boxes: how many there are.
    """

    def __init__(self, space: Space, choices: Choices, tree: SideTree, boxes: int) -> None:
        self._space, self._choices, self._tree = space, choices, tree
        self._count = len(space.start)
        self._faces = int((choices.places[:, 0] < self._count).sum())
        self._each = (len(choices.first) - self._faces) // boxes
        self._solves = int(tree.counts[NODES])
        self._nodes, self._sides = [Node({}, 0)], [dict[int, int]()]
        self._leaves: dict[int, Held] = {}

    def proof(self) -> ProofTree:
        """Return the proof."""
        made, nodes = self._children(), {0: 0}
        for solve in range(1, self._solves + 1):
            t = nodes[int(self._tree.made[solve])]
            self._leaves[t] = own = self._own(solve, t)
            group = int(self._tree.split[solve])
            if group >= 0:
                del self._leaves[t]
                self._part(t, group, own, made.get(solve, {}), nodes)
        return tree_of(self._nodes, dict(sorted(self._leaves.items())))

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

    def _own(self, solve: int, t: int) -> Held:
        """Return what a solve proves of a node."""
        tree, empty = self._tree, bool(self._tree.bounds[solve] == np.inf)
        held = self._blank(tree.lowest[solve].copy(), empty=empty)
        for group, side in self._sides[t].items():
            for i, size in enumerate(tree.pressed[solve, group].tolist()):
                if size > 0.0:
                    held = held.pressed(self._row(group, side, i), size)
        return held

    def _blank(self, point: Array, *, empty: bool) -> Held:
        none, ends = np.zeros((self._count, 3)), np.zeros((0, 3))
        return Held(point, none, (), none, (ends, none, none), empty)

    def _choice_of(self, group: int) -> int:
        """Return the number that proofs have for a choice."""
        places = self._choices.places[group]
        if group < self._faces:
            return int(places[0])
        box = (group - self._faces) // self._each
        return (2 + box) * self._count + int(places[places >= 0][-1]) - self._count

    def _part(
        self, t: int, group: int, own: Held, made: dict[int, int], nodes: dict[int, int]
    ) -> None:
        """Add the parts of a node."""
        node, first, count = self._nodes[t], len(self._nodes), int(self._choices.sizes[group])
        node.kind = FACES if group < self._faces else SIDES
        node.choice, node.first, node.count = self._choice_of(group), first, count
        inverse = self._space.inverse[0, : self._count, : self._count]
        for side in range(count):
            self._nodes.append(Node({}, 0))
            self._sides.append({**self._sides[t], group: side})
            number, rows = first + side, self._rows(group, side)
            beyond = max(rows, key=lambda row: row.offset - np.abs(row.shares).sum())
            if side in made:
                nodes[made[side]] = number
            elif group >= self._faces and beyond.offset - np.abs(beyond.shares).sum() > PRECISION:
                held = self._blank(np.zeros((self._count, 9)), empty=True)
                self._nodes[number].kind = EMPTY
                self._leaves[number] = held.pressed(beyond, 1.0)
                continue
            free = [row for row in rows if row.shares.any()]
            self._leaves[number] = own.raised(free, inverse) if free else own

    def _rows(self, group: int, side: int) -> list[Row]:
        places = self._choices.places[group]
        return [self._row(group, side, i) for i in range(len(places)) if places[i] >= 0]

    def _row(self, group: int, side: int, i: int) -> Row:
        choices, cell = self._choices, int(self._choices.first[group]) + side
        normal, offset = choices.normals[cell], float(choices.offsets[cell])
        place = int(choices.places[group, i])
        if place < self._count:
            return Row(-1, place, np.eye(self._count)[place], normal, offset)
        step = place - self._count
        number = POINTS * (self._choice_of(group) - 2 * self._count) + i
        offset -= float(normal @ self._space.coasting[step])
        return Row(number, -1, self._space.reach[step], normal, offset)


def places_of(space: Space, headings: Array) -> Array:
    """Return headings R_1 e1..R_N e1, shape (N, 3), and where they lead: s_1..s_N, (2N, 3)."""
    return np.vstack([headings, space.coasting + space.reach @ headings])
