# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The optimisation behind a decision: problem, state and goals, with a solver and a warm start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.errors import Infeasible, SolverFailure
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.plan import UNPROVED, Plan, assemble, shifted
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.cones import told

if TYPE_CHECKING:  # slow to import, and the simulator, which reads these parameters, needs none
    from orbimpc_ros.mpc.solve.solver import Solver

Answer = tuple[Plan | None, Status, str]  # a checked plan, the status of the solve, and the reason
Late = Callable[[], bool]


@dataclass(frozen=True)
class Deadline:
    """The deadline of a decision; calling it returns whether it has passed."""

    clock: Callable[[], float]  # [s]
    end: float  # on that clock; infinite without a deadline [s]

    def __call__(self) -> bool:
        """Return True if the deadline has passed."""
        return self.clock() > self.end


@dataclass(frozen=True)
class Task:
    """One optimisation."""

    problem: Problem
    state: State  # initial state of plans
    goals: Array  # g_1..g_N, shape (N, n) [m]
    knots: Array  # ends of the steps, in steps of the previous plan from its start, (N,)
    solver: Solver | None = None  # for the problem
    previous: Plan | None = None  # the previous plan; None without one to continue
    projection: str = 'thrust_aligned'  # projection of plans to rotations
    late: Late | None = None  # whether the deadline has passed; None without one

    @cached_property
    def known(self) -> tuple[Problem, State, Array]:
        """Return the problem, state and goals against which plans are checked."""
        return self.problem, self.state, self.goals

    @cached_property
    def onward(self) -> Array | None:
        """Return the remainder of the previous plan as coordinates, shape (N, d), if it fits."""
        if self.previous is None:
            return None
        return shifted(self.problem, self.state, self.previous, self.knots)

    @cached_property
    def rest(self) -> Plan | None:
        """Return the remainder of the previous plan as a plan from this state, if it fits."""
        if self.onward is None:
            return None
        return assemble(*self.known, self.onward, projection=self.projection, proof=UNPROVED)

    def within(self, problem: Problem, goals: Array, solver: Solver | None = None) -> Task:
        """Return the task for a problem with another number or length of steps, and its goals."""
        count, step, knots = len(goals), problem.step, self.knots[: len(goals)]
        if step != self.problem.step:
            each = self.knots[1] - self.knots[0]
            stretched = step / self.problem.step * np.arange(1.0, count + 1.0)
            knots = self.knots[0] - each + each * stretched
        goals = sealed(goals.copy())
        return replace(self, problem=problem, goals=goals, knots=knots, solver=solver)

    def solved(self, *, guessing: bool = False) -> Answer:
        """Return a checked plan, or None, with status and reason.

        The search is warm-started from the remainder of the previous plan if that helps the solver,
        or if ``guessing``.
        """
        assert self.solver is not None
        useful = guessing or self.solver.takes_guess or bool(self.state.hazards)
        guess = self.onward if useful else None
        try:
            plan = self.solver.solve(self.state, self.goals, guess, self.late)
        except Infeasible as error:
            return None, Status.INFEASIBLE, str(error)
        except SolverFailure as error:
            return None, Status.FAILED, str(error)
        outside = told(self.problem, self.goals, plan) if self.problem.has_cones else ''
        if plan.status == Status.OPTIMAL:
            return plan, Status.OPTIMAL, outside
        unproved = '' if plan.is_closed else f'not proved optimal: gap {plan.gap:.2g}'
        reasons = unproved, plan.proof.reason, outside
        return plan, plan.status, '; '.join(filter(None, reasons))
