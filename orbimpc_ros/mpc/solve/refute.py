# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Certificates of the claims that nothing is feasible, or that nothing catches the goal.

Such a claim is a lower bound on a cost that consists of nothing but the miss distance of a catch;
the general search then looks for a proof of this bound. Before that, a single leaf is tried, which
suffices if the goal is out of reach even at full speed.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.proof.document import (
    Document,
    OutOfTime,
    Posed,
    Unproved,
    refutation,
    refuted_by,
)
from orbimpc_ros.mpc.proof.flight import flown_by
from orbimpc_ros.mpc.proof.stated import Statement
from orbimpc_ros.mpc.proof.tree import EMPTY, ProofTree, one
from orbimpc_ros.mpc.proof.verify import Verifier
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Units

TOLERANCE = 1e-6  # of a search, which stops long before


def refutation_of(sought: Case, count: int = 1, out_of_time: OutOfTime | None = None) -> Document:
    """Return a proof of infeasibility, or that nothing catches the goal at the first steps.

    Args:
        sought: the problem, state, goals and the radius of a catch, if any.
        count: number of steps at whose ends there is no catch; 1 without a catch.
        out_of_time: polled before each node; True gives up.

    Raises:
        Unproved: no proof was found for one of the claims.
    """
    trees = list[ProofTree]()
    for posed in refuted_by(refutation(sought, trees), count):
        tree = None
        if not (out_of_time and out_of_time()):
            tried = _tried(sought, posed, out_of_time)
            tree = next((each for each in tried if _proves(posed, each)), None)
        if tree is None:
            what = 'all trajectories'
            if posed.problem.weights.terminal:
                what = f'a catch at step {posed.problem.horizon}'
            late = out_of_time and out_of_time()
            missing = 'was found in time' if late else f'of {what} was found'
            raise Unproved(f'no certificate: no refutation {missing}')
        trees.append(tree)
    return refutation(sought, trees)


def _proves(posed: Posed, tree: ProofTree) -> bool:
    verifier = Verifier(posed.problem)
    return posed.is_exceeded(verifier.bound(posed.state, posed.goals, tree, None, posed.limits))


def _leaf(posed: Posed) -> ProofTree:
    """Return a tree of one leaf, which is a proof if full speed does not reach the goal."""
    stated = Statement(posed.problem).of(posed.state, posed.goals, posed.limits)
    count, n, start = posed.problem.horizon, stated.n, stated.start[:, : stated.n]
    point = np.zeros((count, stated.start.shape[1]))
    off = flown_by(stated.motion, start, point[:, :n])[0, -1] - stated.goals[-1, :n]
    away = off / max(float(np.linalg.norm(off)), 1e-300)
    reach = flown_by(stated.motion, np.zeros((6, count)), np.eye(count))[0, -1]
    fastest = np.minimum(1.0, posed.limits.entry + posed.limits.change * np.arange(1, count + 1))
    point[:, :n] = -np.outer(np.sign(reach) * fastest, away)
    if posed.problem.weights.terminal:
        return one(point, np.zeros(count))
    pull = np.zeros((stated.arrives, n))
    pull[:1] = away
    leaf = one(0.0 * point, np.zeros(count), pull=pull)
    return leaf._replace(nodes=np.array([[EMPTY, 0, 0, 0, 0]]))


def _tried(sought: Case, posed: Posed, out_of_time: OutOfTime | None) -> Iterator[ProofTree]:
    """Yield trees that may be proofs: a single leaf, and that of the general search."""
    yield _leaf(posed)
    from orbimpc_ros.mpc.solve.branch_and_bound import BranchAndBound  # slow to import

    names = 'horizon', 'terminal', 'weights', 'arrival_weight'
    problem = replace(sought.problem, **{name: getattr(posed.problem, name) for name in names})
    units, coasting = Units.of(problem), posed.state.coasted is not None
    among = bool(sought.state.hazards)
    search = BranchAndBound(units.problem, TOLERANCE, coasting=coasting, among=among)
    start, goals = units.state(sought.state), posed.goals / units.length
    request = Request(start, goals, None, out_of_time, patient=True)
    tree = search.begun(request).exceeding(float(posed.cost) / units.cost)
    if tree is not None:
        yield units.posed(tree)
