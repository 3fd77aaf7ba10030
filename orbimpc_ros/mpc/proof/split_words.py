# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A tree of splits in the words of certificates: by faces, by directions, and by speeds.

A search whose last heading is limited has a tree for each way round to it. In a certificate they
are parts of one: the directions of the last step are split at the edges of the cone of approach,
once for each way round, and what is outside of it has leaves that say so.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.mpc.problem.approach import LEEWAY
from orbimpc_ros.mpc.proof.certificate import Leaf, Split, Tree
from orbimpc_ros.mpc.proof.grounds import LEAF, Grounds
from orbimpc_ros.mpc.proof.slopes import HALF

AMPLE = 2.0  # times the multipliers that would do
APART = 1e-9  # [rad] from the ends of all directions, of a split
HALF_TURN, TURN = math.pi, 2.0 * math.pi


class _Piece(NamedTuple):
    """Directions of the last heading, up to where the next piece begins.

    Attributes:
        low: the least of them [rad].
        high: the greatest.
        outside: which leaf says that these are outside of the cone; None of what is inside.
    """

    low: float
    high: float
    outside: Leaf | None


def split_words(
    problem: Problem, state: State, grounds: Grounds, bound: float, unit: float
) -> tuple[Tree, Array | None] | None:
    """Return the tree that grounds are, and from where directions are counted.

    Args:
        problem: what was solved.
        state: where plans start.
        grounds: of a method.
        bound: that they prove.
        unit: of the bends, in that of the cost.

    Returns:
        None where certificates count directions from elsewhere, or would have to know how much of
        a polygonal floor is within a range of speeds. No origins where no directions are split, or
        the attitude is where they are counted from.
    """
    angled = (grounds.splits != LEAF) & ~np.isnan(grounds.angles)
    by_angles = bool((angled & (grounds.splits < problem.horizon)).any())
    turned = problem.max_rate > 0.0 and problem.floor.exists and problem.dimension == 2
    wide = turned and problem.widest_turn >= HALF
    paced = problem.max_acceleration > 0.0 and problem.dimension == 2
    if (wide and by_angles) or (paced and problem.floor.shape == 'polygon'):
        return None
    roots = _trees_of(grounds, unit, problem.floor)
    made: Tree | None = roots[0]
    if turned and problem.approach.exists and not wide:
        made = _around(problem, state, roots, bound)
    origins = grounds.origins if by_angles and not turned else None
    return None if made is None else (made, origins)


def _trees_of(grounds: Grounds, unit: float, floor: Floor) -> list[Tree]:
    """Return the trees that grounds are, in the order of their roots.

    Parts come after what they are parts of.
    """
    made: dict[int, Tree] = {}
    count = grounds.points.shape[1]
    for t in reversed(range(len(grounds.splits))):
        k = int(grounds.splits[t])
        if k == LEAF:
            pulled = (grounds.pulls[t], float(grounds.stiffness[t])) if len(grounds.pulls) else ()
            made[t] = Leaf(grounds.points[t], unit * grounds.bends[t], *pulled)
            continue
        first, angle = int(grounds.parts[t]), float(grounds.angles[t])
        at = None if math.isnan(angle) else angle
        parts = tuple(made.pop(first + i) for i in range(floor.faces if at is None else 2))
        if k >= count:
            made[t] = Split(k - count + 1, parts, speed=at)
        else:
            made[t] = Split(k + 1, parts, at)
    return [made[t] for t in sorted(made)]


def _around(problem: Problem, state: State, roots: list[Tree], bound: float) -> Tree | None:
    """Return the tree of all directions of the last step; None where trees are not one a way."""
    ahead = state.attitude[:, 0]
    begun, reach = math.atan2(ahead[1], ahead[0]), problem.horizon * problem.widest_turn
    low, high = begun - reach + APART, begun + reach - APART
    every = _pieces(problem, state, (low, high), bound)
    pieces = [each for each in every if each.low < high and each.high > low]
    if sum(each.outside is None for each in pieces) != len(roots):
        return None
    ways = iter(roots)
    parts = [each.outside or next(ways) for each in pieces]
    return _chain(problem.horizon, [each.low for each in pieces[1:]], parts)


def _pieces(
    problem: Problem, state: State, ends: tuple[float, float], bound: float
) -> Iterator[_Piece]:
    """Yield pieces from before one end to beyond the other: below, inside and above the cone.

    A line through 0 has the cone on one side, and the piece that is below or above it on the other.
    So what is in both has w . z > 0 and w . z < 0, with w across the line.
    """
    axis, cone = problem.approach.axis(state), problem.approach.cone
    last, within = math.atan2(axis[1], axis[0]), cone + LEEWAY
    between = cone + 0.5 * LEEWAY
    size = AMPLE * max(1.0, bound) / (math.sin(0.5 * LEEWAY) * problem.least_heading)
    first, final = (round((end - last) / TURN) for end in ends)
    for turns in range(first, final + 1):
        middle = last + TURN * turns
        below, above = (
            Leaf(shares=_last(problem, sign * size * _across(middle + sign * between)))
            for sign in (-1.0, 1.0)
        )
        yield _Piece(middle - HALF_TURN, middle - within, below)
        yield _Piece(middle - within, middle + within, None)
        yield _Piece(middle + within, middle + HALF_TURN, above)


def _across(angle: float) -> Array:
    """Return the unit vector to the right of a direction."""
    return np.array([math.sin(angle), -math.cos(angle)])


def _last(problem: Problem, share: Array) -> Array:
    """Return shares of the last step alone, shape (N, 2)."""
    shares = np.zeros((problem.horizon, 2))
    shares[-1] = share
    return shares


def _chain(step: int, cuts: Sequence[float], parts: Sequence[Tree]) -> Tree:
    """Return a split at one angle after another."""
    made = parts[-1]
    for at, part in zip(reversed(cuts), reversed(parts[:-1]), strict=True):
        made = Split(step, (part, made), at)
    return made
