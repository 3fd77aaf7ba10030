# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Problems with plans, what their methods say of bounds, and what is counted of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import certified
import numpy as np

from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.proof.recount import Recount
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Solver


def solved(kind: str, seed: int, **changes: Any) -> tuple[Case, Plan]:
    """Return the first of a seed's problems that has a plan, with it."""
    rng = np.random.default_rng([seed, *kind.encode()])
    while True:
        case = certified.case(kind, rng, longest=6)
        case = case._replace(problem=replace(case.problem, **changes))
        try:
            return case, Solver(case.problem).solve(case.state, case.goals)
        except Infeasible:  # a body where the state already leads
            continue


def said(case: Case) -> float:
    """Return the bound that the method gives of itself."""
    solver = Solver(case.problem)
    units, method = solver._units, solver._method_for(case.state)
    found = method.solve(Request(units.state(case.state), units.lengths(case.goals)))
    return units.cost * found.lower_bound


def counted(case: Case, plan: Plan, **changes: Any) -> float:
    """Return what the grounds of a plan's bound prove, with some of them changed."""
    grounds = plan.proof.grounds._replace(**changes)
    recount = Recount(case.problem)
    return recount.bound(case.state, case.goals, grounds, plan.proof.cost_unit)


def changed(array: np.ndarray, place: Any, value: Any) -> np.ndarray:
    """Return an array with one of its entries changed."""
    array = array.copy()
    array[place] = value
    return array
