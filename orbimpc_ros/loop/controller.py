# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The receding-horizon controller: odometry and goals in, a checked command out, each tick."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from orbimpc_ros.loop.delay import CommandHistory
from orbimpc_ros.loop.interception import Catch, Hunt, Interception, Target
from orbimpc_ros.loop.odometry import Odometry, odd_speed, state_of
from orbimpc_ros.loop.response import Response, held_back
from orbimpc_ros.loop.safety import entry_of_safety, may_stop, safe_command
from orbimpc_ros.loop.traffic.clearest import (
    cheapest_clear,
    clear_instead,
    clearest,
    cuts_turns,
    is_clear,
)
from orbimpc_ros.loop.traffic.reserve import keeping, kept
from orbimpc_ros.mpc.arrays import Array, ByContent, number, sealed
from orbimpc_ros.mpc.check import command_violations, violations
from orbimpc_ros.mpc.command import Command, command_of, flaw
from orbimpc_ros.mpc.errors import BadInput, Infeasible, SolverFailure
from orbimpc_ros.mpc.outcome import Cause, Fallback, Reason, Status
from orbimpc_ros.mpc.plan import UNPROVED, Plan, assemble, later, shifted
from orbimpc_ros.mpc.problem import Approach, Hazard, Problem, State
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.problem.cones import told
from orbimpc_ros.mpc.problem.pace import entry_speed, moved_towards
from orbimpc_ros.mpc.problem.reach import held_goal, pulled_in
from orbimpc_ros.mpc.problem.sought import Sought
from orbimpc_ros.mpc.problem.traffic import traffic_of
from orbimpc_ros.mpc.solve.request import Enough
from orbimpc_ros.mpc.solve.scouting import Scout
from orbimpc_ros.mpc.solve.solver import Solver

FALLBACK_TICKS = 2  # how long the shifted previous plan may stand in for a new one
ARRIVAL_WEIGHT = 1e4  # on the miss, when an arrival on the spot has become impossible
CATCHES_AMONG = 16  # plans of a catch that are tried among hazards
SNAP = 1e-3  # of a step: so exact are stamps, and steps begun


@dataclass(frozen=True, eq=False)
class Tick(ByContent):
    """The controller's decision on one tick.

    Attributes:
        status: of the solve.
        reason: why, where it is not ``optimal``, and what was done about a goal too far away, a
            plan outside of the cones of a descent, a measured speed that the model does not know,
            or a goal inside of an obstacle; else empty.
        state: the state that the plan starts from; None if nothing was to be planned.
        plan: the checked plan behind the command, but for hazards where that follows the clearest
            way; None if the command is the safe one.
        command: what to do next.
        fallback: what the command follows, if not a new plan.
        problem: what the plan solves; None without a plan, as is the next.
        goals: g_1..g_N that it was made for, shape (N, n) [m].
        cause: what kept the tick from being planned on fresh inputs, if anything did.
        catch: how soon the goal can be caught; None where none is looked for.
        infeasible: in what no trajectory is feasible, where that is the status.
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
    catch: Catch | None = None
    infeasible: Sought | None = None

    @property
    def case(self) -> Case | None:
        """Return what the plan solves; None without a plan."""
        if self.problem is None or self.state is None or self.goals is None:
            return None
        return Case(self.problem, self.state, self.goals)


@dataclass(frozen=True)
class _Task:
    """The question that a tick puts to a solver.

    ``knots`` are the ends of its steps, counted in steps of the plan before, from its start.
    """

    problem: Problem
    state: State
    goals: Array
    knots: Array
    out_of_time: Callable[[], bool] | None = None
    guess: Plan | None = None
    solver: Solver | None = None

    @property
    def known(self) -> tuple[Problem, State, Array]:
        """Return what plans are held against: problem, state and goals."""
        return self.problem, self.state, self.goals


class Controller:
    """Re-plans at every tick; every command is checked, whatever it was made from.

    Without a plan it falls back, in this order, on

    - the shifted previous plan, if it still holds from the new state, for two ticks at most and
      never past its horizon;
    - a *soft arrival*, where a terminal constraint that could be met before no longer can be,
      because of disturbances: the plan that comes nearest; in a descent from the start on;
    - among hazards, the *clearest way*: a plan that meets all else, and stays out of them the most;
    - the safe command.

    Ticks may come as often as they like. How far the previous plan is flown, and what a shrinking
    horizon has left, is told by the stamps of odometry; where they do not increase, a step passed.

    Args:
        problem: what to solve; compiled here, so that a tick only updates data.
        projection: ``nearest`` or ``thrust_aligned``.
        shrinking: whether the horizon ends N steps after the first tick (a fixed arrival time)
            instead of receding. In between, the steps left are shortened to end with it.
        gap_tolerance: relative gap within which a plan counts as proved optimal.
        safe: kind of safe command, see :func:`orbimpc_ros.loop.safety.safe_command`.
        disturbance: a wind or an acceleration, shape (n,); by default there is none.
        velocity_source: what odometry measures: velocity over ``ground`` or through the ``air``.
        response: lags of the vehicle; odometry then goes through :meth:`settled`.
        capture_radius: within which the goal is caught [m]. Above 0 the earliest catch within the
            horizon is flown, and the problem's own objective where there is none; that takes a
            receding horizon and a terminal penalty. A catch is looked for as if there were no
            hazards, and flown if it is clear of them.
        approach: the cone of headings in which a catch counts; by default any heading does.
        reserve: what plans keep away from hazards beyond what is demanded, as far as there is a
            plan that does; see :mod:`orbimpc_ros.loop.traffic.reserve` [m].
        centred: whether catches lead through the middle of the goal, which takes gentler turns than
            to be within the radius as soon as can be.

    Attributes:
        history: the commands of late; a tick's command counts as sent unless another is added.
        disturbance: what the next tick plans with; who estimates more than is known may set it.
        hazards: what moves and the next tick stays clear of; their time begins with its odometry.
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
        response: Response | None = None,
        capture_radius: float = 0.0,
        approach: Approach | None = None,
        reserve: float = 0.0,
        centred: bool = False,
    ) -> None:
        self._reserve = number(reserve, 'reserve', 0.0)
        self._max_rate, problem = problem.max_rate, _planned(problem)
        self.problem, self._safe_kind = problem, safe
        self.response = response or Response()
        self.disturbance, self._velocity_source = disturbance, velocity_source
        self.hazards: tuple[Hazard, ...] = ()
        self._projection, self._shrinking, self._tolerance = projection, shrinking, gap_tolerance
        self._solvers: dict[tuple[int, float, bool], Solver] = {}
        self._counted = np.arange(1.0, problem.horizon + 1.0)
        self._solver(problem.horizon, problem.step)
        self._catchers: dict[Target, Solver] = {}
        self._scout: Scout | None = None
        self._interception: Interception | None = None
        self._approach = approach or Approach()
        if number(capture_radius, 'capture_radius', 0.0) > 0.0:
            if shrinking or problem.terminal != 'penalty':
                raise BadInput('capture_radius', capture_radius, '0 with an arrival in time')
            caught = replace(problem, approach=self._approach)
            self._interception = Interception(
                caught, capture_radius, self.response.speed, centred=centred
            )
            for target in self._interception.targets:
                self._catcher(target)
        by_its_axis = self._interception is not None and self._approach.is_the_goals
        self._wants_attitude = problem.wants_attitude or by_its_axis
        self.reset()

    def reset(self) -> None:
        """Forget everything, for instance before another flight."""
        self.history = CommandHistory()
        self._reached: float | None = None  # share of full speed, by a vehicle that obeys commands
        self.start_afresh()

    def start_afresh(self) -> None:
        """Forget the previous plan, yet not the command in force; the horizon starts anew."""
        self.history.forget()
        self._previous: Plan | None = None
        self._goals: Array | None = None  # of the previous plan
        self._wanted: Array | None = None  # the rotation of its end
        self._fallbacks = self._planned = 0
        self._since = 0.0  # steps since a plan was found
        self._flown = self.response.lead(self.problem) / self.problem.step  # since the start
        self._due: Command | None = None  # for the step that begins, of a vehicle that lags
        self._last: float | None = None  # stamp of the last tick [s]
        self._pace = self.problem.step  # of the previous plan's steps [s]
        self._arriving = False
        self._catch = 0.0  # when the goal is to be caught [s]
        self._aim = np.zeros(self.problem.dimension)  # where the last plan arrives

    def expect_hazards(self) -> None:
        """Make now what the first tick with hazards would have to wait for: that takes a second."""
        for solver in self._solvers.values():
            solver.expect_hazards()
        if self._scout is None and cuts_turns(self.problem):
            self._scout = Scout(self.problem, steered=True)

    def continue_from(self, other: Controller) -> None:
        """Take over what another controller remembers, for instance one with other weights."""
        self.history = other.history
        self._previous, self._goals = other._previous, other._goals
        self._wanted = other._wanted
        self._flown, self._last, self._pace = other._flown, other._last, other._pace
        self._since, self._fallbacks, self._due = other._since, other._fallbacks, other._due
        self._planned, self._arriving, self._aim = other._planned, other._arriving, other._aim
        self._catch, self._reached = other._catch, other._reached

    @property
    def remaining(self) -> int:
        """Return the steps left to plan a step after the last tick."""
        return self._steps(self._flown + (self._last is not None))[0]

    def ends(self, time: float) -> Array:
        """Return the ends of the steps that a tick at a time [s] plans, shape (N or less,) [s]."""
        count, step = self._steps(self._flown + self._passed(time))
        return np.asarray(time + step * self._counted[:count])

    def _steps(self, flown: float) -> tuple[int, float]:
        """Return how many steps are left, and how long they are [s], after so many of the start."""
        problem = self.problem
        if not self._shrinking:
            return problem.horizon, problem.step
        left = problem.horizon - flown
        count = max(0, math.ceil(left - SNAP))
        whole = count == 0 or abs(left - count) <= SNAP
        return count, problem.step if whole else problem.step * left / count

    def _passed(self, time: float) -> float:
        """Return the steps since the last tick, by stamps [s]; one if they do not increase."""
        if self._last is None:
            return 0.0
        steps = (time - self._last) / self.problem.step
        if steps <= 0.0 or abs(steps - 1.0) <= SNAP:
            return 1.0
        return steps

    def _begin(self, odometry: Odometry) -> Array:
        """Count on to a tick, and return the ends of its steps in those of the plan before."""
        passed = self._passed(odometry.time)
        self._last = odometry.time
        self._flown += passed
        self._since += passed
        count, step = self._steps(self._flown)
        before, self._pace = self._pace, step
        if before == step == self.problem.step:
            return passed + self._counted[:count]
        return (passed * self.problem.step + step * self._counted[:count]) / before

    def tick(
        self,
        odometry: Odometry,
        goals: Array,
        out_of_time: Callable[[], bool] | None = None,
        ahead: Callable[[Array], Array] | None = None,
        wanted: Array | None = None,
    ) -> Tick:
        """Plan from a measurement towards goals g_1..g_N at its :meth:`ends`, shape (N, n) [m].

        Args:
            odometry: the measurement.
            goals: targets at the ends of the coming steps.
            out_of_time: polled by long searches; True makes them return their best plan.
            ahead: returns where the goal will be at times, shape (M,) [s], as shape (M, n) [m]:
                what is to be intercepted can then be met beyond the horizon.
            wanted: the rotation wanted at the end, shape (n, n), as the goal's; None for any.
        """
        passed = self._passed(odometry.time)
        self._change_speed(passed)
        self._wanted = wanted
        state, knots = self._state(odometry), self._begin(odometry)
        if not len(knots):
            reason = Reason(Cause.HORIZON, 'the horizon has run out')
            return self._finish(self._without_plan(state, Status.FEASIBLE, reason))
        copied = sealed(np.array(goals, dtype=float))
        goals, shortened = pulled_in(self.problem, state, copied)
        task = self._task(state, goals, knots, out_of_time)
        self._goals = goals
        held, catch = held_goal(task.problem, state, goals), None
        if self._interception is None or shortened:
            task, (plan, status, words) = self._tracked(task)
        else:
            task, (plan, status, words), catch = self._caught(
                task, self._interception, ahead, passed or math.inf
            )
        measured = self.problem, odometry, self.disturbance, self._velocity_source
        words = '; '.join(filter(None, (words, held, shortened, odd_speed(*measured))))
        reason = Reason(Cause.NONE, words)
        if plan is None:
            nothing = Sought(*task.known) if status is Status.INFEASIBLE else None
            instead = self._fall_back(task, status, reason)
            return self._finish(replace(instead, infeasible=nothing))
        self._fallbacks, self._planned, self._since = 0, plan.horizon, 0.0
        self._arriving, self._aim = True, goals[-1]
        tick = self._following(task, plan, status, reason)
        return self._finish(replace(tick, catch=catch) if catch and tick.plan else tick)

    def _tracked(self, task: _Task) -> tuple[_Task, _Answer]:
        """Return a task with as much of the reserve as there is a plan for, and its answer.

        That is all of it, or what the plan before keeps.
        """
        if not self._reserve or not task.state.hazards:
            return task, self._clear(task, task, _solved(task))
        every = np.full(len(task.state.hazards), self._reserve)
        wary = replace(task, state=keeping(task.state, every))
        answer = _solved(wary)
        if answer[0] is None:
            left = kept(task.problem, task.state, task.guess, self._reserve)
            wary = replace(task, state=keeping(task.state, left))
            answer = _solved(wary)
        return wary, self._clear(task, wary, answer)

    def _clear(self, task: _Task, wary: _Task, answer: _Answer) -> _Answer:
        """Return an answer whose plan is clear of hazards when its turns are cut, as far as any is.

        Of other ways those that keep the reserve of the ``wary`` task come first.
        """
        plan, status, words = answer
        hopeless = not task.state.hazards or status is Status.INFEASIBLE
        if hopeless or (plan is not None and is_clear(*wary.known, plan)):
            return answer
        instead = self._clear_way(task, wary, plan)
        if plan is None:
            return (replace(instead, proof=UNPROVED), Status.FEASIBLE, words) if instead else answer
        instead = instead or clear_instead(*wary.known, plan, task.out_of_time)
        if instead is plan:
            known = is_clear(*task.known, plan)
            return answer if known else _with(answer, 'it turns into a hazard, as every way does')
        instead = replace(instead, proof=plan.proof)
        less = 'a way that can be turned in time is flown instead of a cheaper one'
        return instead, instead.status, '; '.join(filter(None, (words, less)))

    def _clear_way(self, task: _Task, wary: _Task, plan: Plan | None) -> Plan | None:
        """Return the cheapest clear way of the plan, the one before, and the one that is scouted.

        With the reserve first, then without.
        """
        guess = None if plan is None else task.guess
        for each in (wary,) if wary is task else (wary, task):
            ways = filter(None, (plan, guess, self._scouted(each)))
            found = cheapest_clear(*each.known, ways)
            if found is not None:
                return found
        return None

    def _scouted(self, task: _Task) -> Plan | None:
        """Return a way among hazards that the vehicle can turn along, if one is found."""
        traffic = traffic_of(task.problem, task.state)
        if self._scout is None or traffic is None or task.problem != self.problem:
            return None
        headings = self._scout.way(task.state, task.goals, traffic, task.out_of_time)
        if headings is None:
            return None
        return assemble(*task.known, headings, projection=self._projection, proof=UNPROVED)

    def _caught(
        self,
        task: _Task,
        interception: Interception,
        ahead: Callable[[Array], Array] | None,
        pause: float,
    ) -> tuple[_Task, _Answer, Catch]:
        """Return the task of the earliest catch and its answer; the given one's without any.

        It is looked for as if there were no hazards, which can only be sooner: its bound is one
        among them, too. Where it leads through them, it is no catch. Among hazards it is looked for
        in a few plans only: most of the time is for what has to keep clear of them.

        ``pause`` is the time from the last tick to this one, in steps; infinite at the first.
        """
        free = replace(task, state=replace(task.state, hazards=()))
        now = self._last or 0.0
        tried: list[tuple[_Task, _Answer]] = []

        def goals(end: float) -> Array:
            if ahead is None or (end <= len(task.goals) and end == int(end)):
                return task.goals[: int(end)]
            catching = interception.problem(Target(end))
            return ahead(now + catching.step * self._counted[: catching.horizon])

        def solved(target: Target, goals: Array) -> Plan | bool:
            chosen = self._catching(free, interception.problem(target), goals)
            chosen = self._with(self._catcher(target), chosen)
            tried.append((chosen, _solved(chosen)))
            plan, status, _ = tried[-1][1]
            return plan or status is Status.INFEASIBLE

        def flown_on(target: Target, goals: Array) -> Plan | None:
            chosen = self._catching(free, interception.problem(target), goals)
            plan = self._shifted(chosen)
            if plan is None or violations(*chosen.known, plan):
                return None
            tried.append((chosen, (plan, plan.status, 'the catch planned before is flown on')))
            return plan

        farthest = len(task.goals) if ahead is None else interception.farthest
        most = CATCHES_AMONG if task.state.hazards else math.inf

        def late() -> bool:
            return len(tried) >= most or (task.out_of_time is not None and task.out_of_time())

        expected = (self._catch - now) / task.problem.step
        if abs(expected - round(expected)) <= SNAP:
            expected = float(round(expected))
        known = ahead is not None, pause, expected, flown_on
        hunt = Hunt(free.state, goals, solved, late, farthest, *known)
        plan, catch = interception.earliest(hunt)
        words = self._unmet(catch) if plan is None else ''
        if plan is not None:
            chosen, answer = next(each for each in tried if each[1][0] is plan)
            chosen = replace(chosen, state=task.state)
            if not task.state.hazards or _is_free(chosen, plan):
                self._catch = now + chosen.problem.step * chosen.problem.horizon
                self._pace, self._goals = chosen.problem.step, chosen.goals
                return chosen, answer, catch
            words = f'the catch at {catch.time:.4g} s leads through traffic'
            catch = replace(catch, time=math.nan)
        task, tracked = self._tracked(task)
        return task, _with(tracked, words), catch

    def _unmet(self, catch: Catch) -> str:
        """Return in words that no catch was found with a heading inside the cone of approach."""
        if not self._approach.exists:
            return ''
        return f'approach: found no turn that meets the cone of a catch before {catch.bound:.4g} s'

    def _catcher(self, target: Target) -> Solver:
        """Return the solver of catching the goal; between ends and past the horizon few are."""
        if target not in self._catchers:
            assert self._interception is not None
            enough = self._interception.enough(target.end)
            self._catchers[target] = self._made(self._interception.problem(target), enough)
        return self._catchers[target]

    def _catching(self, task: _Task, problem: Problem, goals: Array) -> _Task:
        """Return the task of coming close within a number of steps, perhaps of longer ones."""
        knots, step = task.knots[: len(goals)], problem.step
        if step != task.problem.step:
            each = task.knots[1] - task.knots[0]
            stretched = step / task.problem.step * self._counted[: len(goals)]
            knots = task.knots[0] - each + each * stretched
        goals = sealed(goals.copy())
        return replace(task, problem=problem, goals=goals, knots=knots, guess=None, solver=None)

    def _with(self, solver: Solver, task: _Task) -> _Task:
        """Return a task with its solver, and with a guess where that makes it faster."""
        guess = self._shifted(task) if solver.takes_guess(task.state) else None
        return replace(task, solver=solver, guess=guess)

    def settled(self, odometry: Odometry) -> Odometry:
        """Return what to plan from: the measurement, moved on by what the vehicle's lags leave."""
        if not self.response.lags:
            return odometry
        applied = self.history.applied(odometry.time, self.response.speed)
        known = (applied, self._applied or 0.0), self.disturbance, self._velocity_source
        later = self.response.settled(self.problem, odometry, *known)
        coming = self._due or self.history.last
        if self.problem.rotation_order == 1 or coming is None:
            return later
        return replace(later, body_rate=coming.body_rate)

    @property
    def _applied(self) -> float | None:
        """Return the share of thrust, or speed, with which the model begins its first step."""
        command = self._due or self.history.last
        return None if command is None else command.speed_fraction

    def _state(self, odometry: Odometry) -> State:
        known = self._applied, self.disturbance, self._velocity_source
        wanted = self._wanted if self._wants_attitude else None  # or it need not be looked at
        state = state_of(self.problem, odometry, *known, self._reached, wanted)
        return replace(state, hazards=self.hazards)

    def _change_speed(self, steps: float) -> None:
        """Note how far towards the last command the speed has come, a number of steps later."""
        if not self.problem.max_acceleration or self.history.last is None:
            return
        told = self.history.last.speed_fraction
        before = told if self._reached is None else self._reached
        before = max(before, min(told, self.problem.floor.clearance(self.problem.dimension)))
        self._reached = moved_towards(self.problem, before, told, steps)

    def _task(
        self,
        state: State,
        goals: Array,
        knots: Array,
        out_of_time: Callable[[], bool] | None = None,
    ) -> _Task:
        solver = self._solver(len(knots), self._pace)
        return self._with(solver, _Task(solver.problem, state, goals, knots, out_of_time))

    def hold(self, odometry: Odometry, words: str) -> Tick:
        """Go on without a goal: by the previous plan as long as the fallback allows, then safely.

        Args:
            odometry: the measurement.
            words: why there is no goal.
        """
        reason = Reason(Cause.GOAL, words)
        self._change_speed(self._passed(odometry.time))
        state, knots = self._state(odometry), self._begin(odometry)
        unknown = self._goals is None or (self._wants_attitude and self._wanted is None)
        if unknown or not len(knots):
            return self._finish(self._without_plan(state, Status.FAILED, reason))
        assert self._goals is not None
        self._goals = sealed(later(self._goals, knots - 1.0))
        task = self._task(state, self._goals, knots)
        return self._finish(self._fall_back(task, Status.FAILED, reason))

    def safe(self, attitude: Array, reason: Reason) -> Tick:
        """Return a tick that plans nothing, and commands what is safe.

        Args:
            attitude: the present one, shape (n, n).
            reason: why nothing is planned.
        """
        self._change_speed(1.0)
        return self._safe(None, attitude, Status.FAILED, reason)

    def _fall_back(self, task: _Task, status: Status, reason: Reason) -> Tick:
        self._fallbacks += 1
        if self._fallbacks <= FALLBACK_TICKS and self._since < self._planned - SNAP:
            guess = task.guess or self._shifted(task)
            if guess and not violations(task.problem, task.state, task.goals, guess):
                return self._following(task, guess, status, reason, Fallback.SHIFTED_PLAN)
        arriving = self._arriving or task.problem.has_cones  # to wait is to fall
        if arriving and task.problem.terminal == 'constraint' and not reason.cause:
            return self._arrive_softly(task, status, reason)
        if task.state.hazards and not reason.cause:
            return self._sidestep(task, status, reason)
        return self._without_plan(task.state, status, reason)

    def _sidestep(self, task: _Task, status: Status, reason: Reason) -> Tick:
        """Return the tick that follows the clearest way, if there is any that meets all else."""
        known = task.problem, task.state, task.goals
        guess = task.guess or self._shifted(task)
        plan, apart = clearest(*known, guess, self._projection, task.out_of_time)
        if plan is None:
            return self._without_plan(task.state, status, reason)
        reason = reason.and_so(f'the clearest way is {-apart:.3g} m inside of a hazard')
        return self._following(task, plan, status, reason, Fallback.CLEAREST_WAY)

    def _arrive_softly(self, task: _Task, status: Status, reason: Reason) -> Tick:
        solver = self._solver(len(task.knots), self._pace, soft=True)
        eased = replace(task, problem=solver.problem, solver=solver, guess=None)
        eased = replace(eased, guess=self._shifted(eased))
        plan, _, _ = _solved(eased)
        if plan is None:
            return self._without_plan(task.state, status, reason)
        miss = float(np.linalg.norm(plan.positions[-1] - task.goals[-1]))
        jump = float(np.linalg.norm(task.goals[-1] - self._aim)) if self._arriving else 0.0
        if jump > task.problem.length_unit:
            jumped = f'the goal has jumped by {jump:.3g} m'
            reason = reason.and_so(f'{jumped}, the nearest plan misses by {miss:.3g} m')
            return self._without_plan(task.state, status, reason)
        self._aim = task.goals[-1]
        reason = reason.and_so(f'the plan misses by {miss:.3g} m')
        return self._following(eased, plan, status, reason, Fallback.SOFT_ARRIVAL)

    def _following(
        self,
        task: _Task,
        plan: Plan,
        status: Status,
        reason: Reason,
        fallback: Fallback = Fallback.NONE,
    ) -> Tick:
        """Return the tick that follows a checked plan, if the command made of it may be sent."""
        problem = task.problem
        if problem.max_rate != self._max_rate:
            problem = replace(problem, max_rate=self._max_rate)
        command = command_of(problem, task.state, plan)
        entry = entry_speed(problem, task.state) if problem.max_acceleration else 0.0
        wrong = '; '.join(command_violations(problem, plan, command, entry))
        if not wrong and (last_look := flaw(problem, command, entry=entry)):
            wrong = f'not sent: {last_look}'
        if wrong:
            return self._rejected(task, wrong)
        if self.response.lags:
            before, self._due = self._due or self.history.last, command
            command = held_back(problem, plan, before, command)
            if last_look := flaw(problem, command, entry=entry):
                return self._rejected(task, f'not sent: {last_look}')
        if problem.max_acceleration:
            self._reached = entry
        known = task.problem, task.goals, reason.cause
        return Tick(status, reason.words, task.state, plan, command, fallback, *known)

    def _rejected(self, task: _Task, why: str) -> Tick:
        return self._without_plan(task.state, Status.FAILED, Reason(Cause.COMMAND, why))

    def _without_plan(self, state: State, status: Status, reason: Reason) -> Tick:
        return self._safe(state, state.attitude, status, reason)

    def _safe(self, state: State | None, attitude: Array, status: Status, reason: Reason) -> Tick:
        """Return the tick that commands what is safe.

        Raises:
            RuntimeError: the safe command itself must not be sent, which its own law excludes.
        """
        kind, problem, self._due = self._safe_kind, self.problem, None
        before = self.history.fraction if self._reached is None else self._reached
        command = safe_command(kind, problem, attitude, before, self.disturbance)
        entry = entry_of_safety(problem, before)
        wrong = flaw(problem, command, stopping=may_stop(kind, problem), entry=entry)
        if wrong:
            raise RuntimeError(f'the safe command is not sent: {wrong}')
        fallback = Fallback.SAFE_COMMAND
        return Tick(status, reason.words, state, None, command, fallback, cause=reason.cause)

    def _finish(self, tick: Tick) -> Tick:
        self._previous = tick.plan
        self.history.last = tick.command
        return tick

    def _shifted(self, task: _Task) -> Plan | None:
        if self._previous is None:
            return None
        known = task.problem, task.state, task.goals, self._previous, task.knots
        return shifted(*known, projection=self._projection)

    def _solver(self, horizon: int, step: float, *, soft: bool = False) -> Solver:
        key = horizon, step, soft
        if key not in self._solvers:
            if step != self.problem.step:  # of steps that are cut short, none comes back
                self._solvers = {k: s for k, s in self._solvers.items() if k[1] in self._kept(step)}
            problem = replace(self.problem, horizon=horizon, step=step)
            if soft:
                problem = replace(problem, terminal='penalty', arrival_weight=ARRIVAL_WEIGHT)
            self._solvers[key] = self._made(problem)
        return self._solvers[key]

    def _made(self, problem: Problem, enough: Enough | None = None) -> Solver:
        return Solver(
            problem,
            projection=self._projection,
            gap_tolerance=self._tolerance,
            coasting=True,
            enough=enough,
        )

    def _kept(self, step: float) -> tuple[float, float]:
        """Return the lengths of steps whose solvers are kept [s]."""
        return self.problem.step, step


def _planned(problem: Problem) -> Problem:
    """Return the problem that plans solve: thrust in space may turn faster than the vehicle does.

    Commands keep ``max_rate``. Its chord would also limit how fast thrust grows and falls, which
    no turn does, and among boxes no search is done in time with it.
    """
    orders = problem.dimension, problem.rotation_order, problem.inertial
    limited = problem.floor.exists or problem.has_cones or problem.terminal == 'constraint'
    if orders != (3, 1, True) or limited:
        return problem
    return replace(problem, max_rate=0.0)


_Answer = tuple[Plan | None, Status, str]


def _with(answer: _Answer, more: str) -> _Answer:
    """Return an answer with more words to it."""
    plan, status, words = answer
    return plan, status, '; '.join(filter(None, (words, more)))


def _is_free(task: _Task, plan: Plan) -> bool:
    """Return whether a plan that was made without hazards is clear of them, as it is flown."""
    known = task.problem, task.state, task.goals, plan
    return not violations(*known) and is_clear(*known)


def _solved(task: _Task) -> _Answer:
    """Return a checked plan, or None, with status and reason."""
    assert task.solver is not None
    try:
        plan = task.solver.solve(task.state, task.goals, task.guess, task.out_of_time)
    except Infeasible as error:
        return None, Status.INFEASIBLE, str(error)
    except SolverFailure as error:
        return None, Status.FAILED, str(error)
    outside = told(task.problem, task.goals, plan) if task.problem.has_cones else ''
    if plan.status == Status.OPTIMAL:
        return plan, Status.OPTIMAL, outside
    unproved = '' if plan.is_closed else f'not proved optimal: gap {plan.gap:.2g}'
    return plan, plan.status, '; '.join(filter(None, (unproved, plan.proof.reason, outside)))
