# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The certificate that a plan's proof is.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.plan import Proof
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.document import Certificate


def kept(problem: Problem, state: State, goals: Array, proof: Proof) -> Certificate | None:
    """Return the certificate of a plan's bound; None where its proof has no tree.

    Args:
        problem: what was solved.
        state: where plans start.
        goals: g_1..g_N, shape (N, n) [m].
        proof: of the plan.
    """
    if proof.tree is None or proof.lower_bound <= 0.0:
        return None
    return Certificate(problem, state, goals, proof.lower_bound, proof.tree)
