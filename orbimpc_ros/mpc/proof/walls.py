# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Proof by the sides on which bodies are passed.

Mathematics: docs/mathematics.md, 3.7 to 3.9, and docs/proofs.md.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from fractions import Fraction

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.proof.certificate import Leaf, Tree, split_into
from orbimpc_ros.mpc.proof.part_program import Answer, PartProgram
from orbimpc_ros.mpc.proof.verifier.bound import bound
from orbimpc_ros.mpc.proof.verifier.regions import Region
from orbimpc_ros.mpc.proof.verifier.splits import beside, root, side_of
from orbimpc_ros.mpc.proof.verifier.stated import StatedProblem
from orbimpc_ros.mpc.proof.verifier.walls import BoxWall, DiscWall

SATISFIED = 1e-9  # of a step's length: a wall missed by less is not split
NARROWEST, MARGIN = 1e-7, 0.15  # [rad] of what is split; of it, to either end
LEAST = 1e-9  # of a curvature
Choice = tuple[float, int, int, float | None]  # a promise, a wall, a step, an angle
NEAR, ROUNDS = Fraction(1, 10**5), 4  # of the target, from where on digits are refined; so often
SIZES = 1e3, 1e5, 1e8, 1e1, 1.0  # of multipliers that say that nothing is feasible, in turn


class WallProof:
    """Depth first over the sides of boxes and discs, until each part costs enough.

    Args:
        program: of parts.
        posed: the problem, which says what a leaf proves.
        stated: returns a leaf in the user's units, as the format has it.
        unit: of lengths [m].
        target: the bound to prove, in the user's units.
    """

    most = 2000  # leaves
    origins = None  # no directions are split

    def __init__(
        self,
        program: PartProgram,
        posed: StatedProblem,
        stated: Callable[[Leaf], dict],
        unit: float,
        target: float,
    ) -> None:
        self._program, self._posed, self._stated = program, posed, stated
        self._splits = WallSplits(posed, program.curvatures, unit)
        self._target, self._leaves = Fraction(target), 0

    def tree(self) -> Tree | None:
        """Return splits and leaves that prove the target; None where that takes too many."""
        return self._proved(root(self._posed, None))

    def _proved(self, region: Region) -> Tree | None:
        answer = self._program.answer(region)
        for leaf, worth in self._tried(region, answer):
            if worth >= self._target:
                self._leaves += 1
                return leaf if self._leaves <= self.most else None
        if not answer.feasible:
            return None
        found = self._splits.best(region, self._program.positions(answer.x))
        if found is None:
            return None
        _, wall, k, at = found
        parts = beside(self._posed, region, k, wall, at)
        return split_into(map(self._proved, parts), k + 1, at, wall)

    def _tried(self, region: Region, answer: Answer) -> Iterator[tuple[Leaf, Fraction]]:
        """Yield tangents of a region, better ones as long as it is digits that they lack."""
        if not answer.feasible:
            for size in SIZES:
                yield self._weighed(region, self._program.refutation(region, answer.held, size))
            return
        leaf, worth = self._weighed(region, self._program.leaf(region, answer))
        yield leaf, worth
        for _ in range(ROUNDS if answer.held.factors else 0):
            if worth < self._target * (1 - NEAR):
                return
            answer = self._program.polished(region, answer)
            leaf, worth = self._weighed(region, self._program.leaf(region, answer))
            yield leaf, worth

    def _weighed(self, region: Region, leaf: Leaf) -> tuple[Leaf, Fraction]:
        """Return a leaf with what it proves."""
        return leaf, bound(self._posed, self._stated(leaf), region)


class WallSplits:
    """Chooses walls by whose sides to split what enters them.

    Args:
        posed: the problem.
        curvatures: by how much positions give way to what presses them, shape (N,).
        unit: of lengths [m].
    """

    def __init__(self, posed: StatedProblem, curvatures: Array, unit: float) -> None:
        self._posed, self._curvatures, self._spare = posed, curvatures, SATISFIED * unit
        self._walls = list(enumerate(posed.limits.walls))
        n, steps = posed.n, range(posed.horizon)
        sides = range(2 * n)
        self._normals = np.vstack([-np.eye(n), np.eye(n)])
        # Of each wall, step and side: what it asks of s_{k+1}, and of s_k where it is one for both.
        self._least = np.full((len(self._walls), len(steps), len(sides), 2), -np.inf)
        boxes = [(j, wall) for j, wall in self._walls if isinstance(wall, BoxWall)]
        for (j, box), k, i in itertools.product(boxes, steps, sides):
            for row in box.side(i, k):
                self._least[j, k, i, k - row.k] = row.least

    def best(self, region: Region, positions: Array) -> Choice | None:
        """Return the wall and the step whose sides all promise most; None if none is missed."""
        if not self._walls:
            return None
        found = [*self._through_boxes(positions), *self._through_discs(region, positions)]
        return max(found, key=lambda each: each[0], default=None)

    def _through_discs(self, region: Region, positions: Array) -> Iterator[Choice]:
        """Yield the discs that are entered, with an angle to split the directions to there at."""
        discs = [(j, wall) for j, wall in self._walls if isinstance(wall, DiscWall)]
        for (j, disc), k in itertools.product(discs, range(len(positions))):
            nearest, radius = self._nearest(disc, positions, k)
            short = radius - math.hypot(*nearest)
            low, high = map(float, side_of(region, k, j))
            if short <= self._spare or high - low < NARROWEST:
                continue
            middle, margin = 0.5 * (low + high), MARGIN * (high - low)
            angle = math.atan2(nearest[1], nearest[0])
            angle += 2.0 * math.pi * round((middle - angle) / (2.0 * math.pi))
            at = min(high - margin, max(low + margin, angle))
            yield short**2 / max(self._curvatures[k], LEAST), j, k, at

    def _nearest(self, disc: DiscWall, positions: Array, k: int) -> tuple[Array, float]:
        """Return the point of step k that is nearest to a disc, from its centre, and its radius."""
        centre, radius = disc.place(k + 1, k)
        end = positions[k] - np.array(centre, float)
        if not disc.shared:
            return end, float(radius)
        before = np.array(self._posed.state.position, float) if k == 0 else positions[k - 1]
        begin = before - np.array(disc.place(k, k)[0], float)
        way = end - begin
        share = np.clip(-(begin @ way) / max(float(way @ way), LEAST * self._spare), 0.0, 1.0)
        return begin + share * way, float(radius)

    def _through_boxes(self, positions: Array) -> Iterator[Choice]:
        """Yield the box that is entered whose sides all promise most."""
        along = positions @ self._normals.T
        both = np.stack([along, np.vstack([along[:1], along[:-1]])], axis=-1)
        short = np.maximum(self._least - both, 0.0)
        curvature = self._curvatures
        both_curved = np.stack([curvature, np.append(curvature[:1], curvature[:-1])], axis=-1)
        with np.errstate(divide='ignore', invalid='ignore'):
            gains = np.where(short > 0.0, short**2 / both_curved[:, None, :], 0.0).max(axis=-1)
        missed = short.max(axis=-1).min(axis=-1) > self._spare
        promises = np.where(missed, gains.min(axis=-1), -1.0)
        wall, k = np.unravel_index(int(np.argmax(promises)), promises.shape)
        if missed[wall, k]:
            yield float(promises[wall, k]), int(wall), int(k), None
