# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The reserve: what plans keep away from what moves beyond what is demanded, as far as they can.

What grazes a body is inside of it after the next gust. So each body counts as larger later in a
plan, when less is known of where both will be. A plan that keeps to that is, a step later, clear
with room to spare; and what is demanded is never more than what a plan is found for.

Mathematics: docs/mathematics.md, 7.11.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.clearance import clearances
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem, State

SHARES = (1 / 3, 2 / 3, 1.0)  # of a reserve, that a plan may be found to keep


def keeping(state: State, reserves: Array) -> State:
    """Return a state whose hazards have reserves, shape (J,) [m]."""
    pairs = zip(state.hazards, reserves.tolist(), strict=True)
    return replace(state, hazards=tuple(replace(each, reserve=room) for each, room in pairs))


def kept(problem: Problem, state: State, plan: Plan | None, reserve: float) -> Array:
    """Return how much of a reserve [m] a plan from a state keeps from each hazard, shape (J,) [m].

    Without a plan, nothing.
    """
    found = np.zeros(len(state.hazards))
    if plan is None:
        return found
    for share in SHARES:
        asked = np.full(len(found), share * reserve)
        apart = clearances(problem, keeping(state, asked), plan)
        clear = np.array([apart[f'hazard {j}'] >= 0.0 for j in range(len(found))])
        found[clear] = share * reserve
    return found
