# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Turn limits as angles, for a search whose relaxations bound only chords.

With a floor, the chord of a turn by the widest angle a depends on the speeds before and after it; a
relaxation allows the longest chord. To find a trajectory, headings are confined to *cells*, beyond
tangents or faces of the floor, in which their speeds are at least r_k, and the chord between
consecutive headings to the distance between two points at the radii r_k and r_{k+1} with the angle
a between them: then no turn is too wide.

Mathematics: docs/mathematics.md, 3.6.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import turn_margin
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED, turned_within
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.relaxation import Row

WITHIN = 1.0 - 1e-6  # share of the widest turn
KEPT = 0.9  # share of its speed that a heading keeps in the next solve
THIN, WIDEST = 1e-9, 1.5  # [rad] least half-angle of a cone; largest, since tan grows without limit


class Turns:
    """The turns of a problem with a floor and a ``max_rate``.

    Args:
        problem: what to solve.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem, floor, n = problem, problem.floor, problem.dimension
        self._widest, self._least = WITHIN * problem.widest_turn, problem.least_speed
        self._shares = np.eye(problem.horizon)
        # At a speed all headings allow, the turn whose chord is that of the widest at least speed.
        half = self._least * math.sin(0.5 * self._widest) / floor.circling(n)
        self._turn = 2.0 * math.asin(min(1.0, half))
        self._cosines = {k: math.cos(angle) for k, angle in problem.turned_cones.items()}
        if problem.first_turn_is_a_cone:
            del self._cosines[1]

    def rows(self, state: State, *, narrow: bool = False) -> tuple[Row, ...]:
        """Return half-spaces that hold for all headings the vehicle can have reached by a step.

        There are none at rotation order 2, nor for a first turn bounded by a cone.

        Args:
            state: initial state of plans.
            narrow: whether the half-space of the first turn has to imply its angle limit.
        """
        axis, rows = state.attitude[:, 0], list[Row]()
        for k, share in self._cosines.items():
            bound = max if narrow and k == 1 else min
            rows.append(Row(k - 1, self._shares[k - 1], axis, bound(share, self._least * share)))
        return tuple(rows)

    def followed(self, state: State, headings: Array) -> Array:
        """Return headings of the same lengths that follow others as turns allow, shape (N + 1, n).

        Args:
            state: initial state of the plan.
            headings: R_0 e1..R_N e1, shape (N + 1, n).
        """
        unit, turned = state.attitude[:, 0], headings.copy()
        for k, heading in enumerate(headings[1:], 1):
            size = float(np.linalg.norm(heading))
            wanted = heading / size if size > HEADING_UNDEFINED else unit
            decided = k == 1 and self._problem.rotation_order == 2
            unit = wanted if decided else turned_within(unit, wanted, self._turn)
            turned[k] = max(size, self._least) * unit
        return turned

    def cells(self, headings: Array, share: float) -> tuple[Row, ...]:
        """Return the cells of headings R_1 e1..R_N e1, raised to a share of their speeds.

        Args:
            headings: R_0 e1..R_N e1, shape (N + 1, n).
            share: the share; 0 for the least speeds.
        """
        normals = self._problem.floor.tangent(headings[1:])  # of a round floor, or nearest faces
        fast = np.maximum(self._least, share * (normals * headings[1:]).sum(axis=1)).tolist()
        rows = zip(self._shares, normals, fast, strict=True)
        return tuple(Row(k, *row) for k, row in enumerate(rows))

    def cones(self, state: State, headings: Array) -> tuple[Row, ...]:
        """Return half-spaces about headings R_0 e1..R_N e1 in which any speeds turn in time."""
        sizes = np.maximum(np.linalg.norm(headings, axis=1, keepdims=True), HEADING_UNDEFINED)
        halves = np.maximum(spared(self._problem, state, headings), THIN).tolist()
        units, first = (headings / sizes)[1:], self._problem.rotation_order - 1
        return tuple(row for k, half in enumerate(halves, first) for row in cone(k, units, half))

    def close(self, cells: Sequence[Row]) -> Array:
        """Return limits on chords that imply the angle limit for headings in these cells."""
        speeds = np.array([cell.offset for cell in cells])
        slow, fast = np.minimum(speeds[1:], speeds[:-1]), np.maximum(speeds[1:], speeds[:-1])
        share = math.cos(self._widest)
        slow = np.maximum(slow, fast * share)
        return np.sqrt(slow * slow + fast * fast - 2.0 * slow * fast * share)


def spared(problem: Problem, state: State, headings: Array, leeway: float = 0.0) -> Array:
    """Return the angle that each free direction can deviate by, whatever others do [rad].

    Negative where a turn is already too wide by more than ``leeway``.
    """
    left = leeway + turn_margin(problem, state, headings)[problem.rotation_order - 1 :]
    left[1:] *= 0.5  # shared by both directions; the first turn is from a fixed one
    return np.asarray(np.minimum(left, np.append(left[1:], np.inf)))


def cone(k: int, units: Array, half: float) -> list[Row]:
    """Return half-spaces whose intersection is within a cone about direction k.

    Args:
        k: the step, from 0.
        units: directions, shape (N, n).
        half: half-angle of the cone [rad]; 0 for planes that intersect in its axis.
    """
    _, _, across = np.linalg.svd(units[k : k + 1])
    sides = np.vstack([across[1:], -across[1:]]) if half else across[1:]
    wide = math.tan(min(half, WIDEST)) / math.sqrt(len(across) - 1)
    return [Row(k, np.eye(len(units))[k], wide * units[k] + side, 0.0) for side in sides]
