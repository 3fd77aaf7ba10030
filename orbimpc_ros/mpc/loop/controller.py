"""The receding-horizon controller: odometry and goals in, a checked command out, each tick."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array, ByContent, sealed
from orbimpc_ros.mpc.check import command_violations, violations
from orbimpc_ros.mpc.command import Command, command_of
from orbimpc_ros.mpc.errors import Infeasible, SolverFailure
from orbimpc_ros.mpc.loop.odometry import Odometry, odd_speed, state_of
from orbimpc_ros.mpc.loop.safety import safe_command
from orbimpc_ros.mpc.outcome import Fallback, Status
from orbimpc_ros.mpc.plan import Plan, shifted
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.reach import pulled_in
from orbimpc_ros.mpc.solve.solver import Solver

FALLBACK_TICKS = 2  # how long the shifted previous plan may stand in for a new one
ARRIVAL_WEIGHT = 1e4  # on the miss, when an arrival on the spot has become impossible


@dataclass(frozen=True, eq=False)
class Tick(ByContent):
    """What one tick came to.

    Attributes:
        status: of the solve.
        reason: why, where it is not ``optimal``, and what was done about a goal too far away or a
            measured speed that the model does not know; else empty.
        state: the state that the plan starts from.
        plan: the checked plan behind the command; None if the command is the safe one.
        command: what to do next.
        fallback: what the command follows, if not a new plan.
        problem: what the plan solves; None without a plan, as is the next.
        goals: g_1..g_N that it was made for, shape (N, n) [m].
    """

    status: Status
    reason: str
    state: State
    plan: Plan | None
    command: Command
    fallback: Fallback = Fallback.NONE
    problem: Problem | None = None
    goals: Array | None = None


@dataclass(frozen=True)
class _Asked:
    """What a tick has to find a plan for."""

    solver: Solver
    state: State
    goals: Array
    out_of_time: Callable[[], bool] | None = None
    guess: Plan | None = None

    @property
    def problem(self) -> Problem:
        """Return what the solver solves."""
        return self.solver.problem


class Controller:
    """Re-plans at every tick and never commands a plan that was not checked.

    Without a plan it falls back, in this order, on

    - the shifted previous plan, if it still holds from the new state, for two ticks at most and
      never past its horizon;
    - a *soft arrival*, where a terminal constraint that could be met before no longer can be,
      because of disturbances: the plan that comes nearest, if that is within a step's reach;
    - the safe command.

    Args:
        problem: what to solve; compiled here, so that a tick only updates data.
        projection: ``nearest`` or ``thrust_aligned``.
        shrinking: whether the horizon shrinks by a step at every tick (a fixed arrival time)
            instead of receding.
        gap_tolerance: relative gap within which a plan counts as proved optimal.
        safe: kind of safe command, see :func:`orbimpc_ros.mpc.loop.safety.safe_command`.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        projection: str = 'thrust_aligned',
        shrinking: bool = False,
        gap_tolerance: float = 1e-4,
        safe: str = 'auto',
    ) -> None:
        self.problem, self._safe_kind = problem, safe
        self._projection, self._shrinking, self._tolerance = projection, shrinking, gap_tolerance
        self._solvers: dict[tuple[int, bool], Solver] = {}
        self._solver(problem.horizon)
        self.reset()

    def reset(self) -> None:
        """Forget the previous plan; a shrinking horizon starts anew."""
        self._previous: Plan | None = None
        self._goals: Array | None = None  # of the previous plan
        self._thrust_fraction = 0.0
        self._ticks = self._fallbacks = self._planned = 0
        self._arriving = False

    def continue_from(self, other: Controller) -> None:
        """Take over what another controller remembers, for instance one with other weights."""
        self._previous, self._goals = other._previous, other._goals
        self._thrust_fraction = other._thrust_fraction
        self._ticks, self._fallbacks = other._ticks, other._fallbacks
        self._planned, self._arriving = other._planned, other._arriving

    def commanded(self, speed_fraction: float) -> None:
        """Learn that something else than the last tick's command was sent: its speed fraction."""
        self._thrust_fraction = speed_fraction

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
            return self._finish(self._safe(state, Status.FEASIBLE, 'the horizon has run out'))
        goals, told = pulled_in(self.problem, state, sealed(np.array(goals, dtype=float)))
        asked = self._asked(state, goals, out_of_time)
        self._goals = goals
        plan, status, reason = _solved(asked)
        reason = '; '.join(filter(None, (reason, told, odd_speed(self.problem, odometry))))
        if plan is None:
            return self._finish(self._fall_back(asked, status, reason))
        self._fallbacks, self._planned = 0, plan.horizon
        self._arriving = True
        return self._finish(self._following(asked, plan, status, reason))

    def _asked(
        self, state: State, goals: Array, out_of_time: Callable[[], bool] | None = None
    ) -> _Asked:
        asked = _Asked(self._solver(self.remaining), state, goals, out_of_time)
        if asked.solver.takes_guess:
            return replace(asked, guess=self._shifted(asked))
        return asked

    def hold(self, odometry: Odometry, reason: str) -> Tick:
        """Go on without a goal: by the previous plan as long as the fallback allows, then safely.

        Args:
            odometry: the measurement.
            reason: why there is no goal.
        """
        state = state_of(self.problem, odometry, self._thrust_fraction)
        if self._goals is None or self.remaining == 0:
            return self._finish(self._safe(state, Status.FAILED, reason))
        moved = np.concatenate([self._goals[1:], self._goals[-1:]])[: self.remaining]
        self._goals = sealed(moved)
        asked = self._asked(state, self._goals)
        return self._finish(self._fall_back(asked, Status.FAILED, reason))

    def _fall_back(self, asked: _Asked, status: Status, reason: str) -> Tick:
        self._fallbacks += 1
        # The n-th tick after a plan was found is its step n: the last is N - 1.
        if self._fallbacks < min(FALLBACK_TICKS + 1, self._planned):
            guess = asked.guess or self._shifted(asked)
            if guess and not violations(asked.problem, asked.state, asked.goals, guess):
                return self._following(asked, guess, status, reason, Fallback.SHIFTED_PLAN)
        if (
            self._arriving
            and asked.problem.terminal == 'constraint'
            and status == Status.INFEASIBLE
        ):
            return self._arrive_softly(asked, reason)
        return self._safe(asked.state, status, reason)

    def _arrive_softly(self, asked: _Asked, reason: str) -> Tick:
        eased = replace(asked, solver=self._solver(self.remaining, soft=True), guess=None)
        plan, _, _ = _solved(eased)
        if plan is None:
            return self._safe(asked.state, Status.INFEASIBLE, reason)
        miss = float(np.linalg.norm(plan.positions[-1] - asked.goals[-1]))
        problem = asked.problem
        if miss > problem.length_unit:
            told = f'{reason}; the nearest plan misses by {miss:.3g} m'
            return self._safe(asked.state, Status.INFEASIBLE, told)
        told = f'{reason}; the plan misses by {miss:.3g} m'
        return self._following(eased, plan, Status.INFEASIBLE, told, Fallback.SOFT_ARRIVAL)

    def _following(
        self,
        asked: _Asked,
        plan: Plan,
        status: Status,
        reason: str,
        fallback: Fallback = Fallback.NONE,
    ) -> Tick:
        """Return the tick that follows a checked plan, if the command made of it is the plan's."""
        command = command_of(asked.problem, asked.state, plan)
        wrong = command_violations(asked.problem, plan, command)
        if wrong:
            return self._safe(asked.state, Status.FAILED, '; '.join(wrong))
        known = asked.problem, asked.goals
        return Tick(status, reason, asked.state, plan, command, fallback, *known)

    def _safe(self, state: State, status: Status, reason: str) -> Tick:
        last = self._thrust_fraction
        command = safe_command(self._safe_kind, self.problem, state.attitude, last)
        return Tick(status, reason, state, None, command, Fallback.SAFE_COMMAND)

    def _finish(self, tick: Tick) -> Tick:
        self._previous = tick.plan
        self._thrust_fraction = tick.command.speed_fraction
        self._ticks += 1
        return tick

    def _shifted(self, asked: _Asked) -> Plan | None:
        if self._previous is None:
            return None
        return shifted(
            asked.problem, asked.state, asked.goals, self._previous, projection=self._projection
        )

    def _solver(self, horizon: int, *, soft: bool = False) -> Solver:
        if (horizon, soft) not in self._solvers:
            problem = replace(self.problem, horizon=horizon)
            if soft:
                problem = replace(problem, terminal='penalty', arrival_weight=ARRIVAL_WEIGHT)
            self._solvers[horizon, soft] = Solver(
                problem,
                projection=self._projection,
                gap_tolerance=self._tolerance,
                coasting=True,
            )
        return self._solvers[horizon, soft]


def _solved(asked: _Asked) -> tuple[Plan | None, Status, str]:
    """Return a checked plan, or None, with status and reason."""
    try:
        plan = asked.solver.solve(asked.state, asked.goals, asked.guess, asked.out_of_time)
    except Infeasible as error:
        return None, Status.INFEASIBLE, str(error)
    except SolverFailure as error:
        return None, Status.FAILED, str(error)
    if plan.status == Status.OPTIMAL:
        return plan, Status.OPTIMAL, ''
    unproved = f'not proved optimal: gap {plan.gap:.2g}'
    return plan, plan.status, '; '.join(filter(None, (unproved, plan.proof.reason)))
