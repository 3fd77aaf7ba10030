# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Proof by sectors of directions: a round floor in the plane, or any with a turn limit.

Mathematics: docs/mathematics.md, 4.6 and 4.10, and docs/proofs.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels.annulus import Annulus
from orbimpc_ros.mpc.kernels.dual import BOUND, ascent, climb
from orbimpc_ros.mpc.model.condensed import Condensed, regular
from orbimpc_ros.mpc.model.cost import length_weights
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.certificate import Leaf, Tree, split_into
from orbimpc_ros.mpc.solve.arc_search import cuts

WIDEST = 1.3  # [rad] of a part, of a sector that is too wide for cuts
MARGIN = 0.15  # of a sector: no part is narrower
NARROWEST = 1e-7  # [rad], a sector that is not split
DEEPEST = 150  # splits on the way to a leaf: what calls itself has its limits
SATISFIED = 1e-9  # [rad], a turn that is wider by less
TURN = math.nextafter(2.0 * math.pi, 7.0)
NO_ARRIVAL = np.zeros(0)


class SectorProof:
    """Depth first over the directions of headings, until each part costs enough.

    Args:
        problem: in natural units: planar, of rotation order 1, with a floor.
        state: where plans start.
        goals: shape (N, 2).
        x: headings of the best plan, shape (N, 2).
        target: the bound to prove.
        out_of_time: polled before each part; True gives up.

    Attributes:
        origins: from where directions are counted, shape (N,) [rad]; None with a turn limit.
    """

    most = 3000  # leaves

    def __init__(
        self,
        problem: Problem,
        state: State,
        goals: Array,
        x: Array,
        target: float,
        out_of_time: Callable[[], bool],
    ) -> None:
        condensed, count = Condensed(problem), problem.horizon
        self._q, constant = condensed.affine(state, goals)
        self._floor = problem.floor.clearance(2)
        length = length_weights(problem)[1:]
        self._annulus = Annulus(condensed.hessian, length, np.zeros(count), self._floor)
        self._target, self._turn = target - constant, problem.step * problem.max_rate
        self._leaves, self._late = 0, out_of_time
        self._curvature = 0.5 / np.diag(regular(condensed.hessian)[1])
        self._ahead = 0.0
        if self._turn:
            ahead = state.attitude[:, 0]
            reach = self._turn * np.arange(1, count + 1)
            first = self._ahead = math.atan2(ahead[1], ahead[0])
            self.origins, self._root = None, (first - reach, first + reach)
        else:
            opposite = np.arctan2(-x[:, 1], -x[:, 0])
            self.origins, self._root = opposite, (opposite, opposite + TURN)

    def tree(self) -> Tree | None:
        """Return splits and leaves that prove the target; None where that takes too many."""
        return self._proved(*self._root, 0)

    def _proved(self, low: Array, high: Array, depth: int) -> Tree | None:
        if self._late():
            return None
        leaf, bound, missed = self._relaxed(low, high)
        if bound >= self._target:
            self._leaves += 1
            return leaf if self._leaves <= self.most else None
        assert leaf.point is not None
        gains, angles = self._promises(leaf.point, missed, low, high)
        # Where nothing is missed, the tangent was not the best one: any split is a new try.
        k = int(np.argmax(gains if gains.any() else high - low))
        if high[k] - low[k] < NARROWEST or depth >= DEEPEST:
            return None
        corners = self._corners(low[k], high[k], angles[k])
        return self._split(k, corners, low, high, depth)

    def _promises(self, z: Array, missed: Array, low: Array, high: Array) -> tuple[Array, Array]:
        """Return what splits of each step promise, and at which angles.

        What moduli miss of their bounds, as their multipliers price it, and turns that are too
        wide: then the wider of the two sectors is split such that either part leaves one of the
        headings out. Late turns count for more: they narrow all before them.
        """
        angles, width = np.arctan2(z[:, 1], z[:, 0]), high - low
        size, before = np.linalg.norm(z, axis=1), self._ahead
        if self._turn:
            missed = self._curvature * np.maximum(0.0, self._floor - SATISFIED - size) ** 2
        gains, cuts_at = np.where(width > NARROWEST, missed, 0.0), angles.copy()
        for k in range(len(z) if self._turn else 0):
            turn = math.remainder(angles[k] - before, 2.0 * math.pi)
            excess = abs(turn) - self._turn
            away = math.copysign(0.5 * excess, turn)
            raised = (k + 1.0) * self._curvature[k] * (size[k] * math.sin(0.5 * excess)) ** 2
            at, angle = k, angles[k] - away
            if k and width[k - 1] > width[k]:
                at, angle = k - 1, before + away
            if excess > SATISFIED and width[at] > NARROWEST and raised > gains[at]:
                gains[at], cuts_at[at] = raised, angle
            before = angles[k]
        return gains, cuts_at

    def _split(
        self, k: int, corners: list[float], low: Array, high: Array, depth: int
    ) -> Tree | None:
        """Return the tree of a region split at angles, one after another; it may be empty."""
        if not corners:
            return self._proved(low, high, depth)
        return split_into(self._cut(k, corners, low, high, depth), k + 1, corners[0])

    def _cut(
        self, k: int, corners: list[float], low: Array, high: Array, depth: int
    ) -> Iterator[Tree | None]:
        """Yield what proves the parts below and above the first of some angles."""
        for begin, end, rest in (
            (low[k], corners[0], []),
            (corners[0], high[k], corners[1:]),
        ):
            region = self._narrowed(k, begin, end, low, high)
            nothing = Leaf(np.zeros(self._q.shape))
            yield nothing if region is None else self._split(k, rest, *region, depth + 1)

    def _narrowed(
        self, k: int, begin: float, end: float, low: Array, high: Array
    ) -> tuple[Array, Array] | None:
        """Return what is left of all directions with one between two angles; None if nothing."""
        low, high = low.copy(), high.copy()
        low[k], high[k] = begin, end
        if self._turn:
            away = self._turn * np.abs(np.arange(len(low)) - k)
            low, high = np.maximum(low, begin - away), np.minimum(high, end + away)
            if (low > high + 1e-9).any():
                return None
        return low, np.maximum(low, high)

    def _relaxed(self, low: Array, high: Array) -> tuple[Leaf, float, Array]:
        """Return the best tangent over a region, its bound, and what moduli miss of theirs."""
        narrow = high - low < 0.99 * math.pi
        rows = cuts(np.where(narrow, low, 0.0), np.where(narrow, high, 0.0), self._floor)
        progress = ascent(self._annulus, self._q, rows, -np.inf)
        asked = self._annulus, self._q, NO_ARRIVAL, rows
        climb(*asked, self._target, progress, np.inf)
        bends = progress.theta.copy()
        np.add.at(bends, rows.steps, progress.weights * rows.bends)
        square = np.sum(progress.z**2, axis=1)
        shifted = progress.theta - 2.0 * self._annulus.length / (1.0 + self._floor)
        end = np.where(shifted > 0.0, 1.0, self._floor**2)
        missed = np.abs(shifted * (end - square))
        return Leaf(progress.z.copy(), bends), float(progress.numbers[BOUND]), missed

    def _corners(self, low: float, high: float, angle: float) -> list[float]:
        """Return the angles at which to split a sector, near one that promises most."""
        width = high - low
        if width >= 0.99 * math.pi:
            return [float(a) for a in np.linspace(low, high, math.ceil(width / WIDEST) + 1)[1:-1]]
        middle = 0.5 * (low + high)
        angle += 2.0 * math.pi * round((middle - angle) / (2.0 * math.pi))
        return [min(high - MARGIN * width, max(low + MARGIN * width, angle))]
