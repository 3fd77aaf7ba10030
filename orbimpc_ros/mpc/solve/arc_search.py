# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Branch and bound over a round floor in the plane: headings within arcs, bounds by multipliers.

An arc of half-width d about the unit vector m, d < pi/2, holds the headings z that lie between its
edges. With s = |z| they satisfy s cos d <= m.z, and s^2 <= (1 + f) s - f between floor f and rim.
Hence

    |z|^2 <= (1 + f) m.z / cos d - f,

which with the edges describes the convex hull of all (z, |z|^2). The multipliers of these rows
(:class:`orbimpc_ros.mpc.kernels.dual.Cuts`) join those of the moduli, so that a node's bound is
never worse than the best multipliers', and exact as arcs shrink.

Mathematics: docs/mathematics.md, 4.6.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels.annulus import SLICE, Annulus
from orbimpc_ros.mpc.kernels.dual import BOUND, MU, Ascent, Cuts, ascent, climb
from orbimpc_ros.mpc.proof.tree import ARCS, CUT, NOTHING, ProofTree
from orbimpc_ros.mpc.solve.convexity import Tangent, tangent

PARTS = 5  # arcs that a whole circle is cut into
MARGIN = 0.15  # of an arc: no part is narrower
NARROWEST = 1e-6  # [rad], an arc that is not cut
SMOOTHED = 100.0  # times as much as its parent in the end, a node is to begin with
INSIDE, LEAST = 2.0, 3.0  # of mu: what comes to theta, and a row's multiplier at least


class _Multipliers(NamedTuple):
    """What a node ended with, for its children to begin from.

    Attributes:
        theta: of the moduli, shape (N,).
        held: of the rows of each heading's arc, zero where there are none, shape (3, N).
        mu: their smoothing.
    """

    theta: Array
    held: Array
    mu: float


class _Node(NamedTuple):
    """What is open: its bound, a number that tells it from others, and its arcs.

    ``low`` and ``high`` [rad] have shape (N,); where they are equal, the arc is the whole circle.
    ``parent`` is None at the root.
    """

    bound: float
    number: int
    low: Array
    high: Array
    parent: _Multipliers | None


class _Cut(NamedTuple):
    """A node that was cut by a step: from which angle on, into how many children, the first one."""

    node: int
    step: int
    angle: float
    parts: int
    first: int


def cuts(low: Array, high: Array, floor: float) -> Cuts:
    """Return what holds of headings in arcs narrower than half a circle: moduli, then both edges.

    Args:
        low: least angle of each heading [rad], shape (N,).
        high: greatest, shape (N,); of a whole circle the same, and nothing holds.
        floor: least modulus.
    """
    steps = np.flatnonzero(high > low)
    first, last = low[steps], high[steps]
    middle, cosine = 0.5 * (first + last), np.cos(0.5 * (last - first))
    share, ones = 0.5 * (1.0 + floor) / cosine, np.ones(len(steps))
    normals = [
        [share * np.cos(middle), share * np.sin(middle)],
        [-np.sin(first), np.cos(first)],
        [np.sin(last), -np.cos(last)],
    ]
    return Cuts(
        np.tile(steps, 3),
        np.concatenate([ones, 0.0 * ones, 0.0 * ones]),
        np.ascontiguousarray(np.hstack([np.array(each) for each in normals]).T),
        np.concatenate([-0.5 * floor * ones, 0.0 * ones, 0.0 * ones]),
    )


def _multipliers(progress: Ascent, rows: Cuts) -> _Multipliers:
    """Return what a node has ended with."""
    held = np.zeros((3, len(progress.theta)))
    if len(rows.steps):
        held[:, rows.steps[: len(rows.steps) // 3]] = progress.weights.reshape(3, -1)
    return _Multipliers(progress.theta, held, float(progress.numbers[MU]))


def _set_start(progress: Ascent, node: _Node, rows: Cuts) -> None:
    """Begin from the multipliers of a node's parent, smoothed more and away from where they end."""
    known, numbers = node.parent, progress.numbers
    assert known is not None
    numbers[MU] = min(numbers[MU], SMOOTHED * known.mu)
    progress.theta[:] = known.theta + INSIDE * numbers[MU]
    held = known.held[:, rows.steps[: len(rows.steps) // 3]]
    progress.weights[:] = np.maximum(held.ravel(), LEAST * numbers[MU])


class ArcSearch:
    """Branch and bound for the cost of an annulus in the plane.

    Args:
        annulus: what is minimised over.
        tolerance: relative gap at which a search stops.
        most: nodes of a search.

    Attributes:
        nodes: how many have been solved.
        last: the minimiser of the last node's Lagrangian, shape (N, 2).
        value: the least cost known.
    """

    def __init__(self, annulus: Annulus, tolerance: float, most: int) -> None:
        self._annulus, self._tolerance, self._most = annulus, tolerance, most
        self._shift = 2.0 * annulus.length / (1.0 + annulus.floor)

    def begin(
        self, q: Array, left: Array, constant: float, known: float, bound: float = -np.inf
    ) -> None:
        """Begin a search.

        Args:
            q: linear terms, shape (N, 2).
            left: what an arrival asks of sum_k a_k z_k, shape (2,), or (0,) without one.
            constant: what costs lack; it only scales the tolerance.
            known: a cost, without it, that is to be undercut.
            bound: that is known, without it.
        """
        circle = np.zeros(len(q))
        self._q, self._left, self._constant, self.value = q, left, constant, known
        self._open = [_Node(bound, 0, circle, circle, None)]
        self._current: tuple[_Node, Cuts, Ascent] | None = None
        self._closed, self._made = np.inf, 1
        self._cuts: list[_Cut] = []
        self._tangents = {0: Tangent(np.zeros_like(q), circle, 0.0 * left)}
        self.nodes, self.last = 0, np.zeros_like(q)

    @property
    def cutoff(self) -> float:
        """Return the bound from which on nodes are of no use."""
        return self.value - self._tolerance * max(abs(self.value + self._constant), 1e-9)

    @property
    def bound(self) -> float:
        """Return what nothing costs less than, without the constant."""
        least = min(self._closed, self.value)
        if self._current is not None:
            least = min(least, float(self._current[2].numbers[BOUND]))
        return min(least, self._open[0].bound) if self._open else least

    def beat(self, cost: float) -> None:
        """Look for nothing from now on but what costs less, without the constant."""
        self.value = min(self.value, cost)

    def run(self, out_of_time: Callable[[], bool] | None = None) -> bool:
        """Solve the most promising node; return whether the search has to end."""
        if self._current is None and not self._begun():
            return True
        assert self._current is not None
        node, rows, progress = self._current
        while not climb(
            self._annulus, self._q, self._left, rows, self.cutoff, progress, float(SLICE)
        ):
            if out_of_time is not None and out_of_time():
                self._note(node, rows, progress)
                return True
        self._note(node, rows, progress)
        self._current, self.last = None, progress.z
        self._branch(node, rows, progress)
        return out_of_time is not None and out_of_time()

    def _begun(self) -> bool:
        """Begin with the most promising node, if there is one and there may be."""
        if not self._open or self._open[0].bound >= self.cutoff or self.nodes >= self._most:
            return False
        node = heapq.heappop(self._open)
        rows = cuts(node.low, node.high, self._annulus.floor)
        progress = ascent(self._annulus, self._q, rows, node.bound)
        if node.parent is not None:
            _set_start(progress, node, rows)
        self._current = node, rows, progress
        self.nodes += 1
        return True

    def _note(self, node: _Node, rows: Cuts, progress: Ascent) -> None:
        """Note what a node's bound is of, where it is better than its parent's."""
        if progress.numbers[BOUND] > node.bound:
            self._tangents[node.number] = self._tangent(rows, progress)

    def _tangent(self, rows: Cuts, progress: Ascent) -> Tangent:
        """Return what a node's bound is of: the multipliers of arcs turn and bend the cost."""
        z, bends = progress.z, progress.theta + _multipliers(progress, rows).held[0]
        a, pull = self._annulus.arrival, self._left
        if len(pull):
            forces = self._annulus.hessian @ z + self._q + bends[:, None] * z
            np.subtract.at(forces, rows.steps, progress.weights[:, None] * rows.normals)
            pull = -(a @ forces) / float(a @ a)
        return tangent(self._annulus.hessian, a, self._left, z, bends, pull)

    def proof(self) -> ProofTree:
        """Return the tree that proves the bound."""
        nodes, at = np.zeros((self._made, 5), np.int64), np.zeros(self._made)
        for cut in self._cuts:
            kind = ARCS if cut.parts > 2 else CUT
            nodes[cut.node], at[cut.node] = (kind, cut.step, cut.first, cut.parts, -1), cut.angle
        leaves = np.flatnonzero(nodes[:, 3] == 0)
        nodes[leaves, 4] = np.arange(len(leaves))
        points, shor, pulls = zip(*[self._tangents[int(number)] for number in leaves], strict=True)
        pull = np.array(pulls)[:, None] if len(self._left) else NOTHING
        ends, none = np.zeros(len(leaves), np.int64), np.zeros((0, 0))
        made = nodes, at, np.array(points), np.array(shor), ends, ends[:0], at[:0]
        return ProofTree(*made, pull, NOTHING, NOTHING, NOTHING, none)

    def _branch(self, node: _Node, rows: Cuts, progress: Ascent) -> None:
        """Open the children of a node that is solved, unless it needs none."""
        bound = float(progress.numbers[BOUND])
        k = self._chosen(node, progress)
        if bound >= self.cutoff or k < 0:
            self._closed = min(self._closed, bound)
            return
        known = _multipliers(progress, rows)
        parts = self._parts(node, k, progress.z[k])
        whole = node.low[k] == node.high[k]
        angle = parts[0][0] if whole else parts[0][1]
        self._cuts.append(_Cut(node.number, k, angle, len(parts), self._made))
        for first, last in parts:
            low, high = node.low.copy(), node.high.copy()
            low[k], high[k] = first, last
            self._tangents[self._made] = self._tangents[node.number]
            heapq.heappush(self._open, _Node(bound, self._made, low, high, known))
            self._made += 1

    def _chosen(self, node: _Node, progress: Ascent) -> int:
        """Return the step to branch on, -1 if there is none.

        The one whose modulus misses the bound that its multiplier speaks of by most, as the
        multiplier prices it.
        """
        bent, floor = progress.theta - self._shift, self._annulus.floor
        square = np.sum(progress.z**2, axis=1)
        missed = np.abs(bent * (np.where(bent > 0.0, 1.0, floor * floor) - square))
        width = node.high - node.low
        missed[(width > 0.0) & (width < NARROWEST)] = -1.0
        k = int(np.argmax(missed))
        return k if missed[k] >= 0.0 else -1

    def _parts(self, node: _Node, k: int, z: Array) -> list[tuple[float, float]]:
        """Return the arcs that a step's is cut into, at the heading found."""
        low, high, angle = node.low[k], node.high[k], float(np.arctan2(z[1], z[0]))
        if low == high:
            corners = angle + np.linspace(0.0, 2.0 * np.pi, PARTS + 1)
            return list(itertools.pairwise(corners.tolist()))
        middle, margin = 0.5 * (low + high), MARGIN * (high - low)
        angle += 2.0 * np.pi * np.round((middle - angle) / (2.0 * np.pi))
        angle = min(high - margin, max(low + margin, angle))
        return [(low, angle), (angle, high)]
