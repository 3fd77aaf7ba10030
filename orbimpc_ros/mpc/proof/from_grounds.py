# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The trees of what methods leave of their bounds as splits of headings and tangents.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.model.cost import length_weights
from orbimpc_ros.mpc.model.dynamics import translation_rollout
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.approach import LEEWAY
from orbimpc_ros.mpc.proof.convexity import lack
from orbimpc_ros.mpc.proof.grounds import Grounds, Left, Tangent
from orbimpc_ros.mpc.proof.stated import UNTURNED
from orbimpc_ros.mpc.proof.tree import ARCS, CUT, LEAF, NOTHING, SPEED, ProofTree, one

SPARE = 1e-13  # of the largest curvature, for each step, that convexity is verified with
TURN = 2.0 * math.pi


def tree_from(problem: Problem, state: State, goals: Array, left: Left) -> ProofTree | None:
    """Return the tree that grounds are, in natural units; None where they have no such form.

    Args:
        problem: in natural units.
        state: where plans start.
        goals: g_1..g_N, shape (N, n).
        left: by a method.
    """
    if isinstance(left, Tangent):
        return _one(problem, state, goals, left)
    return _splits(problem, state, goals, left) if isinstance(left, Grounds) else None


def _one(problem: Problem, state: State, goals: Array, left: Tangent) -> ProofTree:
    known = {}
    if problem.terminal == 'constraint':
        pulls, stiffness = left.pull[None], np.array([left.stiffness])
        known['pull'] = _pulls(problem, state, goals, left.point[None], pulls, stiffness)[0]
    if left.point.shape[1] == 9 and problem.weights.length:
        known['share'] = -length_weights(problem)[1:, None] * left.ways
    return one(left.point, _shor(problem, left.bends[None])[0], **known)


def _shor(problem: Problem, bends: Array) -> Array:
    """Return the curvature that steps keep, shape (T, N): a little less than was added to it.

    Less, too, by what the cost lacks to be convex with it, where all that needs no arrival.
    """
    kept = -bends
    for t in np.flatnonzero((bends < 0.0).any(axis=-1)):
        if problem.terminal != 'constraint':
            kept[t] -= lack(_hessian(problem), bends[t], 1.0)
        kept[t] -= SPARE * problem.horizon * max(1.0, float(np.abs(bends[t]).max()))
    return kept


@lru_cache(maxsize=8)
def _hessian(problem: Problem) -> Array:
    return Condensed(problem).hessian


def _pulls(
    problem: Problem, state: State, goals: Array, points: Array, pulls: Array, stiffness: Array
) -> Array:
    """Return multipliers of an arrival, with what its stiffness pulls, shape (T, m, n)."""
    n = problem.dimension
    found = pulls.reshape(len(points), -1, n).copy()
    for t in np.flatnonzero(stiffness):
        z = np.vstack([state.rotation[:, 0], points[t, :, :n]])
        positions, velocities = translation_rollout(problem, state, z)
        found[t, 0] += stiffness[t] * (positions[-1] - goals[-1])
        if found.shape[1] > 1:
            found[t, 1] += stiffness[t] * velocities[-1]
    return np.ascontiguousarray(found)


def _splits(problem: Problem, state: State, goals: Array, left: Grounds) -> ProofTree | None:
    nodes, count = len(left.splits), problem.horizon
    leaf = left.splits == LEAF_OF_GROUNDS
    faced = ~leaf & np.isnan(left.angles)
    kinds = np.where(faced, ARCS, np.where(left.splits >= count, SPEED, CUT))
    made = np.zeros((nodes, 5), np.int64)
    made[:, 0], made[:, 1] = np.where(leaf, LEAF, kinds), np.where(leaf, 0, left.splits)
    made[:, 2] = np.where(leaf, 0, left.parts)
    made[:, 3] = np.where(leaf, 0, np.where(faced, problem.floor.faces, 2))
    made[:, 4] = np.where(leaf, np.arange(nodes), -1)
    corner = -math.pi / problem.floor.faces if faced.any() else 0.0
    at = np.where(faced, corner, np.where(leaf, 0.0, left.angles))
    limited = problem.turns_are_angles and problem.widest_turn < UNTURNED
    cut = bool((~leaf & ~faced & (left.splits < count)).any())
    if problem.dimension == 3 and nodes > 1:
        return None
    if limited and problem.approach.exists:
        made, at = _ways_round(problem, state, left, made, at)
    pull: Array = NOTHING
    if problem.terminal == 'constraint':
        if not len(left.pulls):
            pull = np.zeros((nodes, 1 + problem.inertial, problem.dimension))
        else:
            known = problem, state, goals, left.points
            pull = _pulls(*known, left.pulls, left.stiffness)
    ends = np.zeros(nodes, np.int64)
    return ProofTree(
        made, np.ascontiguousarray(at),
        np.ascontiguousarray(left.points), _shor(problem, left.bends),
        ends, ends[:0], np.zeros(0),
        pull, NOTHING, NOTHING, NOTHING, np.zeros((0, 0)),
        left.origins.copy() if cut and not limited else np.zeros(0),
    )  # fmt: skip


LEAF_OF_GROUNDS = -1


def _ways_round(
    problem: Problem, state: State, left: Grounds, nodes: np.ndarray, at: Array
) -> tuple[np.ndarray, Array]:
    """Return a tree that has a tree for each way round to the last heading as a part.

    Its directions are split half-way between one way round and the next.
    """
    ahead, axis = state.attitude[:, 0], problem.approach.axis(state)
    heading, last = math.atan2(ahead[1], ahead[0]), math.atan2(axis[1], axis[0])
    reach = problem.horizon * problem.widest_turn + problem.approach.cone + LEEWAY
    first = math.ceil((heading - reach - last) / TURN)
    ways = math.floor((heading + reach - last) / TURN) - first + 1
    if ways == 1:
        return nodes, at
    size = 2 * ways - 1  # of a chain of splits, with copies of the roots of trees
    chain, cuts = np.zeros((size, 5), np.int64), np.zeros(size)
    moved = nodes.copy()
    moved[:, 2] += size
    for way in range(ways - 1):
        t = 2 * way
        chain[t] = CUT, problem.horizon - 1, t + 1, 2, -1
        cuts[t] = last + TURN * (first + way) + math.pi
        chain[t + 1], cuts[t + 1] = moved[way], at[way]
    chain[size - 1], cuts[size - 1] = moved[ways - 1], at[ways - 1]
    return np.concatenate([chain, moved]), np.concatenate([cuts, at])
