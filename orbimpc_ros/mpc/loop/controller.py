"""The receding-horizon controller: odometry and goals in, a checked command out, each tick."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array, ByContent, sealed
from orbimpc_ros.mpc.check import command_violations, violations
from orbimpc_ros.mpc.command import Command, command_of, flaw
from orbimpc_ros.mpc.errors import Infeasible, SolverFailure
from orbimpc_ros.mpc.loop.delay import CommandHistory
from orbimpc_ros.mpc.loop.odometry import Odometry, odd_speed, state_of
from orbimpc_ros.mpc.loop.safety import may_stop, safe_command
from orbimpc_ros.mpc.outcome import Cause, Fallback, Reason, Status
from orbimpc_ros.mpc.plan import Plan, shifted
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.reach import pulled_in
from orbimpc_ros.mpc.solve.solver import Solver

FALLBACK_TICKS = 2  # how long the shifted previous plan may stand in for a new one
ARRIVAL_WEIGHT = 1e4  # on the miss, when an arrival on the spot has become impossible


@dataclass(frozen=True, eq=False)
class Tick(ByContent):
    """The controller's decision on one tick.

    Attributes:
        status: of the solve.
        reason: why, where it is not ``optimal``, and what was done about a goal too far away or a
            measured speed that the model does not know; else empty.
        state: the state that the plan starts from; None if nothing was to be planned.
        plan: the checked plan behind the command; None if the command is the safe one.
        command: what to do next.
        fallback: what the command follows, if not a new plan.
        problem: what the plan solves; None without a plan, as is the next.
        goals: g_1..g_N that it was made for, shape (N, n) [m].
        cause: what kept the tick from being planned on fresh inputs, if anything did.
    """

    status: Status
    reason: str
    state: State | None
    plan: Plan | None
    command: Command
    fallback: Fallback = Fallback.NONE
    problem: Problem | None = None
    goals: Array | None = None
    cause: Cause = Cause.NONE


@dataclass(frozen=True)
class _Task:
    """The question that a tick puts to a solver."""

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
    """Re-plans at every tick; every command is checked, whatever it was made from.

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
        disturbance: a wind or an acceleration, shape (n,); by default there is none.
        velocity_source: what odometry measures: velocity over ``ground`` or through the ``air``.

    Attributes:
        history: the commands of late; a tick's command counts as sent unless another is added.
        disturbance: what the next tick plans with; who estimates more than is known may set it.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        projection: str = 'thrust_aligned',
        shrinking: bool = False,
        gap_tolerance: float = 1e-4,
        safe: str = 'auto',
        disturbance: Array | None = None,
        velocity_source: str = 'ground',
    ) -> None:
        self.problem, self._safe_kind = problem, safe
        self.disturbance, self._velocity_source = disturbance, velocity_source
        self._projection, self._shrinking, self._tolerance = projection, shrinking, gap_tolerance
        self._solvers: dict[tuple[int, bool], Solver] = {}
        self._solver(problem.horizon)
        self.reset()

    def reset(self) -> None:
        """Forget everything, for instance before another flight."""
        self.history = CommandHistory()
        self.start_afresh()

    def start_afresh(self) -> None:
        """Forget the previous plan, yet not the command in force; the horizon starts anew."""
        self.history.forget()
        self._previous: Plan | None = None
        self._goals: Array | None = None  # of the previous plan
        self._ticks = self._fallbacks = self._planned = 0
        self._arriving = False

    def continue_from(self, other: Controller) -> None:
        """Take over what another controller remembers, for instance one with other weights."""
        self.history = other.history
        self._previous, self._goals = other._previous, other._goals
        self._ticks, self._fallbacks = other._ticks, other._fallbacks
        self._planned, self._arriving = other._planned, other._arriving

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
        state = self._state(odometry)
        if self.remaining == 0:
            reason = Reason(Cause.HORIZON, 'the horizon has run out')
            return self._finish(self._without_plan(state, Status.FEASIBLE, reason))
        copied = sealed(np.array(goals, dtype=float))
        goals, shortened = pulled_in(self.problem, state, copied)
        task = self._task(state, goals, out_of_time)
        self._goals = goals
        plan, status, words = _solved(task)
        measured = self.problem, odometry, self.disturbance, self._velocity_source
        words = '; '.join(filter(None, (words, shortened, odd_speed(*measured))))
        reason = Reason(Cause.NONE, words)
        if plan is None:
            return self._finish(self._fall_back(task, status, reason))
        self._fallbacks, self._planned = 0, plan.horizon
        self._arriving = True
        return self._finish(self._following(task, plan, status, reason))

    def _state(self, odometry: Odometry) -> State:
        known = self.history.fraction, self.disturbance, self._velocity_source
        return state_of(self.problem, odometry, *known)

    def _task(
        self, state: State, goals: Array, out_of_time: Callable[[], bool] | None = None
    ) -> _Task:
        task = _Task(self._solver(self.remaining), state, goals, out_of_time)
        if task.solver.takes_guess:
            return replace(task, guess=self._shifted(task))
        return task

    def hold(self, odometry: Odometry, words: str) -> Tick:
        """Go on without a goal: by the previous plan as long as the fallback allows, then safely.

        Args:
            odometry: the measurement.
            words: why there is no goal.
        """
        reason = Reason(Cause.GOAL, words)
        state = self._state(odometry)
        if self._goals is None or self.remaining == 0:
            return self._finish(self._without_plan(state, Status.FAILED, reason))
        moved = np.concatenate([self._goals[1:], self._goals[-1:]])[: self.remaining]
        self._goals = sealed(moved)
        task = self._task(state, self._goals)
        return self._finish(self._fall_back(task, Status.FAILED, reason))

    def safe(self, attitude: Array, reason: Reason) -> Tick:
        """Return a tick that plans nothing, and commands what is safe.

        Args:
            attitude: the present one, shape (n, n).
            reason: why nothing is planned.
        """
        return self._safe(None, attitude, Status.FAILED, reason)

    def _fall_back(self, task: _Task, status: Status, reason: Reason) -> Tick:
        self._fallbacks += 1
        # The n-th tick after a plan was found is its step n: the last is N - 1.
        if self._fallbacks < min(FALLBACK_TICKS + 1, self._planned):
            guess = task.guess or self._shifted(task)
            if guess and not violations(task.problem, task.state, task.goals, guess):
                return self._following(task, guess, status, reason, Fallback.SHIFTED_PLAN)
        if self._arriving and task.problem.terminal == 'constraint' and status == Status.INFEASIBLE:
            return self._arrive_softly(task, reason)
        return self._without_plan(task.state, status, reason)

    def _arrive_softly(self, task: _Task, reason: Reason) -> Tick:
        eased = replace(task, solver=self._solver(self.remaining, soft=True), guess=None)
        plan, _, _ = _solved(eased)
        if plan is None:
            return self._without_plan(task.state, Status.INFEASIBLE, reason)
        miss = float(np.linalg.norm(plan.positions[-1] - task.goals[-1]))
        if miss > task.problem.length_unit:
            reason = reason.and_so(f'the nearest plan misses by {miss:.3g} m')
            return self._without_plan(task.state, Status.INFEASIBLE, reason)
        reason = reason.and_so(f'the plan misses by {miss:.3g} m')
        return self._following(eased, plan, Status.INFEASIBLE, reason, Fallback.SOFT_ARRIVAL)

    def _following(
        self,
        task: _Task,
        plan: Plan,
        status: Status,
        reason: Reason,
        fallback: Fallback = Fallback.NONE,
    ) -> Tick:
        """Return the tick that follows a checked plan, if the command made of it may be sent."""
        command = command_of(task.problem, task.state, plan)
        wrong = '; '.join(command_violations(task.problem, plan, command))
        if not wrong and (last_look := flaw(self.problem, command)):
            wrong = f'not sent: {last_look}'
        if wrong:
            rejected = Reason(Cause.COMMAND, wrong)
            return self._without_plan(task.state, Status.FAILED, rejected)
        known = task.problem, task.goals, reason.cause
        return Tick(status, reason.words, task.state, plan, command, fallback, *known)

    def _without_plan(self, state: State, status: Status, reason: Reason) -> Tick:
        return self._safe(state, state.attitude, status, reason)

    def _safe(self, state: State | None, attitude: Array, status: Status, reason: Reason) -> Tick:
        """Return the tick that commands what is safe.

        Raises:
            RuntimeError: the safe command itself must not be sent, which its own law excludes.
        """
        kind, problem = self._safe_kind, self.problem
        command = safe_command(kind, problem, attitude, self.history.fraction, self.disturbance)
        wrong = flaw(problem, command, stopping=may_stop(kind, problem))
        if wrong:
            raise RuntimeError(f'the safe command is not sent: {wrong}')
        fallback = Fallback.SAFE_COMMAND
        return Tick(status, reason.words, state, None, command, fallback, cause=reason.cause)

    def _finish(self, tick: Tick) -> Tick:
        self._previous = tick.plan
        self.history.last = tick.command
        self._ticks += 1
        return tick

    def _shifted(self, task: _Task) -> Plan | None:
        if self._previous is None:
            return None
        return shifted(
            task.problem, task.state, task.goals, self._previous, projection=self._projection
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


def _solved(task: _Task) -> tuple[Plan | None, Status, str]:
    """Return a checked plan, or None, with status and reason."""
    try:
        plan = task.solver.solve(task.state, task.goals, task.guess, task.out_of_time)
    except Infeasible as error:
        return None, Status.INFEASIBLE, str(error)
    except SolverFailure as error:
        return None, Status.FAILED, str(error)
    if plan.status == Status.OPTIMAL:
        return plan, Status.OPTIMAL, ''
    unproved = f'not proved optimal: gap {plan.gap:.2g}'
    return plan, plan.status, '; '.join(filter(None, (unproved, plan.proof.reason)))
