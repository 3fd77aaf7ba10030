# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A contest: a problem, its instances, who takes part and what is required.

Everybody gets the same problem, the same instances, the same relative gap and one thread.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from benchmarks.bench.contenders.contender import Contender
from benchmarks.bench.duel import OURS
from benchmarks.bench.instances import Instance
from orbimpc_ros.mpc.problem import Problem

GUROBI, SCIP, IPOPT = 'Gurobi', 'SCIP', 'IPOPT (local)'
GUROBI_CUT = 'Gurobi + our cut'
CVXPY, QOCO = 'CVXPY + Clarabel', 'CVXPY + QOCO'
PACKAGES = {
    GUROBI: 'gurobipy',
    GUROBI_CUT: 'gurobipy',
    SCIP: 'pyscipopt',
    IPOPT: 'casadi',
    QOCO: 'qoco',
}
CAP, QUICK_CAP = 60.0, 5.0  # [s] for one solve
DEFAULTS = 'dubins'  # where SCIP's defaults prove more in a minute than its fast settings
LOCAL = 1e-6  # a local solver's own tolerance, at most: looser ones leave limits violated
SEVERAL = 5  # time limits that a rival may use up, where it meets few of the instances


@dataclass(frozen=True)
class Contest:
    """A problem with its instances and contenders.

    Attributes:
        key: short name, for ``--only``.
        title: what it is.
        problem: what to solve.
        instances: makes that many.
        counts: how many to measure, quickly or not.
        gap: relative gap that everybody has to prove.
        rivals: names of the contenders beside ours.
        required: limits by contender.
        closed_loop: whether instances follow each other.
        every: rivals meet the first of so many instances, where they would take too long.
    """

    key: str
    title: str
    problem: Problem
    instances: Callable[[Problem, int], list[Instance]]
    counts: tuple[int, int]
    gap: float = 1e-4
    rivals: tuple[str, ...] = ()
    required: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    closed_loop: bool = False
    every: int = 1

    def budget(self, cap: float) -> float:
        """Return how long a contender takes part [s], given the time limit of a solve."""
        return cap if self.every == 1 else SEVERAL * cap

    def contender(self, name: str, cap: float) -> Contender:
        """Return a contender set up for the problem.

        Raises:
            ImportError: it is not installed.
        """
        follows = self.closed_loop and (name == OURS or self.every == 1)
        mixed = {'gap': self.gap, 'cap': cap, 'closed_loop': follows}
        # Module, class and what its constructor takes.
        known: dict[str, tuple[str, str, Mapping[str, Any]]] = {
            OURS: ('ours', 'Ours', mixed),
            GUROBI: ('gurobi', 'Gurobi', mixed),
            GUROBI_CUT: ('gurobi', 'Gurobi', {**mixed, 'cut': True}),
            SCIP: ('scip', 'Scip', {**mixed, 'fast': self.key != DEFAULTS}),
            IPOPT: ('ipopt', 'Ipopt', {'tolerance': min(self.gap, LOCAL)}),
            CVXPY: ('resolve', 'Resolve', {}),
            QOCO: ('resolve', 'Resolve', {'solver': 'QOCO'}),
        }
        module, kind, options = known[name]
        found = import_module(f'benchmarks.bench.contenders.{module}')
        return getattr(found, kind)(self.problem, **options)
