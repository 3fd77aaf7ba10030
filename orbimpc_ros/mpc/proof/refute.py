# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""From the claim that nothing is feasible, or catches a goal, to its certificate.

Nothing of a method is used: all trajectories are split, depth first, by the sides of bodies and by
directions, until what is asked of each part is missed. Nothing of this has to be believed: see
:mod:`orbimpc_ros.mpc.proof.verifier`.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np

from orbimpc_ros.mpc.problem.sought import Sought
from orbimpc_ros.mpc.proof.certificate import Leaf, Refutation, Tree, plain, split_into
from orbimpc_ros.mpc.proof.fewer_limits import with_statable_limits
from orbimpc_ros.mpc.proof.prove import OutOfTime, Unproved, patient
from orbimpc_ros.mpc.proof.refutation_program import Missed, Motion, RefutationProgram, middle_of
from orbimpc_ros.mpc.proof.verifier import Refused, refuted_by
from orbimpc_ros.mpc.proof.verifier.bound import bound
from orbimpc_ros.mpc.proof.verifier.regions import Region, Sector
from orbimpc_ros.mpc.proof.verifier.splits import beside, halves, root
from orbimpc_ros.mpc.proof.verifier.stated import StatedProblem
from orbimpc_ros.mpc.proof.walls import WallSplits

NARROWEST = 1e-6  # [rad] of a sector that is split


def refutation_of(sought: Sought, out_of_time: OutOfTime = patient) -> Refutation:
    """Return what proves that nothing is feasible.

    Args:
        sought: in what.
        out_of_time: polled before each part of all trajectories; True gives up.

    Raises:
        Unproved: none was found.
    """
    return _refuting(stated(sought), 1, out_of_time)


def catches_refuted(sought: Sought, count: int, out_of_time: OutOfTime = patient) -> Refutation:
    """Return what proves that the goal is not caught at the ends of the first steps.

    Args:
        sought: in what, with the radius of a catch.
        count: of steps.
        out_of_time: as for :func:`refutation_of`.

    Raises:
        Unproved: for one of them none was found.
    """
    return _refuting(stated(sought), count, out_of_time)


def stated(sought: Sought) -> Refutation:
    """Return a refutation without its trees, of as much of a problem as certificates can state."""
    problem, state = with_statable_limits(sought.problem, sought.state)
    split = problem.dimension == 2 and problem.floor.exists and not problem.max_rate
    origins = np.zeros(problem.horizon) if split else None
    posed = replace(sought, problem=problem, state=state)
    return Refutation(posed, (), origins)


def _refuting(made: Refutation, count: int, out_of_time: OutOfTime) -> Refutation:
    """Return what refutes all that there is, or catches at the first steps.

    Raises:
        Unproved: for one of them none was found.
    """
    motion = Motion.of(made.sought.problem, made.sought.state, made.sought.goals)
    try:
        problems = refuted_by(made.document(), count)
    except Refused as error:
        raise Unproved(f'no certificate: {error}') from None
    trees = (_tree(made, posed, motion, out_of_time) for posed in problems)
    return replace(made, trees=tuple(trees))


def _tree(made: Refutation, posed: StatedProblem, motion: Motion, out_of_time: OutOfTime) -> Tree:
    """Return the tree that refutes a problem.

    Raises:
        Unproved: none was found.
    """
    k, what = posed.horizon, 'all that there is'
    if posed.radius is not None:
        motion, what = motion.begun(k), f'a catch at step {k}'
    origins = None if made.origins is None else made.origins[:k].tolist()
    program = RefutationProgram(motion, posed)
    tree = RefutationProof(program, posed, motion.unit, origins, out_of_time).tree()
    if tree is None:
        raise Unproved(f'no certificate: no refutation of {what} was found')
    return tree


class RefutationProof:
    """Depth first over sides of bodies and directions, until each part misses what is asked of it.

    Args:
        program: of parts.
        posed: the problem, which says what a leaf proves.
        unit: of lengths [m].
        origins: from where directions are counted; None where an attitude says so.
        out_of_time: polled before each part.
    """

    most = 2000  # leaves

    def __init__(
        self,
        program: RefutationProgram,
        posed: StatedProblem,
        unit: float,
        origins: list | None,
        out_of_time: OutOfTime,
    ) -> None:
        self._program, self._posed, self._out_of_time = program, posed, out_of_time
        self._walls = WallSplits(posed, program.curvatures, unit)
        self._origins, self._leaves = origins, 0

    def tree(self) -> Tree | None:
        """Return splits and leaves that refute all; None where that takes too many.

        Raises:
            Unproved: it takes too long.
        """
        everything, beyond = root(self._posed, self._origins), self._program.beyond
        if beyond is None:
            return self._refuted(everything)
        self._poll()
        held = self._refutes(beyond, everything)
        return self._counted(beyond) if held else self._refuted(everything)

    def _counted(self, leaf: Leaf) -> Leaf | None:
        """Return a leaf, if it is not one too many."""
        self._leaves += 1
        return leaf if self._leaves <= self.most else None

    def _poll(self) -> None:
        if self._out_of_time():
            raise Unproved('no certificate: no refutation was found in time')

    def _refutes(self, leaf: Leaf, region: Region) -> bool:
        """Return whether nothing is in a region, as whoever reads its leaf will find."""
        return bound(self._posed, plain(leaf), region) > 0

    def _refuted(self, region: Region | None) -> Tree | None:
        if region is None:
            return self._program.nothing
        self._poll()
        answer = self._program.answer(region)
        if answer is None:
            return None
        if not answer.feasible and self._refutes(answer.leaf, region):
            return self._counted(answer.leaf)
        return self._beside(region, answer) or self._turned(region)

    def _beside(self, region: Region, answer: Missed) -> Tree | None:
        """Return what refutes a region, split beside the wall that its best trajectory enters."""
        if not answer.feasible:
            return None
        found = self._walls.best(region, answer.x)
        if found is None:
            return None
        _, wall, k, at = found
        return self._split(beside(self._posed, region, k, wall, at), k, at, wall)

    def _turned(self, region: Region) -> Tree | None:
        """Return what refutes a region, split where directions say the least."""
        gains = [self._gain(k, sector) for k, sector in enumerate(region.sectors)]
        k = int(np.argmax(gains))
        sector = region.sectors[k]
        if sector is None or not gains[k]:
            return None
        at = middle_of(sector)
        return self._split(halves(self._posed, region, k, Fraction(at)), k, at)

    def _gain(self, k: int, sector: Sector | None) -> float:
        """Return by how much more the hull of a sector holds than its ends, as R_k e1 leads [m]."""
        width = 0.0 if sector is None else float(sector.high - sector.low)
        deep = 1.0 - math.cos(min(0.5 * width, math.pi))
        return float(self._program.reach[k] * deep) if width > NARROWEST else 0.0

    def _split(
        self, regions: Sequence[Region | None], k: int, at: float | None, wall: int | None = None
    ) -> Tree | None:
        return split_into(map(self._refuted, regions), k + 1, at, wall)
