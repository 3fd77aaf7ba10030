# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Verification of bounds: what a tree proves of a problem, in floats at a tick, or in fractions.

Nothing of a search is used. A tree that is wrong in any way proves nothing; no tree proves more
than a trajectory costs.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.arithmetic import bare, floats
from orbimpc_ros.mpc.proof.bound import (
    PAUSED,
    PROVED,
    REFUTED,
    depths_of,
    tree_bound,
    work_of,
)
from orbimpc_ros.mpc.proof.splits import Region
from orbimpc_ros.mpc.proof.stated import NO_LIMITS, Limits, Statement
from orbimpc_ros.mpc.proof.tree import ProofTree, fits, one

MOST = 1 << 24  # numbers of a region
SLICE = 2000  # points of steps between two looks at the time: that takes 1 to 3 ms
HOSTILE = ArithmeticError, ValueError  # of numbers that are none, or far too large
_depths, _bound = floats(depths_of), floats(tree_bound)


class Verifier:
    """Verifies bounds of one problem.

    Args:
        problem: whose bounds; limits that proofs do not know can only make trajectories dearer.
        number: ``float``, as at each tick; or ``Fraction``, exactly.

    Raises:
        BadInput: a problem that cannot be stated in fractions.
    """

    def __init__(self, problem: Problem, number: type[float | Fraction] = float) -> None:
        self._statement, self._exact = Statement(problem, number), number is Fraction
        self._kind: type = object if self._exact else float
        self._depths, self._bound = _depths, _bound
        if self._exact:
            self._depths, self._bound = depths_of, tree_bound
        self._work = work_of(problem, self._statement.width, self._kind)
        self._region = region_of(1, 2 * problem.horizon, problem.dimension, self._kind)
        if COMPILED and not self._exact:  # it is loaded at start-up, not in a tick
            n, count = problem.dimension, problem.horizon
            start, leaf = State.at(np.zeros(n), np.eye(n), wanted=np.eye(n)), np.zeros(count)
            still = one(np.zeros((count, self._statement.width)), leaf)
            self.bound(start, np.zeros((count, n)), still, limits=NO_LIMITS)
            self._bound = bare(_bound)

    def bound(
        self,
        state: State,
        goals: Array,
        tree: ProofTree,
        late: Callable[[], bool] | None = None,
        limits: Limits | None = None,
    ) -> float:
        """Return a cost that no trajectory undercuts; -inf if a tree proves none, or none in time.

        Infinity if it proves that there is no trajectory.

        Args:
            state: where trajectories start.
            goals: g_1..g_N, shape (N, n) [m].
            tree: in the units of the problem.
            late: whether time is up; a tree is taken in slices of a few milliseconds.
            limits: beside the problem's own, whose obstacles count only as these have them; by
                default those from the state.
        """
        problem = self._statement.problem
        if limits is None:
            limits = self._statement.limits(state, goals)
        stated = self._statement.of(state, goals, limits)
        if not fits(tree, problem.horizon, stated.n, stated.width, stated.ends.arrives):
            return -math.inf
        walk = np.empty((3, len(tree.nodes)), np.int64)
        deepest = self._depths(tree.nodes, walk)
        choices = (2 + len(stated.bodies.of)) * problem.horizon
        if deepest < 0 or (deepest + 1) * choices > MOST:
            return -math.inf
        if self._region.part.shape[0] <= deepest or self._region.part.shape[1] != choices:
            self._region = region_of(2 * deepest + 1, choices, problem.dimension, self._kind)
        most, what = 1 + SLICE // problem.horizon, PAUSED
        seen: tuple[Any, int, int] = 0.0, 0, 0
        try:
            known = stated, in_fractions(tree) if self._exact else tree, walk
            while what == PAUSED and not (seen[-1] and late and late()):
                *seen, what = self._bound(*known, self._region, self._work, *seen, most)
        except HOSTILE:
            return -math.inf
        if what == REFUTED:
            return math.inf
        return rounded_down(seen[0]) if what == PROVED else -math.inf


def in_fractions(tree: ProofTree) -> Any:
    """Return a tree whose numbers are fractions."""
    numbers: dict[str, Any] = {}
    for name, value in tree._asdict().items():
        if isinstance(value, np.ndarray) and value.dtype == float:
            made = np.empty(value.shape, object)
            made.ravel()[:] = [Fraction(each) for each in value.ravel().tolist()]
            numbers[name] = made
    return tree._replace(**numbers)


def rounded_down(x: Any) -> float:
    """Return the largest double that is not above a number; -inf below all."""
    if not abs(x) <= sys.float_info.max:
        return sys.float_info.max if x > 0 else -math.inf
    nearest = float(x)
    return nearest if nearest <= x else math.nextafter(nearest, -math.inf)


def region_of(depths: int, choices: int, n: int, kind: Any) -> Region:
    """Return arrays for what is known of choices at so many depths."""
    shape = depths, choices
    corners = np.zeros((depths, choices if n == 3 else 1, 3, 3), kind)
    return Region(np.zeros(shape, np.int64), np.zeros((*shape, 2), kind), corners)
