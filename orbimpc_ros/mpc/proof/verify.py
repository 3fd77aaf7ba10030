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
from orbimpc_ros.mpc.kernels import COMPILED, compiled
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.bound import (
    PAUSED,
    PROVED,
    REFUTED,
    Leaves,
    Sections,
    Walk,
    Work,
    tree_bound,
)
from orbimpc_ros.mpc.proof.limits import NO_LIMITS, Limits, limits_of
from orbimpc_ros.mpc.proof.splits import ICOSAHEDRON, Allowed, Order, Region, depths_of
from orbimpc_ros.mpc.proof.stated import FREE, Stated, Statement
from orbimpc_ros.mpc.proof.tree import ProofTree, fits, one

MOST = 1 << 24  # numbers of a region
SLICE = 4000  # points of steps between two looks at the time: that takes 2 to 5 ms
HOSTILE = ArithmeticError, ValueError  # of numbers that are none, or far too large
_depths, _bound = compiled(depths_of), compiled(tree_bound)


class Verifier:
    """Verifies bounds of one problem at each tick.

    Args:
        problem: whose bounds; limits that proofs do not know can only make trajectories dearer.
    """

    def __init__(self, problem: Problem) -> None:
        self._statement = Statement(problem)
        self._work = work_of(problem, self._statement.width, float)
        self._region = region_of(1, 2 * problem.horizon, problem.dimension, float)
        if COMPILED:  # the first call loads machine code: at start-up, not in a tick
            n, count = problem.dimension, problem.horizon
            start, leaf = State.at(np.zeros(n), np.eye(n), wanted=np.eye(n)), np.zeros(count)
            still = one(np.zeros((count, self._statement.width)), leaf)
            self._bound(start, np.zeros((count, n)), still, NO_LIMITS)

    def bound(
        self,
        state: State,
        goals: Array,
        tree: ProofTree,
        late: Callable[[], bool] | None = None,
    ) -> float:
        """Return a cost that no trajectory undercuts; -inf if a tree proves none, or none in time.

        Infinity if it proves that there is no trajectory.

        Args:
            state: where trajectories start.
            goals: g_1..g_N, shape (N, n) [m].
            tree: in the units of the problem.
            late: whether time is up; a tree is taken in slices of a few milliseconds.
        """
        limits = limits_of(self._statement.problem, state, goals)
        return self._bound(state, goals, tree, limits, late)

    def _bound(
        self,
        state: State,
        goals: Array,
        tree: ProofTree,
        limits: Limits,
        late: Callable[[], bool] | None = None,
    ) -> float:
        problem = self._statement.problem
        stated = self._statement.of(state, goals, limits)
        if not fits(tree, problem.horizon, stated.n, stated.width, stated.ends.arrives):
            return -math.inf
        depth = np.empty(len(tree.nodes), np.int64)
        most, choices = _depths(tree.nodes, depth), (2 + len(stated.bodies.of)) * problem.horizon
        if most < 0 or (most + 1) * choices > MOST:
            return -math.inf
        if self._region.part.shape[0] <= most or self._region.part.shape[1] != choices:
            self._region = region_of(2 * most + 1, choices, problem.dimension, float)
        parts = *parts_of(stated, tree), depth, self._region, self._work
        walk, most = walk_of(tree, float), 1 + SLICE // problem.horizon
        try:
            found = _bound(stated, *parts, walk, most)
            while found[-1] == PAUSED and not (late and late()):
                found = _bound(stated, *parts, walk, most)
        except HOSTILE:
            return -math.inf
        return _verdict(*found)


def exact_bound(
    problem: Problem,
    state: State,
    goals: Array,
    tree: ProofTree,
    limits: Limits,
    radius: float = -1.0,
) -> float:
    """Return what a tree proves, in fractions: see :meth:`Verifier.bound`; rounded down.

    Args:
        problem: whose bound; its obstacles count only as the limits have them.
        state: where trajectories start.
        goals: g_1..g_N, shape (N, n) [m].
        tree: in the units of the problem.
        limits: beside the problem's own.
        radius: within which s_N is of g_N [m]; negative where it may be anywhere.

    Raises:
        BadInput: what cannot be stated in fractions.
    """
    statement = Statement(problem, Fraction)
    stated = statement.of(state, goals, limits, radius)
    if not fits(tree, problem.horizon, stated.n, stated.width, stated.ends.arrives):
        return -math.inf
    depth, choices = np.empty(len(tree.nodes), np.int64), len(stated.bodies.of) + 2
    most, choices = depths_of(tree.nodes, depth), choices * problem.horizon
    if most < 0 or (most + 1) * choices > MOST:
        return -math.inf
    region = region_of(most + 1, choices, problem.dimension, object)
    work = work_of(problem, statement.width, object)
    try:
        parts = *parts_of(stated, in_fractions(tree)), depth, region, work
        return _verdict(*tree_bound(stated, *parts, walk_of(tree, object), len(tree.nodes)))
    except HOSTILE:
        return -math.inf


def parts_of(stated: Stated, tree: Any) -> tuple:
    """Return a tree as its bound takes it."""
    capped = max(0, len(stated.root.patches) - ICOSAHEDRON)
    solid = len(stated.sets.faces)
    count = tree.point.shape[1]
    allowed = Allowed(stated.n, count, stated.decided == FREE, solid, capped)
    sorts = tree.pull, tree.slide, tree.tether, tree.share, tree.meet[:, None]
    begins, number = [], 0
    for each in sorts:
        begins.append(number if each.size else -1)
        number += each.shape[1] if each.size else 0
    known = [each for each in sorts if each.size]
    forces = tree.point[:, :0, : stated.n]
    if known:
        forces = known[0] if len(known) == 1 else np.concatenate(known, axis=1)
    rows = tree.press_end, tree.press_row, tree.press
    leaves = Leaves(tree.point, tree.shor, *rows, np.ascontiguousarray(forces))
    return (
        allowed,
        Order(tree.ordered, tree.origins),
        tree.nodes,
        tree.at,
        leaves,
        Sections(*begins),
    )


def in_fractions(tree: ProofTree) -> Any:
    """Return a tree whose numbers are fractions."""
    numbers: dict[str, Any] = {}
    for name, value in tree._asdict().items():
        if isinstance(value, np.ndarray) and value.dtype == float:
            made = np.empty(value.shape, object)
            made.ravel()[:] = [Fraction(each) for each in value.ravel().tolist()]
            numbers[name] = made
    return tree._replace(**numbers)


def _verdict(least: Any, leaves: int, what: int) -> float:
    if what == REFUTED:
        return math.inf
    return rounded_down(least) if what == PROVED else -math.inf


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


def walk_of(tree: ProofTree, kind: Any) -> Walk:
    """Return how far a walk through a tree is before it begins."""
    count = len(tree.nodes)
    waiting, parent = np.zeros(count, np.int64), np.zeros(count, np.int64)
    return Walk(waiting, parent, np.zeros(2, np.int64), np.zeros(1, kind))


def work_of(problem: Problem, width: int, kind: Any) -> Work:
    """Return arrays for the bounds of leaves to be worked out in."""
    count, n = problem.horizon, problem.dimension
    flown, slopes = np.zeros((4, count + 1, n), kind), np.zeros((count, width), kind)
    squares = np.zeros((2 * count + 2, count), kind)
    return Work(flown, slopes, np.zeros((2, width), kind), np.zeros((4, 4), kind), squares)
