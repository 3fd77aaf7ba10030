# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Proof by the sides on which bodies are passed.

Mathematics: docs/mathematics.md, 3.7 to 3.9, and docs/proofs.md.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from fractions import Fraction

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.separation import separation
from orbimpc_ros.mpc.proof.verifier.motion import Place
from orbimpc_ros.mpc.proof.verifier.regions import Region
from orbimpc_ros.mpc.proof.verifier.splits import side_of
from orbimpc_ros.mpc.proof.verifier.stated import StatedProblem
from orbimpc_ros.mpc.proof.verifier.walls import BoxWall, DiscWall

SATISFIED = 1e-9  # of a step's length: a wall missed by less is not split
NARROWEST, MARGIN = 1e-7, 0.15  # [rad] of what is split; of it, to either end
LEAST = 1e-9  # of a curvature
Choice = tuple[float, int, int, float | None]  # a promise, a wall, a step, an angle
NEAR, ROUNDS = Fraction(1, 10**5), 4  # of the target, from where on digits are refined; so often
SIZES = 1e3, 1e5, 1e8, 1e1, 1.0  # of multipliers that say that nothing is feasible, in turn


class WallSplits:
    """Chooses walls by whose sides to split what enters them.

    Args:
        posed: the problem.
        curvatures: by how much positions give way to what presses them, shape (N,).
        unit: of lengths [m].
    """

    def __init__(self, posed: StatedProblem, curvatures: Array, unit: float) -> None:
        self._curvatures, self._spare = np.maximum(curvatures, LEAST), SATISFIED * unit
        beside = list(itertools.product(enumerate(posed.limits.walls), range(posed.horizon)))
        boxes = [(j, wall, k) for (j, wall), k in beside if isinstance(wall, BoxWall)]
        discs = [(j, wall, k) for (j, wall), k in beside if isinstance(wall, DiscWall)]
        discs = discs if posed.n == 2 else []  # balls have no sides
        self._boxes, self._discs = ([(j, k) for j, _, k in each] for each in (boxes, discs))
        self._by_boxes, self._by_discs = (
            _Told([[place for place, _ in wall.told(k)] for _, wall, k in each])
            for each in (boxes, discs)
        )
        self._normals = np.vstack([-np.eye(posed.n), np.eye(posed.n)])
        sides = range(2 * posed.n)
        self._least = np.array(
            [
                [self._by_boxes.even([row.least for row in box.side(i, k)]) for i in sides]
                for _, box, k in boxes
            ],
            float,
        )
        self._middles = np.array(
            [self._by_discs.even([middle for _, middle in disc.told(k)]) for _, disc, k in discs],
            float,
        )
        self._radii = np.array([disc.radius(k) for _, disc, k in discs], float)

    def best(self, region: Region, x: Array) -> Choice | None:
        """Return the wall and the step whose sides all promise most; None if none is missed.

        Args:
            region: to be split.
            x: R_1 e1..R_N e1 that may enter walls, shape (N, n).
        """
        found = [*self._through_boxes(x), *self._through_discs(region, x)]
        return max(found, key=lambda each: each[0], default=None)

    def _through_discs(self, region: Region, x: Array) -> Iterator[Choice]:
        """Yield the discs that are entered, with an angle to split the directions to there at."""
        if not self._discs:
            return
        normals, away = separation(self._by_discs.places(x) - self._middles)
        short = self._radii - away
        for i in np.flatnonzero(short > self._spare).tolist():
            j, k = self._discs[i]
            low, high = map(float, side_of(region, k, j))
            if high - low < NARROWEST:
                continue
            middle, margin = 0.5 * (low + high), MARGIN * (high - low)
            angle = math.atan2(normals[i, 1], normals[i, 0])
            angle += 2.0 * math.pi * round((middle - angle) / (2.0 * math.pi))
            at = min(high - margin, max(low + margin, angle))
            yield float(short[i] ** 2 / self._curvatures[k]), j, k, at

    def _through_boxes(self, x: Array) -> Iterator[Choice]:
        """Yield the box that is entered whose sides all promise most."""
        if not self._boxes:
            return
        along = np.einsum('in,emn->eim', self._normals, self._by_boxes.places(x))
        short = np.maximum(self._least - along, 0.0).max(axis=-1).min(axis=-1)
        steps = np.array([k for _, k in self._boxes])
        promises = np.where(short > self._spare, short**2 / self._curvatures[steps], -1.0)
        best = int(np.argmax(promises))
        if promises[best] > 0.0:
            yield float(promises[best]), *self._boxes[best], None


class _Told:
    """Places beside walls, as many of each: the last ones more than once.

    Args:
        told: of each wall and step.
    """

    def __init__(self, told: list[list[Place]]) -> None:
        self._most = max(map(len, told), default=0)
        every = [self.even(each) for each in told]
        self._free = np.array([[place.free for place in each] for each in every], float)
        self._reach = np.array([[place.reach for place in each] for each in every], float)

    def even(self, values: list) -> list:
        """Return as many values as there are most places, the last one again."""
        return [*values, *values[-1:] * (self._most - len(values))]

    def places(self, x: Array) -> Array:
        """Return where axes lead, shape (E, m, n) [m]."""
        return np.asarray(self._free + self._reach[..., : len(x)] @ x)
