# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""From what a method left of its proof to the certificate that this is.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.cost import length_weights
from orbimpc_ros.mpc.plan import Proof
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.mpc.proof.certificate import Certificate, Leaf, Split, Tree
from orbimpc_ros.mpc.proof.choice_words import ChoiceWords
from orbimpc_ros.mpc.proof.grounds import LEAF, ChoiceGrounds, Grounds, Tangent
from orbimpc_ros.mpc.proof.slopes import HALF


def kept(problem: Problem, state: State, goals: Array, proof: Proof) -> Certificate | None:
    """Return the certificate that a method's grounds are; None where it left none that has a form.

    Args:
        problem: what was solved.
        state: where plans start.
        goals: g_1..g_N, shape (N, n) [m].
        proof: of the plan.
    """
    grounds = proof.grounds
    if grounds is None or not proof.checked:
        return None
    if isinstance(grounds, ChoiceGrounds):
        words = ChoiceWords(problem, state, goals, grounds, proof.lower_bound)
        said, posed = words.tree(), (problem, state, goals, proof.lower_bound)
        return None if said is None else Certificate(*posed, said, words.origins)
    if isinstance(grounds, Tangent):
        tops = grounds.tops if grounds.point.shape[1] == 9 else None
        shares = None  # of a length, which is no less than along any way
        if tops is not None and problem.weights.length:
            shares = -length_weights(problem)[1:, None] * grounds.ways
        leaf = Leaf(grounds.point, grounds.bends, grounds.pull, grounds.stiffness, tops, shares)
        return Certificate(problem, state, goals, proof.lower_bound, leaf)
    by_angles = bool(((grounds.splits != LEAF) & ~np.isnan(grounds.angles)).any())
    if _is_beyond_format(problem, by_angles):
        return None
    tree = _tree_of(grounds, proof.cost_unit, problem.floor)
    origins = grounds.origins if by_angles and not problem.max_rate else None
    return Certificate(problem, state, goals, proof.lower_bound, tree, origins)


def _is_beyond_format(problem: Problem, by_angles: bool) -> bool:
    """Return whether splits can be by speeds, ways round, directions that a turn limit leaves."""
    parted = problem.floor.exists and problem.dimension == 2
    wide = problem.max_rate > 0.0 and problem.widest_turn >= HALF
    round_to = problem.max_rate > 0.0 and problem.approach.exists  # the last heading
    return parted and (problem.max_acceleration > 0.0 or (by_angles and wide) or round_to)


def _tree_of(grounds: Grounds, unit: float, floor: Floor) -> Tree:
    """Return the tree that grounds are; parts come after what they are parts of."""
    made: dict[int, Tree] = {}
    for t in reversed(range(len(grounds.splits))):
        if grounds.splits[t] == LEAF:
            pulled = (grounds.pulls[t], float(grounds.stiffness[t])) if len(grounds.pulls) else ()
            made[t] = Leaf(grounds.points[t], unit * grounds.bends[t], *pulled)
            continue
        first, angle = int(grounds.parts[t]), float(grounds.angles[t])
        at = None if math.isnan(angle) else angle
        parts = (made.pop(first + i) for i in range(floor.faces if at is None else 2))
        made[t] = Split(int(grounds.splits[t]) + 1, tuple(parts), at)
    return made[0]
