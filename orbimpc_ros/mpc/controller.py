"""The receding-horizon controller: odometry and goals in, a checked command out, each tick."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.command import Command, command_of, stop
from orbimpc_ros.mpc.errors import Infeasible, SolverFailure
from orbimpc_ros.mpc.odometry import Odometry, state_of
from orbimpc_ros.mpc.plan import FAILED, FEASIBLE, INFEASIBLE, OPTIMAL, Plan, shifted, violations
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solver import Solver

FALLBACK_TICKS = 2  # how long the shifted previous plan may stand in for a new one


@dataclass(frozen=True)
class Tick:
    """What one tick came to.

    Attributes:
        status: ``optimal``, ``feasible``, ``infeasible`` or ``failed``: of the solve.
        reason: why, where it is not ``optimal``; else empty.
        state: the state that the plan starts from.
        plan: the checked plan behind the command; None if the command is the safe one.
        command: what to do next.
        fallback: empty, ``shifted plan`` or ``safe command``.
    """

    status: str
    reason: str
    state: State
    plan: Plan | None
    command: Command
    fallback: str = ''


class Controller:
    """Re-plans at every tick and never commands a plan that was not checked.

    Args:
        problem: what to solve; compiled here, so that a tick only updates data.
        projection: ``nearest`` or ``thrust_aligned``.
        shrinking: whether the horizon shrinks by a step at every tick (a fixed arrival time)
            instead of receding.
        gap_tolerance: relative gap within which a plan counts as proved optimal.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        projection: str = 'thrust_aligned',
        shrinking: bool = False,
        gap_tolerance: float = 1e-4,
    ) -> None:
        self.problem = problem
        self._projection, self._shrinking, self._tolerance = projection, shrinking, gap_tolerance
        self._solvers: dict[int, Solver] = {}
        self._solver(problem.horizon)
        self.reset()

    def reset(self) -> None:
        """Forget the previous plan; a shrinking horizon starts anew."""
        self._previous: Plan | None = None
        self._thrust_fraction = 0.0
        self._ticks = 0
        self._fallbacks = 0

    @property
    def remaining(self) -> int:
        """Return the steps left to plan: N, or what a shrinking horizon has left of it."""
        if not self._shrinking:
            return self.problem.horizon
        return max(0, self.problem.horizon - self._ticks)

    def tick(
        self, odometry: Odometry, goals: Array, out_of_time: Callable[[], bool] | None = None
    ) -> Tick:
        """Plan from a measurement towards goals g_1..g_N, shape (``remaining``, n) [m].

        Args:
            odometry: the measurement.
            goals: targets at the ends of the coming steps.
            out_of_time: polled by long searches; True makes them return their best plan.
        """
        state = state_of(self.problem, odometry, self._thrust_fraction)
        if self.remaining == 0:
            return self._finish(self._safe(state, FEASIBLE, 'the horizon has run out'))
        solver = self._solver(self.remaining)
        guess = self._shifted(solver.problem, state, goals)
        try:
            plan = solver.solve(state, goals, guess=guess, out_of_time=out_of_time)
        except Infeasible as error:
            status, reason = INFEASIBLE, str(error)
        except SolverFailure as error:
            status, reason = FAILED, str(error)
        else:
            found = violations(solver.problem, state, goals, plan)
            if not found:
                return self._finish(self._accept(solver.problem, state, plan))
            status, reason = FAILED, '; '.join(found)
        return self._finish(self._fall_back(solver.problem, state, goals, guess, status, reason))

    def _accept(self, problem: Problem, state: State, plan: Plan) -> Tick:
        self._fallbacks = 0
        reason = '' if plan.status == OPTIMAL else f'not proved optimal: gap {plan.gap:.2g}'
        return Tick(plan.status, reason, state, plan, command_of(problem, state, plan))

    def _fall_back(
        self,
        problem: Problem,
        state: State,
        goals: Array,
        guess: Plan | None,
        status: str,
        reason: str,
    ) -> Tick:
        """Return a tick on the shifted previous plan if that still holds, else a safe one."""
        self._fallbacks += 1
        if (
            guess is not None
            and self._fallbacks <= FALLBACK_TICKS
            and not violations(problem, state, goals, guess)
        ):
            command = command_of(problem, state, guess)
            return Tick(status, reason, state, guess, command, 'shifted plan')
        return self._safe(state, status, reason)

    @staticmethod
    def _safe(state: State, status: str, reason: str) -> Tick:
        return Tick(status, reason, state, None, stop(state.attitude), 'safe command')

    def _finish(self, tick: Tick) -> Tick:
        self._previous = tick.plan
        self._thrust_fraction = tick.command.speed_fraction
        self._ticks += 1
        return tick

    def _shifted(self, problem: Problem, state: State, goals: Array) -> Plan | None:
        if self._previous is None:
            return None
        return shifted(problem, state, goals, self._previous, projection=self._projection)

    def _solver(self, horizon: int) -> Solver:
        if horizon not in self._solvers:
            self._solvers[horizon] = Solver(
                replace(self.problem, horizon=horizon),
                projection=self._projection,
                gap_tolerance=self._tolerance,
                coasting=True,
            )
        return self._solvers[horizon]
