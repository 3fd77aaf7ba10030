# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The proof of a search over choices, written while the search goes on.

A node that was solved has the multipliers of its relaxation. One that was not has those of the node
that it is a part of, and one step along the row of its own that raises the bound the most
(:mod:`orbimpc_ros.mpc.solve.branching`).

In the plane a proof counts directions around and around where a turn limit bounds them, so that a
node of the search may be several of the proof's, or none.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.cells import Cell, Patch
from orbimpc_ros.mpc.geometry.orbitopes import coordinate_count
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.model.dynamics import length_weights, translation_rollout
from orbimpc_ros.mpc.problem.approach import LEEWAY
from orbimpc_ros.mpc.problem.cones import slope_sides
from orbimpc_ros.mpc.proof.tree import (
    ARCS,
    CUT,
    EMPTY,
    FACES,
    LEAF,
    PATCHES,
    POINTS,
    QUARTERS,
    SIDES,
    ProofTree,
)
from orbimpc_ros.mpc.solve.branching import Branch
from orbimpc_ros.mpc.solve.disjunction import Disjunction
from orbimpc_ros.mpc.solve.passages import Passage
from orbimpc_ros.mpc.solve.posed import Choice, Posed
from orbimpc_ros.mpc.solve.proof_nodes import Held, Node, Row, Span, tree_of
from orbimpc_ros.mpc.solve.relaxation import Multipliers, Relaxed

FULL = 2.0 * math.pi
OUTWARD = 1.0 + 1e-12  # so that what is on the rim of a cone is not outside by rounding
LATE_NODES = 40  # of a proof that is written once time is up: in 2 or 3 ms
NARROWEST = 1e-9  # [rad] what is left of a sector is a part of it from here on


class ChoiceTree:
    """The nodes of one search.

    Args:
        posed: what is searched.
        program: its relaxation.
        condensed: the quadratic of the problem, with its Hessian H.
        inverse: H^-1, shape (N, N).
        ordered: whether steps that can be exchanged are searched in the order of their faces.
    """

    def __init__(
        self,
        posed: Posed,
        program: Relaxed,
        condensed: Condensed,
        inverse: Array,
        *,
        ordered: bool = False,
    ) -> None:
        self._posed, self._program, self._inverse, self._ordered = posed, program, inverse, ordered
        problem = self._problem = posed.problem
        weights, n = problem.weights, problem.dimension
        axial = problem.rotation_order == 1 and weights.input == weights.attitude == 0.0
        self._width = n if n == 2 or axial else coordinate_count(n)
        self._arrives = (1 + problem.inertial) * (problem.terminal == 'constraint')
        self._condensed = condensed
        self._lengths = length_weights(problem)[1:]
        self._begin = -math.pi / problem.floor.faces if problem.floor.shape == 'polygon' else 0.0
        self._turn = FULL
        self._nodes = [Node(self._sectors(), 0)]
        self._places = [[0]]  # of each node of the search
        self._made: list[tuple[int, int, Cell] | None] = [None]  # of what, and which part
        self._solved: dict[int, tuple[Choice, Multipliers, bool] | None] = {}
        self._worse: set[int] = set()
        self._known: dict[int, Held | None] = {}  # what is best known of them
        self._is_stiff = bool(np.isfinite(inverse).all())

    # --- the search

    def solved(self, t: int, choice: Choice, *, better: bool = True, empty: bool = False) -> None:
        """Note what the last relaxation, which was that of a node, rests on.

        Args:
            t: number of the node.
            choice: of the node.
            better: whether its bound is no less than what was known of the node.
            empty: whether it proved that nothing is in the node.
        """
        found = self._program.multipliers
        self._solved[t] = None if found is None else (choice, found, empty)
        self._known.pop(t, None)
        if not better:
            self._worse.add(t)

    def split(self, t: int, choice: Choice, branch: Branch) -> range:
        """Note the parts of a node that was solved, and return their numbers."""
        numbers = range(len(self._places), len(self._places) + len(branch.cells))
        self._places += [[] for _ in numbers]
        self._made += [(t, branch.split, cell) for cell in branch.cells]
        for place in self._places[t]:
            self._divide(place, branch.split, choice[branch.split], branch.cells, numbers)
        return numbers

    # --- nodes

    def _sectors(self) -> dict[int, Span]:
        """Return the sectors that all headings are in, in the plane, where turns limit them."""
        problem, state = self._problem, self._posed.request.state
        if problem.dimension == 3:
            return {}
        if self._ordered:
            self._turn = -1.0
            every = range(problem.horizon)
            return dict.fromkeys(every, (self._begin, self._begin + FULL))
        spans, late = dict[int, Span](), problem.rotation_order - 1
        ahead = state.attitude if state.coasted is None or not late else state.coasted
        limited = problem.turns_are_angles and problem.widest_turn < math.pi
        if limited and not (late and state.coasted is None):
            self._turn, middle = problem.widest_turn, math.atan2(ahead[1, 0], ahead[0, 0])
            for k in range(problem.horizon):
                turned = (k + 1 - late) * self._turn
                spans[k] = middle - turned, middle + turned
        self._aim(spans)
        return spans

    def _aim(self, spans: dict[int, Span]) -> None:
        """Cut the last heading's sector to the approach, where one copy of that alone meets it."""
        problem, last = self._problem, self._problem.horizon - 1
        if not problem.approach.exists or (last == 0 and problem.rotation_order == 2):
            return
        axis, aside = problem.approach.axis(self._posed.request.state), problem.approach.cone
        middle = math.atan2(axis[1], axis[0])
        low, high = middle - aside - LEEWAY, middle + aside + LEEWAY
        if last in spans:
            begin, end = spans[last]
            first, final = math.ceil((begin - high) / FULL), math.floor((end - low) / FULL)
            if first != final:
                return
            low, high = max(begin, low + first * FULL), min(end, high + first * FULL)
        self._put(spans, last, (low, high))

    def _put(self, spans: dict[int, Span], k: int, span: Span) -> None:
        """Set a sector, and carry it to those of other steps."""
        spans[k] = span
        if k >= self._problem.horizon or self._turn == FULL:
            return
        if self._ordered:
            for j in range(k + 1, self._problem.horizon - 1):
                spans[j] = max(spans[j][0], spans[j - 1][0]), spans[j][1]
            for j in range(k - 1, -1, -1):
                spans[j] = spans[j][0], min(spans[j][1], spans[j + 1][1])
            return
        for i in range(1, self._problem.horizon):
            for j, near in ((k + i, k + i - 1), (k - i, k - i + 1)):
                if j in spans and near in spans:
                    low, high = spans[near]
                    spans[j] = (
                        max(spans[j][0], low - self._turn),
                        min(spans[j][1], high + self._turn),
                    )

    def _divide(
        self,
        place: int,
        j: int,
        held: Cell | None,
        cells: Sequence[Cell],
        numbers: Sequence[int],
    ) -> None:
        """Split a node of the proof as a node of the search was."""
        choice, which = self._posed.alternatives[j], self._choice_of(j)
        if which < self._problem.horizon and self._problem.dimension == 2:
            self._divide_directions(place, which, held, choice.cells, cells, numbers)
            return
        if which == 0 and self._problem.rotation_order == 2:
            self._stay(place, numbers[self._decided(cells)])
            return
        every = self._every(j, held, cells)
        of = [
            next((n for c, n in zip(cells, numbers, strict=True) if _same(c, e)), -1) for e in every
        ]
        refuted = [None if n >= 0 else self._beyond(j, e) for n, e in zip(of, every, strict=True)]
        at = 0.0
        if not isinstance(every[0], Patch):
            kind = FACES if which < self._problem.horizon else SIDES
        elif self._problem.dimension == 2:
            kind = ARCS if held is None else CUT
            if held is not None:
                at = 0.5 * sum(self._nodes[place].spans[which])
        else:
            kind = PATCHES if held is None else QUARTERS
        children = self._parts(place, kind, which, at, of, refuted)
        if self._problem.dimension == 2 and kind in (ARCS, CUT):
            self._set_arcs(place, which, children)

    def _decided(self, cells: Sequence[Cell]) -> int:
        """Return which cell the first heading is in: it is decided, but perhaps for its length."""
        state = self._posed.request.state
        turned = state.rotation + self._problem.step * state.rotation_rate
        axis = (turned if state.coasted is None else state.coasted)[:, 0]
        return int(np.argmax([cell.normal @ axis - cell.offset for cell in cells]))

    def _set_arcs(self, place: int, which: int, children: Sequence[int]) -> None:
        """Set the sectors of the parts of directions in the plane."""
        low, high = self._nodes[place].spans.get(which, (0.0, FULL))
        width = (high - low) / len(children)
        for i, child in enumerate(children):
            self._nodes[child].spans[which] = low + i * width, low + (i + 1) * width

    def _every(self, j: int, held: Cell | None, cells: Sequence[Cell]) -> Sequence[Cell]:
        """Return the parts that there are, including those that nothing reaches."""
        if held is not None:
            return held.parts()
        choice = self._posed.alternatives[j]
        upright = choice.upright if isinstance(choice, Disjunction) else ()
        return upright if upright and cells is upright else choice.cells

    def _beyond(self, j: int, cell: Cell) -> Row:
        """Return a row of a body's side that nothing reaches."""
        choice = self._posed.alternatives[j]
        assert isinstance(choice, Passage)
        most = choice.free @ cell.normal + np.abs(choice.rows).sum(axis=1)
        return self._row(j, int(np.argmax(choice.offsets([cell])[0] - most)), cell)

    def _parts(
        self,
        place: int,
        kind: int,
        which: int,
        at: float,
        of: Sequence[int],
        refuted: Sequence[Row | None],
    ) -> range:
        """Split a node, and return the numbers of its parts."""
        node, first = self._nodes[place], len(self._nodes)
        node.kind, node.choice, node.first, node.count, node.at = kind, which, first, len(of), at
        for number, row in zip(of, refuted, strict=True):
            self._nodes.append(Node(dict(node.spans), number, row))
            if row is None:
                self._places[number].append(len(self._nodes) - 1)
            else:
                self._nodes[-1].kind = EMPTY
        return range(first, first + len(of))

    def _stay(self, place: int, number: int) -> None:
        """Let a node of the search have a node of the proof that is not split for it."""
        self._nodes[place].of = number
        self._places[number].append(place)

    def _divide_directions(
        self,
        place: int,
        k: int,
        held: Cell | None,
        every: Sequence[Cell],
        cells: Sequence[Cell],
        numbers: Sequence[int],
    ) -> None:
        """Split the directions of a heading in the plane, where that is not done yet."""
        if k == 0 and self._problem.rotation_order == 2:
            self._stay(place, numbers[self._decided(cells)])
            return
        if len(cells) == 1:
            self._stay(place, numbers[0])
            return
        share, span = FULL / len(every), self._nodes[place].spans.get(k)
        if span is None:
            nothing = [None] * len(cells)
            children = self._parts(place, ARCS, k, self._begin, numbers, nothing)
            for i, child in enumerate(children):
                low = self._begin + i * share
                self._nodes[child].spans[k] = low, low + share
            return
        if held is None:
            begin, turns = self._begin, range(len(every))
            cuts = [begin + i * share for i in turns]
        else:
            assert isinstance(held, Patch)
            cuts = [math.atan2(held.normal[1], held.normal[0])]
        known = [i for i, each in enumerate(every) if any(_same(each, c) for c in cells)]
        for piece, (low, high) in self._cut(place, k, cuts):
            middle = 0.5 * (low + high)
            if held is None:
                i = math.floor((middle - self._begin) / share) % len(every)
                number = numbers[known.index(i)] if i in known else numbers[0]
            else:
                after = (middle - cuts[0] + math.pi) % FULL >= math.pi
                number = numbers[int(after)]
            self._stay(piece, number)

    def _cut(self, place: int, k: int, angles: Sequence[float]) -> list[tuple[int, Span]]:
        """Cut a sector at angles, wherever around these are in it; return its pieces."""
        low, high = self._nodes[place].spans[k]
        copies = sorted(
            angle + FULL * i
            for angle in angles
            for i in range(math.ceil((low - angle) / FULL), math.floor((high - angle) / FULL) + 1)
        )
        pieces = list[tuple[int, Span]]()
        for at in copies:
            if not low + NARROWEST < at < high - NARROWEST:
                continue
            node, first = self._nodes[place], len(self._nodes)
            node.kind, node.choice, node.first, node.count, node.at = CUT, k, first, 2, at
            for span in ((low, at), (at, high)):
                part = Node(dict(node.spans), node.of)
                self._put(part.spans, k, span)
                if k == self._problem.horizon - 1 or not self._ordered:
                    self._aim(part.spans)
                self._nodes.append(part)
            pieces.append((first, (low, at)))
            place, low = first + 1, at
        return [*pieces, (place, (low, high))]

    # --- rows

    def _choice_of(self, j: int) -> int:
        """Return the number that proofs have for a choice of the search."""
        posed, count = self._posed, self._problem.horizon
        choice = posed.alternatives[j]
        if isinstance(choice, Passage):
            body, rest = divmod(j - posed.fixed, 2 * count)
            step, end = divmod(rest, 2)
            return (2 + len(self._problem.boxes) + 2 * body + (1 - end)) * count + step
        if choice.on == 'heading':
            return choice.steps[0] - 1
        before = sum(each.on == 'heading' for each in posed.disjunctions)
        each = (posed.fixed - before) // max(1, len(self._problem.boxes))
        return (2 + (j - before) // each) * count + choice.steps[-1] - 1

    def _row(self, j: int, i: int, cell: Cell) -> Row:
        """Return row i of a cell of a choice."""
        choice, count = self._posed.alternatives[j], self._problem.horizon
        place = POINTS * (self._choice_of(j) - 2 * count) + i
        if isinstance(choice, Passage):
            offset = float(choice.offsets([cell])[0, i] - choice.free[i] @ cell.normal)
            return Row(place, -1, choice.rows[i], cell.normal, offset)
        step, offset = choice.steps[i] - 1, cell.offset
        if choice.on == 'position':
            offset -= float(cell.normal @ self._coasting[step])
            return Row(place, -1, self._problem.maps.reach[step, 1:], cell.normal, offset)
        held = step if self._width == 9 else -1
        return Row(-1, held, np.eye(count)[step], cell.normal, offset)

    @cached_property
    def _coasting(self) -> Array:
        """Return s_1..s_N without thrust of R_1 e1..R_N e1, shape (N, n)."""
        problem, state = self._problem, self._posed.request.state
        still = np.zeros((problem.horizon + 1, problem.dimension))
        still[0] = state.rotation[:, 0]
        return translation_rollout(problem, state, still)[0][1:]

    def _asked(self, choice: Choice) -> list[Row]:
        """Return the half-spaces of a node's relaxation, in their order."""
        posed, rows = self._posed, list[Row]()
        for j, cell in enumerate(choice[: posed.fixed]):
            if cell is not None:
                rows += [self._row(j, i, cell) for i in range(len(posed.disjunctions[j].steps))]
        ahead, units = posed.request.state.attitude[:, 0], np.eye(self._problem.horizon)
        for slot in posed.turns.slots if posed.turns else ():
            step = -1 if self._problem.dimension == 2 else slot.step - 1
            rows.append(Row(-1, step, units[slot.step - 1], ahead, 0.0))
        for j, cell in enumerate(choice[posed.fixed :], posed.fixed):
            passage = posed.alternatives[j]
            if cell is not None and isinstance(passage, Passage):
                rows += [self._row(j, int(i), cell) for i in np.flatnonzero(passage.moved)]
        return rows

    def _held(self, t: int, choice: Choice, found: Multipliers, empty: bool) -> Held:
        problem, steps, n = self._problem, self._problem.horizon, self._problem.dimension
        shape = steps, n
        pull = found.pull.reshape(-1, n)
        slide: Array = np.zeros(shape)
        tether, share = np.zeros(shape), np.zeros(shape)
        leans = list(found.leans)
        if problem.first_turn_is_a_cone and leans:
            share[0] += leans.pop(0) * (n == 3)
        if problem.tilt and leans:
            share += leans[:steps]
            leans = leans[steps:]
        if problem.glide_slope and leans:
            slide = self._within_slope(-np.array(leans[:steps]))
            leans = leans[steps:]
        if leans and n == 3:
            share[-1] += leans[0]
        if len(found.props) == steps and problem.tilt:
            share[:, -1] += found.props
        elif len(found.props) and n == 3:
            share[-1] += found.props[-1] * problem.approach.axis(self._posed.request.state)
        if len(found.ways) and self._width == 9:
            share -= self._lengths[:, None] * found.ways
        rows = list(zip(found.rows.tolist(), found.normals, found.sizes.tolist(), strict=True))
        for row, normal, size in rows:
            if row < -steps:  # tangents to the balls of chords, the last of which is the last step
                tether[-1 - row - self._program.chords] -= size * normal
        force = problem.maps.reach[:, 1:].T @ slide + tether
        force[:-1] -= tether[1:]
        if len(pull):
            force += problem.maps.arrival[: len(pull), 1:].T @ pull
        point = np.zeros((steps, self._width))
        if not empty:  # where nothing is the cost has no say, and its point may be anywhere
            point[:, : found.point.shape[1]] = found.point[:, : self._width]
        made = Held(point, share, (), force, (pull, slide, tether), empty)
        asked = self._asked(choice) if any(row >= 0 for row, *_ in rows) else []
        for row, _, size in rows:
            if 0 <= row < len(asked):  # what follows are the edges of a first turn's cone
                made = made.pressed(asked[row]._replace(since=t), size)
        return made

    def _within_slope(self, slide: Array) -> Array:
        """Return multipliers of the glide slope, surely in its cone's polar, shape (N, 3)."""
        _, sine, cosine = slope_sides(self._problem)
        rim = OUTWARD * cosine / sine * np.hypot(slide[:, 0], slide[:, 1])
        slide[:, 2] = np.minimum(slide[:, 2], -rim)
        return slide

    # --- the proof

    def proof_in_time(self, out_of_time: Callable[[], bool] | None) -> ProofTree | None:
        """Return the proof; that of its first nodes, which prove less, if time is up before."""
        for node in self._nodes:
            if out_of_time is not None and out_of_time():
                return self.proof(LATE_NODES)
            if node.kind in (LEAF, EMPTY) and not node.refuted:
                self._best(node.of)
        return self.proof()

    def proof(self, most: int | None = None) -> ProofTree | None:
        """Return the proof; None where the multipliers of something are not known.

        Args:
            most: nodes of it, the first ones, which prove less; None for all.
        """
        nodes, leaves, above = self._first(most), dict[int, Held](), dict[int, int]()
        for place, node in enumerate(nodes):
            above |= dict.fromkeys(range(node.first, node.first + node.count), place)
        for place, node in enumerate(nodes):
            if node.kind not in (LEAF, EMPTY):
                continue
            made = self._refuted(node.refuted) if node.refuted else self._best(node.of)
            if made is None:
                return None
            presses = tuple((self._from(place, row, above), y) for row, y in made.presses)
            leaves[place] = made._replace(share=self._share(made), presses=presses)
        tree = tree_of(nodes, leaves)
        if not self._ordered:
            return tree
        origins = np.full(self._problem.horizon, self._begin)
        return tree._replace(ordered=True, origins=origins)

    def _from(self, place: int, row: Row, above: Mapping[int, int]) -> Row:
        """Return a row numbered as one of a leaf: by how far above the leaf it is known from."""
        levels, known = 0, (place,) if row.since < 0 else self._places[row.since]
        while place not in known:
            place, levels = above[place], levels + 1
        passages = len(self._posed.alternatives) - self._posed.fixed
        rows = POINTS * (len(self._problem.boxes) * self._problem.horizon + passages)
        return row._replace(place=row.place + levels * rows)

    def _first(self, most: int | None) -> list[Node]:
        """Return the nodes as they were when there were no more than so many, but at least one."""
        every, count = self._nodes, 1
        if most is None or most >= len(every):
            return every
        for node in every:
            if node.count and node.first + node.count <= max(1, most):
                count = max(count, node.first + node.count)
        return [
            node if not node.count or node.first + node.count <= count else node.unsplit()
            for node in every[:count]
        ]

    def _refuted(self, row: Row) -> Held:
        """Return the leaf of a part of whose rows one is out of reach."""
        problem = self._problem
        shape = problem.horizon, problem.dimension
        ends = np.zeros((self._arrives, problem.dimension)), np.zeros(shape), np.zeros(shape)
        point = np.zeros((problem.horizon, self._width))
        return Held(point, np.zeros(shape), (), np.zeros(shape), ends, True).pressed(row, 1.0)

    def _best(self, t: int) -> Held | None:
        """Return what is best known of a node of the search."""
        if t not in self._known:
            self._known[t] = self._raised(t)
        return self._known[t]

    def _raised(self, t: int) -> Held | None:
        """Return what a node of the search proves by itself, or raised from what it is part of."""
        own, made = self._solved.get(t), self._made[t]
        if (own is not None and t not in self._worse) or made is None:
            return None if own is None else self._held(t, *own)
        before, j, cell = made
        known = self._best(before)
        rows = [self._row(j, i, cell)._replace(since=t) for i in self._free_rows(j)]
        if known is None or not rows or not self._is_stiff:
            return known
        return known.raised(rows, self._inverse)

    def _free_rows(self, j: int) -> list[int]:
        """Return which rows of a choice's sides are moved at all."""
        choice = self._posed.alternatives[j]
        if isinstance(choice, Passage):
            return np.flatnonzero(choice.moved).tolist()
        reach = self._problem.maps.reach[:, 1:]
        always = choice.on == 'heading'
        return [i for i, k in enumerate(choice.steps) if always or reach[k - 1].any()]

    def _share(self, leaf: Held) -> Array:
        """Return what a step's thrust alone holds of its slope, and orbitopes do not.

        Without orbitopes it is what cones do not hold, lengths among it; nothing where none does.
        """
        n = self._problem.dimension
        if self._width == 9 or not leaf.share.any():
            return leaf.share
        slopes = leaf.force - leaf.share
        if not leaf.empty:
            request = self._posed.request
            slopes += self._condensed.affine(request.state, request.goals)[0]
            slopes += self._condensed.hessian @ leaf.point[:, :n]
        return slopes


def _same(a: Cell, b: Cell) -> bool:
    """Return whether two cells of one choice are the same."""
    return a is b or np.array_equal(a.normal, b.normal)
