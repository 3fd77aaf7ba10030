# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Verification of the bound that a proof tree implies, in floats at a tick, or in fractions.

Nothing from the search is used. An invalid tree proves no bound, and no tree proves a bound above
the cost of a trajectory.

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
from orbimpc_ros.mpc.kernels import COMPILED, bare
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.arithmetic import as_fractions, floats
from orbimpc_ros.mpc.proof.bound import DEEP, ENDED, PAUSED, tree_bound, work_of
from orbimpc_ros.mpc.proof.splits import Region
from orbimpc_ros.mpc.proof.stated import NO_LIMITS, Limits, Statement
from orbimpc_ros.mpc.proof.tree import ARRAYS, KINDS, ProofTree, one

DEPTHS, MOST = 32, 1 << 25  # rows of a region at first, and restrictions in it at most
SLICE = 2000  # steps to bound between two checks of the deadline: 1 to 3 ms
# The axes of a tree's arrays: M nodes, L leaves, P rows, N steps, n and d coordinates of a heading
# and of a rotation, m vectors at an arrival.
AXES = 'M5', 'M', 'LNd', 'LN', 'L', 'P', 'P', 'Lmn', 'LN3', 'LNn', 'LNn', 'N'
HOSTILE = ArithmeticError, ValueError  # raised by numbers that are not finite or far too large
_bound = floats(tree_bound)


class Verifier:
    """Verifies bounds of one problem.

    Args:
        problem: to bound; limits that proofs ignore can only raise the cost of trajectories.
        number: ``float``, as at each tick, or ``Fraction``, for exact arithmetic.

    Raises:
        BadInput: a problem that cannot be stated in fractions.
    """

    def __init__(self, problem: Problem, number: type[float | Fraction] = float) -> None:
        self._statement, self._exact = Statement(problem, number), number is Fraction
        self._kind: type = object if self._exact else float
        self._bound = tree_bound if self._exact else _bound
        base = self._statement.base
        n, count, width = base.n, len(base.goals), base.start.shape[1]
        self._work = work_of(base, self._kind)
        self._region = region_of(DEPTHS, 2 * count, n, self._kind)
        self._sizes = {'N': count, 'n': n, 'd': width, 'm': base.arrives, '3': 3, '5': 5}
        self._inner = [tuple(self._sizes[axis] for axis in axes[1:]) for axes in AXES]
        if COMPILED and not self._exact:
            if bare(_bound) is _bound:  # load machine code at start-up, not in a tick
                start, still = State.at(np.zeros(n), np.eye(n), wanted=np.eye(n)), np.zeros(count)
                leaf = one(np.zeros((count, width)), still)
                self.bound(start, np.zeros((count, n)), leaf, limits=NO_LIMITS)
            self._bound = bare(_bound)

    def bound(
        self,
        state: State,
        goals: Array,
        tree: ProofTree,
        late: Callable[[], bool] | None = None,
        limits: Limits | None = None,
    ) -> float:
        """Return a lower bound on the cost of all trajectories; -inf if none is proved in time.

        The bound is infinity if the tree proves that there is no trajectory.

        Args:
            state: where trajectories start.
            goals: g_1..g_N, shape (N, n) [m].
            tree: in the units of the problem.
            late: returns True after the deadline; polled every few milliseconds.
            limits: in addition to the problem's own, but instead of its obstacles; by default
                those from the state.
        """
        problem = self._statement.problem
        if not self._fits(tree):
            return -math.inf
        if limits is None:
            limits = self._statement.limits(state, goals)
        stated = self._statement.of(state, goals, limits)
        walk = np.empty((2, len(tree.nodes)), np.int64)
        choices = (2 + len(stated.bodies.at)) * problem.horizon
        if self._region.part.shape[1] != choices:
            self._region = region_of(DEPTHS, choices, problem.dimension, self._kind)
        most, what = 1 + SLICE // problem.horizon, PAUSED
        seen: tuple[Any, int, int] = 0.0, 0, 0
        try:
            inputs = stated, tree_in_fractions(tree) if self._exact else tree, walk
            while what == PAUSED or (what == DEEP and self._deepened()):
                if what == PAUSED and seen[-1] and late and late():
                    return -math.inf
                *seen, what = self._bound(*inputs, self._region, self._work, *seen, most)
        except HOSTILE:
            return -math.inf
        if what != ENDED:
            return -math.inf
        return rounded_down(seen[0]) if seen[1] > 0 else math.inf

    def _fits(self, tree: ProofTree) -> bool:
        """Return whether a tree that is not trusted has arrays of the types and shapes needed."""
        counts = {'M': len(tree.nodes), 'L': len(tree.point), 'P': tree.press.size, **self._sizes}
        for i, (value, axes, inner) in enumerate(zip(tree, AXES, self._inner, strict=True)):
            if value.dtype != KINDS[i] or value.ndim != len(axes):
                return False
            fits = value.shape == (counts[axes[0]], *inner) and value.flags.c_contiguous
            if not fits and (i < len(ARRAYS) or value.size > 0):
                return False
        return len(tree.nodes) > 0

    def _deepened(self) -> bool:
        """Double the rows of the region; return False if it would exceed ``MOST``."""
        if 2 * self._region.part.size > MOST:
            return False
        self._region = Region(*(np.concatenate([each, each]) for each in self._region))
        return True


def tree_in_fractions(tree: ProofTree) -> Any:
    """Return a tree with its floats as fractions."""
    return ProofTree(*(as_fractions(each) if each.dtype == float else each for each in tree))


def rounded_down(x: Any) -> float:
    """Return the largest double not above a number; -inf if there is none."""
    if not abs(x) <= sys.float_info.max:
        return sys.float_info.max if x > 0 else -math.inf
    nearest = float(x)
    return nearest if nearest <= x else math.nextafter(nearest, -math.inf)


def region_of(depths: int, choices: int, n: int, kind: Any) -> Region:
    """Return arrays for the restrictions of choices at a number of depths."""
    shape = depths, choices
    corners = np.zeros((depths, choices if n == 3 else 1, 3, 3), kind)
    return Region(np.zeros(shape, np.int64), np.zeros((*shape, 2), kind), corners)
