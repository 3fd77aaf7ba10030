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
from orbimpc_ros.mpc.solve.request import Enough
from orbimpc_ros.mpc.solve.solver import Solver

Answer = tuple[Plan | None, Status, str]  # a checked plan, the status of the solve, and the reason
Late = Callable[[], bool]
ARRIVAL_WEIGHT = 1e4  # on the miss, when an arrival on the spot has become impossible


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


class Solvers:
    """Solvers of one problem for every number and length of steps, each compiled once."""

    def __init__(
        self, problem: Problem, projection: str = 'thrust_aligned', gap_tolerance: float = 1e-4
    ) -> None:
        self._problem, self.projection, self._tolerance = problem, projection, gap_tolerance
        self._made: dict[tuple[int, float, bool], Solver] = {}

    def of(self, horizon: int, step: float, *, soft: bool = False) -> Solver:
        """Return the solver of so many steps of a length [s], with a ``soft`` arrival if asked.

        Of steps that are cut short, none comes back: only the solvers of the latest are kept.
        """
        key = horizon, step, soft
        if key not in self._made:
            usual = self._problem.step
            if step != usual:
                self._made = {k: s for k, s in self._made.items() if k[1] in (usual, step)}
            problem = replace(self._problem, horizon=horizon, step=step)
            if soft:
                problem = replace(problem, terminal='penalty', arrival_weight=ARRIVAL_WEIGHT)
            self._made[key] = self.new(problem)
        return self._made[key]

    def task(
        self,
        state: State,
        goals: Array,
        knots: Array,
        step: float,
        previous: Plan | None,
        late: Late | None = None,
    ) -> Task:
        """Return the task of steps of a length [s]; the other arguments as of :class:`Task`."""
        solver = self.of(len(knots), step)
        known = solver.problem, state, goals, knots, solver
        return Task(*known, previous, self.projection, late)

    def new(self, problem: Problem, enough: Enough | None = None) -> Solver:
        """Return a new solver of a problem."""
        return Solver(
            problem,
            projection=self.projection,
            gap_tolerance=self._tolerance,
            coasting=True,
            enough=enough,
        )

    def expect_hazards(self) -> None:
        """Compile what the first plan among moving obstacles would have to wait for."""
        for solver in self._made.values():
            solver.expect_hazards()
