# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The optimisation behind a decision: problem, state and goals, with a solver and a guess."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible, SolverFailure
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.plan import UNPROVED, Plan, assemble, shifted
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.cones import told
from orbimpc_ros.mpc.solve.solver import Solver

Answer = tuple[Plan | None, Status, str]  # a checked plan, the status of the solve, and the reason
Late = Callable[[], bool]


@dataclass(frozen=True)
class Deadline:
    """The end of the time that there is for a decision; called, whether it is over."""

    clock: Callable[[], float]  # [s]
    end: float  # by that clock; infinite for none [s]

    def __call__(self) -> bool:
        """Return whether time is up."""
        return self.clock() > self.end


@dataclass(frozen=True)
class Task:
    """One optimisation."""

    problem: Problem
    state: State  # that plans start from
    goals: Array  # g_1..g_N, shape (N, n) [m]
    knots: Array  # ends of its steps, counted in steps of the plan before from its start, (N,)
    solver: Solver | None = None  # of the problem
    previous: Plan | None = None  # the plan before; None if there is none to go on from
    projection: str = 'thrust_aligned'  # how its rest becomes rotations
    late: Late | None = None  # whether time is up; None without a deadline

    @cached_property
    def known(self) -> tuple[Problem, State, Array]:
        """Return what plans are checked against: problem, state and goals."""
        return self.problem, self.state, self.goals

    @cached_property
    def onward(self) -> Array | None:
        """Return the rest of the previous plan, shape (N, d), if it fits."""
        if self.previous is None:
            return None
        return shifted(self.problem, self.state, self.previous, self.knots)

    @cached_property
    def rest(self) -> Plan | None:
        """Return the rest of the previous plan as one from this state, if it fits."""
        if self.onward is None:
            return None
        return assemble(*self.known, self.onward, projection=self.projection, proof=UNPROVED)

    def within(self, problem: Problem, goals: Array, solver: Solver | None = None) -> Task:
        """Return the task of a problem with another number or length of steps, and their goals."""
        count, step, knots = len(goals), problem.step, self.knots[: len(goals)]
        if step != self.problem.step:
            each = self.knots[1] - self.knots[0]
            stretched = step / self.problem.step * np.arange(1.0, count + 1.0)
            knots = self.knots[0] - each + each * stretched
        goals = goals.copy()
        goals.setflags(write=False)
        return replace(self, problem=problem, goals=goals, knots=knots, solver=solver)

    def solved(self, *, guessing: bool = False) -> Answer:
        """Return a checked plan, or None, with status and reason.

        The search starts from the rest of the previous plan where that helps the solver, or where
        ``guessing`` is asked for.
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
