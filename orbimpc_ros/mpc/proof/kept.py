# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""From what a method left of its proof to the certificate that this is.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.cost import length_weights
from orbimpc_ros.mpc.plan import Proof
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.certificate import Certificate, Leaf
from orbimpc_ros.mpc.proof.choice_words import ChoiceWords
from orbimpc_ros.mpc.proof.grounds import ChoiceGrounds, Tangent
from orbimpc_ros.mpc.proof.split_words import split_words


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
    told = split_words(problem, state, grounds, proof.lower_bound, proof.cost_unit)
    return None if told is None else Certificate(problem, state, goals, proof.lower_bound, *told)
