# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A tree of choices in the words of certificates: splits, and leaves with their multipliers.

What a floor asks of headings, certificates hold without multipliers. A leaf that nothing is in
costs as much as its multipliers are large, and so does a side that nothing reaches.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Ball, Problem, State
from orbimpc_ros.mpc.problem.traffic import traffic_of
from orbimpc_ros.mpc.problem.units import Units
from orbimpc_ros.mpc.proof.certificate import Leaf, Tree, in_users_units, split_into
from orbimpc_ros.mpc.proof.choices import set_row
from orbimpc_ros.mpc.proof.grounds import LEAF, ChoiceGrounds
from orbimpc_ros.mpc.proof.sides import ARCS, PATCHES, Sides
from orbimpc_ros.mpc.proof.slopes import HALF, terms_of
from orbimpc_ros.mpc.proof.spatial import quadratic, top

AMPLE = 2.0  # times the multipliers that would do
QUARTER = 0.5 * math.pi
NOBODY = -1  # in the place of a node, or of the number of a row, that a tree does not know
NONE = np.zeros((0, 0))
Arc = tuple[int, int]  # how often a quarter was halved, and which side it is then; of others 0


class Row(NamedTuple):
    """What is known of a place on a side: normal . place >= least, in natural units.

    Attributes:
        holder: the node on whose side it is.
        number: which of the side's rows it is; ``NOBODY`` of those that trees do not know.
        place: what it is about.
        normal: shape (n,).
        least: how far it is out.
        said: whether certificates have a multiplier of it: they know floors without.
    """

    holder: int
    number: int
    place: int
    normal: Array
    least: float
    said: bool = True


class Word(NamedTuple):
    """How certificates call a choice.

    Attributes:
        step: k >= 1.
        wall: its number; None of a floor.
        more: how many rows its sides have there before those that trees know.
    """

    step: int
    wall: int | None
    more: int = 0


class Held(NamedTuple):
    """Multipliers, and what they come to: worth + forces . z is at most 0 of z = R_1 e1..R_N e1.

    Attributes:
        presses: of rows, shape (rows,).
        tethers: shape (N, n), or (0,) where turns have none.
        forces: shape (N, n).
        worth: in natural units.
    """

    presses: Array
    tethers: Array
    forces: Array
    worth: float

    def times(self, size: float) -> Held:
        """Return multipliers so many times as large."""
        presses, tethers, forces = (size * each for each in self[:3])
        return Held(presses, tethers, forces, size * self.worth)


class ChoiceWords:
    """Says what a tree of choices is.

    Args:
        problem: of a kind that such trees are counted of.
        state: where plans start.
        goals: g_1..g_N, shape (N, n) [m].
        grounds: the tree.
        bound: what it proves.
    """

    def __init__(
        self, problem: Problem, state: State, goals: Array, grounds: ChoiceGrounds, bound: float
    ) -> None:
        self._problem, self._grounds = problem, grounds
        self._units = units = Units.of(problem)
        self._bound = bound / units.cost
        scaled = units.problem, units.state(state), units.lengths(goals)
        self._hessians, self._q = quadratic(*scaled, grounds.points.shape[2])
        sides = Sides(problem, terms_of(problem))
        self._places, self._always = sides.places(state), sides.always(state, goals)
        self._choices, self._faces = sides.alternatives(state, goals, self._places), sides.faces
        self._words = list(self._called(state))
        self._numbers = np.cumsum(grounds.splits == LEAF) - 1  # of leaves
        self._tied = 0.0 < problem.step * problem.max_rate < HALF and not problem.floor.exists

    @property
    def origins(self) -> Array | None:
        """Return from where directions of headings are counted; None where none are split."""
        made = set(self._grounds.splits.tolist()) - {LEAF}
        split = any(self._words[j].wall is None and self._choices.kinds[j] == ARCS for j in made)
        return np.zeros(self._problem.horizon) if split else None

    def tree(self) -> Tree | None:
        """Return it in the user's units; None where there are no words for something."""
        made = self._node(0, self._arrival, {}) if self._has_words else None
        return None if made is None else in_users_units(made, self._units)

    @property
    def _has_words(self) -> bool:
        """Return whether there are words for all that is split, and that holds of all."""
        problem = self._problem
        if problem.has_cones or problem.approach.exists:
            return False
        if problem.rotation_order == 2:  # of whose hull alone there are certificates
            return not (len(self._words) or problem.max_rate or problem.weights.length)
        if problem.dimension == 3:
            patched = bool((self._choices.kinds == PATCHES).any())
            return not (problem.floor.exists or problem.weights.length or patched)
        return not (self.origins is not None and problem.max_rate)  # from the attitude on

    # --- choices

    @property
    def _arrival(self) -> tuple[Row, ...]:
        """Return the rows that leave but an arrival, after those of turns: up, down by axis."""
        always, problem = self._always, self._problem
        if problem.terminal != 'constraint':
            return ()
        count = 2 * problem.dimension * (1 + problem.inertial)
        known = zip(always.places.tolist(), always.normals, always.offsets.tolist(), strict=True)
        rows = [Row(0, i, *each, said=False) for i, each in enumerate(known)]
        return tuple(rows[-count:])

    def _called(self, state: State) -> Iterator[Word]:
        """Yield the words for all choices, in their order."""
        problem = self._problem
        count, walls = problem.horizon, len(problem.boxes)
        if problem.floor.exists:
            yield from (Word(k, None) for k in range(1, count + 1))
        both = problem.no_corner_cutting and count > 1  # from the second step on
        for j in range(walls):
            yield from (Word(k, j) for k in range(1 + both, count + 1))
        traffic = traffic_of(problem, state)
        for body in traffic.bodies if traffic else ():
            ball = isinstance(body, Ball)  # whose ends are a wall of their own
            for k in range(1, count + 1):
                yield Word(k, walls + ball)
                yield Word(k, walls, 0 if ball else problem.translation.degree)
            walls += 1 + ball

    def _node(self, t: int, known: tuple[Row, ...], arcs: dict[int, Arc]) -> Tree | None:
        """Return what a node is, with the rows that hold there, and the arcs that it is within."""
        j = int(self._grounds.splits[t])
        if j == LEAF:
            return self._leaf(t, known)
        first, count = int(self._grounds.parts[t]), int(self._grounds.counts[t])
        nodes = {int(self._grounds.sides[part]): part for part in range(first, first + count)}

        def part(at: Arc) -> Tree | None:
            node = nodes.get(at[1], NOBODY)
            rows = self._rows(j, at, node)
            if node == NOBODY:
                return self._out_of_reach(known, rows)
            return self._node(node, (*known, *rows), {**arcs, j: at})

        if self._choices.kinds[j] == ARCS:
            return self._by_angles(j, arcs.get(j), part)
        wall = self._words[j].wall
        sides = len(self._faces.normals) if wall is None else 2 * self._problem.dimension
        return split_into((part((0, i)) for i in range(sides)), self._words[j].step, wall=wall)

    def _by_angles(
        self, j: int, arc: Arc | None, part: Callable[[Arc], Tree | None]
    ) -> Tree | None:
        """Return the split of all directions into quarters, or of an arc into halves."""
        step, wall, _ = self._words[j]
        if arc is not None:
            level, first = arc[0] + 1, 2 * arc[1]
            at = QUARTER / 2**level * (first + 1)
            return split_into(map(part, ((level, first), (level, first + 1))), step, at, wall)
        halves = (
            split_into(map(part, ((0, i), (0, i + 1))), step, QUARTER * (i + 1), wall)
            for i in (0, 2)
        )
        return split_into(halves, step, 2.0 * QUARTER, wall)

    def _rows(self, j: int, at: Arc, node: int) -> tuple[Row, ...]:
        """Return the rows of a side, in the order of certificates."""
        _, wall, more = self._words[j]
        known, n = self._choices, self._problem.dimension
        if known.kinds[j] == ARCS and not known.sizes[j]:
            return ()  # what has shrunk to nothing asks for nothing
        rows = [Row(node, NOBODY, 0, np.zeros(n), 0.0)] * more
        for i in range(int(known.counts[j])):
            normal = np.empty(n)
            least = set_row(known, j, at, i, self._faces, normal)
            rows.append(Row(node, i, int(known.places[j]) + i, normal, least, wall is not None))
        return tuple(rows)

    # --- leaves

    def _leaf(self, t: int, known: tuple[Row, ...]) -> Leaf | None:
        """Return a leaf with rows that hold there; None if something else has a multiplier."""
        grounds, number = self._grounds, int(self._numbers[t])
        begin = int(grounds.ends[number - 1]) if number else 0
        told = slice(begin, int(grounds.ends[number]))
        sizes: defaultdict[tuple[int, int], float] = defaultdict(float)
        for holder, row, size in zip(*(each[told].tolist() for each in grounds[8:11]), strict=True):
            sizes[holder, row] += size
        presses = [sizes.pop((row.holder, row.number), 0.0) for row in known]
        tethers = grounds.tethers[number]
        if any(sizes.values()) or (tethers.any() and not self._tied):
            return None
        held = self._held(known, np.array(presses), tethers if self._tied else NONE)
        if grounds.empty[number]:
            return self._lifted(known, held)
        point, wide = grounds.points[number], self._q.shape[1] == 9
        left = self._left(point, held.forces)
        tops = np.array([top(each) for each in left]) if wide else None
        lengths = self._problem.weights.length > 0.0
        shares = left * self._is_faced(known)[:, None] if lengths else None
        return replace(_pressing(known, held), point=point, tops=tops, shares=shares)

    def _left(self, point: Array, forces: Array) -> Array:
        """Return what multipliers leave of the slopes at a point, shape (N, d)."""
        slopes = [h @ x for h, x in zip(self._hessians, point.T, strict=True)]
        left: Array = np.column_stack(slopes) + self._q
        left[:, : forces.shape[1]] += forces
        return left

    def _is_faced(self, known: Sequence[Row]) -> np.ndarray:
        """Return which headings are known to be beyond a face, shape (N,)."""
        told = [row.place for row in known if row.holder and not row.said]
        polygonal = self._problem.floor.shape == 'polygon'
        return np.isin(np.arange(self._problem.horizon), told if polygonal else [])

    def _held(self, known: Sequence[Row], presses: Array, tethers: Array) -> Held:
        """Return multipliers with what they come to."""
        forces, worth = np.zeros((self._problem.horizon, self._problem.dimension)), 0.0
        for y, row in zip(presses, known, strict=True):
            if y:
                forces -= y * np.outer(self._places.maps[row.place], row.normal)
                worth += y * (row.least - row.normal @ self._places.free[row.place])
        if len(tethers):
            forces += tethers
            forces[:-1] -= tethers[1:]
            sizes = np.linalg.norm(tethers, axis=1)
            worth -= tethers[0] @ self._always.first + self._always.chord * sizes.sum()
        return Held(presses, tethers, forces, worth)

    def _out_of_reach(self, known: tuple[Row, ...], rows: tuple[Row, ...]) -> Leaf | None:
        """Return the leaf of a side that nothing reaches: one of its rows says so."""
        every = (*known, *rows)
        alone = [
            self._held(every, np.eye(len(every))[i], NONE)
            for i in range(len(known), len(every))
            if every[i].number != NOBODY
        ]
        return self._lifted(every, max(alone, key=_gap)) if alone else None

    def _lifted(self, known: Sequence[Row], held: Held) -> Leaf | None:
        """Return the leaf of a part that multipliers prove empty, so large that it costs enough."""
        gap = _gap(held)
        if not gap > 0.0:
            return None
        return _pressing(known, held.times(AMPLE * self._bound / gap))


def _pressing(known: Sequence[Row], held: Held) -> Leaf:
    """Return multipliers as leaves have them."""
    told = list(zip(held.presses.tolist(), known, strict=True))
    presses = [y for y, row in told if row.said]
    upwards = np.array([y for y, row in told if row.holder == 0])
    pull = upwards[1::2] - upwards[::2]  # of an arrival, which is one both ways
    return Leaf(pull=pull, presses=np.array(presses), tethers=held.tethers)


def _gap(held: Held) -> float:
    """Return by how much multipliers miss the longest headings there are."""
    return held.worth - float(np.linalg.norm(held.forces, axis=1).sum())
