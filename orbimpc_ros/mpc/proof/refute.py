# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""From the claim that nothing is feasible, or catches a goal, to its certificate.

Nothing of a method is used: all trajectories are split, depth first, by the sides of bodies and by
directions, until what is asked of each part is missed. Nothing of this has to be believed: see
:mod:`orbimpc_ros.mpc.proof.verify`.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem.sought import Sought
from orbimpc_ros.mpc.proof.bound import leaf_bound, work_of
from orbimpc_ros.mpc.proof.document import Posed, Refutation, refuted_by
from orbimpc_ros.mpc.proof.missed import MissedProgram, Side
from orbimpc_ros.mpc.proof.prove import OutOfTime, Unproved, patient
from orbimpc_ros.mpc.proof.rows import about
from orbimpc_ros.mpc.proof.splits import GONE, HELD, ICOSAHEDRON, Cut, begin, part_of
from orbimpc_ros.mpc.proof.stated import FREE, Statement
from orbimpc_ros.mpc.proof.tree import (
    ARCS,
    ARRAYS,
    CUT,
    EMPTY,
    FACES,
    OPTIONAL,
    PATCHES,
    QUARTERS,
    SIDES,
    ProofTree,
)
from orbimpc_ros.mpc.proof.verify import region_of

NARROWEST = 1e-6  # [rad] of a sector that is split
SATISFIED = 1e-9  # of a step's length: a body that is entered by less is not split
LEAST = 1e-9  # of a curvature
MARGIN = 0.15  # of a sector, to either end
AROUND = 4  # arcs of all directions
DEEPEST = 200  # nodes above a leaf


def refutation_of(sought: Sought, out_of_time: OutOfTime = patient) -> Refutation:
    """Return what proves that nothing is feasible.

    Args:
        sought: in what.
        out_of_time: polled before each part of all trajectories; True gives up.

    Raises:
        Unproved: none was found.
    """
    return _refuting(Refutation(sought, ()), 1, out_of_time)


def catches_refuted(sought: Sought, count: int, out_of_time: OutOfTime = patient) -> Refutation:
    """Return what proves that the goal is not caught at the ends of the first steps.

    Args:
        sought: in what, with the radius of a catch.
        count: of steps.
        out_of_time: as for :func:`refutation_of`.

    Raises:
        Unproved: for one of them none was found.
    """
    return _refuting(Refutation(sought, ()), count, out_of_time)


def _refuting(made: Refutation, count: int, out_of_time: OutOfTime) -> Refutation:
    """Return what refutes all that there is, or catches at the first steps.

    Raises:
        Unproved: for one of them none was found.
    """
    problems = refuted_by(made.document(), count)
    return replace(made, trees=tuple(_tree(each, out_of_time) for each in problems))


def _tree(posed: Posed, out_of_time: OutOfTime) -> ProofTree:
    """Return the tree that refutes a problem.

    Raises:
        Unproved: none was found.
    """
    tree = RefutationSearch(posed, out_of_time).tree()
    if tree is None:
        catch = f'a catch at step {posed.problem.horizon}'
        what = catch if posed.radius >= 0.0 else 'all that there is'
        raise Unproved(f'no certificate: no refutation of {what} was found')
    return tree


class RefutationSearch:
    """Depth first over sides of bodies and directions, until each part misses what is asked of it.

    Args:
        posed: the problem, as the verifier reads it.
        out_of_time: polled before each part.
    """

    most = 2000  # leaves

    def __init__(self, posed: Posed, out_of_time: OutOfTime) -> None:
        problem, self._out_of_time = posed.problem, out_of_time
        stated = self._stated = Statement(problem).of(*posed[1:])
        self._unit, self._count = problem.length_unit, problem.horizon
        self._program = MissedProgram(stated, self._unit, problem.step)
        self._curvatures = np.maximum(np.sum(self._program.steered[0, 1:] ** 2, 1), LEAST)
        choices = (2 + len(stated.bodies.of)) * self._count
        self._region = region_of(DEEPEST, choices, stated.n, float)
        self._work = work_of(problem, stated.width, float)
        self._nodes, self._at, self._leaves = list[list[int]](), list[float](), list[ProofTree]()

    def tree(self) -> ProofTree | None:
        """Return splits and leaves that refute all; None where that takes too many.

        Raises:
            Unproved: it takes too long.
        """
        self._add(1)
        stated, known = self._stated, (self._region.part[0], self._region.span[0])
        if begin(stated, self._program.nowhere, *known) == HELD:
            self._poll()
            beyond = self._program.beyond
            held = beyond is not None and self._refutes(0, 0, beyond)
            if not held and not self._refuted(0, 0, ()):
                return None
        return self._made()

    def _poll(self) -> None:
        if self._out_of_time():
            raise Unproved('no certificate: no refutation was found in time')

    def _add(self, count: int) -> int:
        """Add nodes that nothing is left of; return the number of the first."""
        self._nodes += [[EMPTY, 0, 0, 0, -1] for _ in range(count)]
        self._at += count * [0.0]
        return len(self._nodes) - count

    def _refutes(self, place: int, depth: int, leaf: ProofTree) -> bool:
        """Return whether a leaf proves that nothing is at a node, which then keeps it."""
        value, sound = leaf_bound(self._stated, self._region, depth, leaf, 0, True, self._work)
        if len(self._leaves) == self.most or not (sound and value > 0.0):
            return False
        self._nodes[place][4] = len(self._leaves)
        self._leaves.append(leaf)
        return True

    def _refuted(self, place: int, depth: int, sides: tuple[Side, ...]) -> bool:
        """Return whether nothing is at a node, which then is the root of what proves it."""
        if depth:
            self._poll()
        missed = self._program.answer(self._region, depth, sides)
        if missed is None:
            return False
        if not missed.feasible and self._refutes(place, depth, missed.leaf):
            return True
        cut = self._beside(depth, missed.x) if missed.feasible else None
        cut = cut or self._turned(depth)
        return cut is not None and self._split(place, depth, sides, cut)

    def _split(self, place: int, depth: int, sides: tuple[Side, ...], cut: Cut) -> bool:
        """Return whether nothing is in any part of a node that is split."""
        if depth + 1 == DEEPEST:
            return False
        first = self._add(cut.parts)
        self._nodes[place] = [cut.kind, cut.choice, first, cut.parts, -1]
        self._at[place] = cut.at
        if cut.choice >= 2 * self._count:
            sides = (*sides, (depth + 1, cut.choice))
        known = self._stated, self._program.nowhere, np.array(self._nodes[place]), cut.at
        for i in range(cut.parts):
            part = part_of(*known, i, depth + 1, self._region)
            if part == GONE:
                continue
            if part != HELD or not self._refuted(first + i, depth + 1, sides):
                return False
        return True

    # --- where to split

    def _beside(self, depth: int, x: Array) -> Cut | None:
        """Return the split beside the body that a trajectory enters whose sides promise most."""
        short, ways = self._program.places.entered(x)
        promises = np.where(short > SATISFIED * self._unit, short, 0.0) ** 2 / self._curvatures
        for i in np.argsort(-promises, axis=None).tolist():
            j, k = divmod(i, self._count)
            if promises[j, k] <= 0.0:
                return None
            choice = 2 * self._count + i
            if self._stated.bodies.extents[j, -1] > 0.0:
                cut = self._directed(depth, choice, ways[j, k])
            elif self._region.part[depth, choice] < 0:
                cut = Cut(SIDES, choice, 2 * self._stated.n)
            else:
                cut = None
            if cut is not None:
                return cut
        return None

    def _turned(self, depth: int) -> Cut | None:
        """Return the split of the heading of which hulls hold most beside what they are of."""
        gains = [self._gain(depth, k) for k in range(self._count)]
        k = int(np.argmax(gains))
        if not gains[k] > 0.0:
            return None
        if len(self._stated.sets.faces):
            return Cut(FACES, k, len(self._stated.sets.faces))
        return self._directed(depth, k, None)

    def _gain(self, depth: int, k: int) -> float:
        """Return by how much more the hull of directions holds, as R_k e1 leads [m]."""
        stated, known = self._stated, self._region.part[depth, k] >= 0
        if (k == 0 and stated.decided != FREE) or not (known or stated.sets.least > 0.0):
            return 0.0
        if known and len(stated.sets.faces):
            return 0.0
        low, high = self._region.span[depth, k]
        deep = 2.0
        if known and stated.n == 2:
            deep = 1.0 - math.cos(min(0.5 * (high - low), math.pi))
            deep *= high - low > NARROWEST
        elif known:
            deep = 1.0 - about(self._region.corners[depth, k], np.zeros(3))[0]
            deep *= deep > NARROWEST**2
        return float(abs(self._program.reach[k]) * deep)

    def _directed(self, depth: int, choice: int, way: Array | None) -> Cut | None:
        """Return the split of directions, in the plane at one of them, or in the middle."""
        part, (low, high) = self._region.part[depth, choice], self._region.span[depth, choice]
        if self._stated.n == 3:
            known = part >= 0
            return Cut(QUARTERS, choice, 4) if known else Cut(PATCHES, choice, ICOSAHEDRON)
        angle = 0.0 if way is None else math.atan2(way[1], way[0])
        if part < 0:
            return Cut(ARCS, choice, AROUND, angle)
        if high - low < NARROWEST:
            return None
        middle, margin = 0.5 * (low + high), MARGIN * (high - low)
        angle += 2.0 * math.pi * round((middle - angle) / (2.0 * math.pi))
        at = middle if way is None else min(high - margin, max(low + margin, angle))
        return Cut(CUT, choice, 2, at)

    # --- the tree

    def _made(self) -> ProofTree:
        """Return the tree of all nodes, and of what their leaves have."""
        leaves = self._leaves or [self._program.nowhere]
        stacked: dict[str, Any] = {}
        for name in (*ARRAYS[2:4], *ARRAYS[5:], *OPTIONAL):
            every = [getattr(each, name) for each in leaves]
            shape = max((each.shape for each in every if each.size), default=every[0].shape)
            absent = name in OPTIONAL and any(shape)
            stacked[name] = np.concatenate(
                [each if each.size or not absent else np.zeros(shape) for each in every]
            )
        sizes = np.cumsum([len(each.press) for each in leaves])
        nodes = np.array(self._nodes, np.int64)
        return ProofTree(nodes, np.array(self._at), press_end=sizes, **stacked)
