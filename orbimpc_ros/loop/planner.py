# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner's core: from a snapshot of all inputs to a checked command.

It reads neither clocks nor messages: the node, replays, studies and tests call the same
:meth:`Planner.step`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from orbimpc_ros.loop.compensation import Compensator, Odometry, PlanStart, Response, WindReport
from orbimpc_ros.loop.fallback import (
    SAFE_COMMANDS,
    cheapest_clear,
    clear_instead,
    clearest,
    entry_of_safety,
    is_clear,
    leaving,
    may_stop,
    safe_command,
)
from orbimpc_ros.loop.goal.motion import GoalMotion, Route
from orbimpc_ros.loop.intercept import FARTHEST, MEMORY, Intercept, Interception, InterceptQuery
from orbimpc_ros.loop.traffic import ObservedTraffic, nearest, reserving
from orbimpc_ros.mpc.arrays import Array, ByContent, frozen, number, sealed, word
from orbimpc_ros.mpc.check import command_violations, flaw, holds
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.outcome import Cause, Fallback, Reason, Status
from orbimpc_ros.mpc.plan import Command, Plan, command_of, interpolated, joined
from orbimpc_ros.mpc.problem import Approach, MovingObstacle, Problem, State
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.problem.reach import clamp_goal, entry_speed, held_goal, moved_towards
from orbimpc_ros.mpc.solve.solver import Answer, Late, Solver, Task

if TYPE_CHECKING:  # proofs are loaded by the first decision that needs one
    from orbimpc_ros.mpc.proof.document import Document

FALLBACK_TICKS = 2  # largest number of decisions that follow the shifted previous plan
ARRIVAL_WEIGHT = 1e4  # of the miss, if an exact arrival has become impossible
CATCHES_AMONG = 16  # largest number of plans of a catch tried among hazards
SNAP = 1e-3  # of a step: tolerance of stamps and of remaining steps
WAITING = Reason(Cause.WAITING, 'waits for odometry')


@dataclass(frozen=True, eq=False)
class Snapshot:
    """All inputs of one decision.

    A goal is g_1..g_N at the planner's :meth:`Planner.ends`, shape (N, n) [m], or a motion, which
    can also be met beyond the horizon.
    """

    odometry: Odometry | None = None  # the latest measurement; None before the first
    goal: Array | GoalMotion | None = None  # None before the first
    wanted: Array | None = None  # attitude of the goal, shape (n, n); None if free
    hazards: tuple[MovingObstacle, ...] = ()  # hazards, with times from the start of the plan
    traffic: ObservedTraffic | None = None  # observed bodies and plans, instead of hazards
    wind: WindReport | None = None  # the latest report
    odometry_age: float = 0.0  # [s]
    goal_age: float = 0.0  # [s]
    latency: float = 0.0  # from the measurement to the effect of the command [s]
    stop: Reason | None = None  # reason for following no plan, whatever the inputs


@dataclass(frozen=True, eq=False)
class Decision(ByContent):
    """The next command, and its reason.

    The ``reason`` is given if the status is not ``optimal``, and for a goal that is too far away or
    inside an obstacle, a plan outside the cones of a descent, and a speed outside the model. Plans
    are checked, except for hazards if the command follows the clearest way.
    """

    status: Status  # of the solve
    reason: str
    state: State | None  # start of the plan; None if no plan was attempted
    plan: Plan | None  # source of the command; None for the safe command
    command: Command  # command to send
    fallback: Fallback = Fallback.NONE  # source of the command, if not a new plan
    problem: Problem | None = None  # problem of the plan; None without a plan, like goals
    goals: Array | None = None  # g_1..g_N of the plan, shape (N, n) [m]
    cause: Cause = Cause.NONE  # why there is no plan on fresh inputs
    catch: Intercept | None = None  # earliest catch of the goal, if sought
    infeasible: Case | None = None  # the infeasible problem, if that is the status
    refutation: Document | None = None  # proof of infeasibility, or of no earlier catch
    advanced: float = 0.0  # from the measurement to the start of the plan, without ``led`` [s]
    led: float = 0.0  # lead of the start due to the vehicle's lags [s]
    disturbance: Array | None = None  # of the plan, shape (n,) [m/s] or [m/s^2]; None if unknown
    innovation: float | None = None  # of odometry, in standard deviations, if w is estimated
    left_out: int = 0  # moving obstacles within reach beyond the limit of a plan
    solve_time_ms: float = 0.0  # total, including the check; 0 if nothing was solved [ms]
    heard: Mapping[str, Any] = field(default_factory=dict)  # see Inputs.heard; needed by replays

    @property
    def case(self) -> Case | None:
        """Return the case that the plan solves; None without a plan."""
        if self.problem is None or self.state is None or self.goals is None:
            return None
        return Case(self.problem, self.state, self.goals)


@dataclass
class _Memory:
    """Memory of a planner between decisions."""

    aim: Array  # goal at the end of the last plan found, shape (n,) [m]
    flown: float  # steps since the start
    decision: Decision | None = None  # the last one from fresh odometry
    wanted: Array | None = None  # attitude of the last goal
    fallbacks: int = 0  # decisions since a plan was found
    until: float = 0.0  # end of the last plan found, in steps since the start; 0 before the first
    last: float | None = None  # stamp of the last decision [s]
    passed: float = 0.0  # steps from the one before to the last
    catch: float = 0.0  # planned time of the catch [s]
    route: Route | None = None  # path followed
    along: float = 0.0  # last progress of the vehicle along it [m]


class Planner:
    """Decides on a command for each snapshot; every command is checked, whatever its source.

    Without a plan it falls back, in this order, on the shifted previous plan, a soft arrival, the
    clearest way, and the safe command (docs/operating.md, What is commanded).

    Snapshots may arrive at any rate. The elapsed part of the previous plan, and the remainder of a
    shrinking horizon, follow from the stamps of odometry; if they do not increase, one step has
    elapsed. A command takes effect only when reported by :meth:`sent`.

    Args:
        problem: the problem to solve; compiled here, so that a step only updates data.
        projection: ``nearest`` or ``thrust_aligned``.
        shrinking: whether the horizon ends N steps after the first plan (a fixed arrival time)
            instead of receding. Between steps, the remaining ones are shortened to end with it.
        gap_tolerance: relative gap within which a plan counts as proved optimal.
        safe: kind of safe command, see :func:`orbimpc_ros.loop.fallback.safe_command`.
        disturbance: a wind or an acceleration, shape (n,); zero by default.
        estimated: whether the remaining disturbance is estimated from odometry.
        velocity_source: measured velocity of odometry: over ``ground`` or through the ``air``.
        sideslip: whether odometry measures the sideslip of a wing, which is then used.
        response: lags of the vehicle.
        capture_radius: within which the goal is caught [m]. If positive, the earliest catch within
            the horizon is flown, and the problem's own objective is used without one; this takes
            a receding horizon and a terminal penalty. A catch is sought as if there were no
            hazards, and flown if it is clear of them.
        approach: the cone of headings in which a catch counts; unconstrained by default.
        reserve: additional distance of plans from hazards, kept as far as some plan can keep it,
            see :mod:`orbimpc_ros.loop.traffic` [m]; unless catches are sought, it makes hazards of
            the problem's obstacles.
        centred: whether catches lead through the centre of the goal, with gentler turns than the
            earliest entry into the radius takes.
        odom_timeout: age of odometry beyond which no plan is followed [s].
        goal_timeout: age of the goal beyond which only the previous plan is continued [s].

    Attributes:
        problem: the problem that plans solve.
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
        estimated: bool = False,
        velocity_source: str = 'ground',
        sideslip: bool = False,
        response: Response | None = None,
        capture_radius: float = 0.0,
        approach: Approach | None = None,
        reserve: float = 0.0,
        centred: bool = False,
        odom_timeout: float = math.inf,
        goal_timeout: float = math.inf,
    ) -> None:
        self._reserve = number(reserve, 'reserve', 0.0)
        self._max_rate = problem.max_rate
        orders = problem.dimension, problem.rotation_order, problem.inertial
        limited = problem.floor.exists or problem.has_cones or problem.terminal == 'constraint'
        if orders == (3, 1, True) and not limited:
            # In plans, thrust in space may turn faster than the vehicle does; commands may not. Its
            # chord would also limit changes of the thrust's size, which take no turn, and with it
            # no search among boxes would finish in time.
            problem = replace(problem, max_rate=0.0)
        self._still = tuple[MovingObstacle, ...]()
        if reserve and not capture_radius:
            self._still = tuple(map(MovingObstacle.drifting, problem.obstacles))
            problem = replace(problem, obstacles=())
        unfit = 'loiter' if problem.inertial else 'hover'
        kinds = [kind for kind in SAFE_COMMANDS if kind != unfit]
        self.problem, self._safe_kind = problem, word(safe, 'safe', kinds)
        self._compensator = Compensator(
            problem,
            response,
            disturbance,
            estimated=estimated,
            velocity_source=velocity_source,
            sideslip=sideslip,
        )
        self._lags, self._shrinking = self._compensator.response.lags, shrinking
        for name, each in (('odom_timeout', odom_timeout), ('goal_timeout', goal_timeout)):
            if not each > 0.0:
                raise BadInput(name, each, 'a duration above 0 s')
        self._timeouts = odom_timeout, goal_timeout
        self._counted = np.arange(1.0, problem.horizon + 1.0)
        self._projection = projection
        build = partial(Solver, projection=projection, gap_tolerance=gap_tolerance, coasting=True)
        # Ends of catches recur, lengths of shortened steps do not: few solvers are kept for these.
        most = MEMORY if capture_radius else 2 * problem.horizon + 2
        self._solver_for = lru_cache(maxsize=most)(build)
        self._solver_for(problem)
        if self._still:
            self.expect_hazards()
        self._interception: Interception | None = None
        self._approach, self._wants_attitude = approach or Approach(), problem.wants_attitude
        if number(capture_radius, 'capture_radius', 0.0) > 0.0:
            if shrinking or problem.terminal != 'penalty':
                raise BadInput('capture_radius', capture_radius, '0 with an arrival in time')
            caught = replace(problem, approach=self._approach)
            self._wants_attitude = caught.wants_attitude
            lag = self._compensator.response.speed
            self._interception = Interception(
                caught, capture_radius, self._solver_for, lag, centred=centred
            )
        self.start_afresh()

    # --- memory

    def start_afresh(self, *, wind: bool = False) -> None:
        """Forget the previous plan, but not the command in force; the horizon starts anew.

        Args:
            wind: whether to forget the estimated disturbance, too.
        """
        self._compensator.start_afresh(wind=wind)
        self._memory = _Memory(np.zeros(self.problem.dimension), self.lead / self.problem.step)

    def continue_from(self, other: Planner) -> None:
        """Take over another planner's memory, for instance from one with other weights."""
        self._memory = other._memory
        self._compensator.continue_from(other._compensator)

    def sent(self, command: Command, at: float | None = None) -> None:
        """Record a command that was sent.

        Args:
            command: now in force.
            at: time of sending, on the clock of the stamps [s]; None if unknown.
        """
        self._compensator.history.add(command, at)

    def expect_hazards(self) -> None:
        """Compile in advance the code of the first plan among hazards, which takes a second."""
        self._solver_for(self.problem).expect_hazards()

    def prepare(self) -> None:
        """Build the solver for the next decision: of a shorter horizon, or of the expected catch.

        That takes longer than most solves: call this when the command has been sent.
        """
        memory = self._memory
        if self._shrinking:
            count, step = self._steps(memory.flown + 1.0)
            if count and step == self.problem.step:  # shortened steps differ each time
                self._solver_for(replace(self.problem, horizon=count))
        elif self._interception is not None and memory.last is not None:
            end = (memory.catch - memory.last) / self.problem.step
            self._interception.prepare(end - memory.passed)

    # --- steps of the horizon

    @property
    def lead(self) -> float:
        """Return the time by which a plan starts ahead of the vehicle because of its lags [s]."""
        return self._compensator.response.lead(self.problem)

    def ends(self, time: float) -> Array:
        """Return the ends of the steps planned from a time [s] on, shape (N or less,) [s]."""
        count, step = self._steps(self._memory.flown + self._passed(time))
        return np.asarray(time + step * self._counted[:count])

    def _steps(self, flown: float) -> tuple[int, float]:
        """Return number and length [s] of the remaining steps, ``flown`` steps after the start."""
        problem = self.problem
        if not self._shrinking:
            return problem.horizon, problem.step
        left = problem.horizon - flown
        count = max(0, math.ceil(left - SNAP))
        whole = count == 0 or abs(left - count) <= SNAP
        return count, problem.step if whole else problem.step * left / count

    def _passed(self, time: float) -> float:
        """Return the steps since the last decision, by stamps [s]; 1 if they do not increase."""
        if self._memory.last is None:
            return 0.0
        steps = (time - self._memory.last) / self.problem.step
        return 1.0 if steps <= 0.0 or abs(steps - 1.0) <= SNAP else steps

    # --- a decision

    def unsafe(self, age: float | None, stop: Reason | None = None) -> Reason | None:
        """Return the reason why no plan may be followed; None if one may.

        Args:
            age: of the latest odometry [s]; None without any.
            stop: another reason, which comes first.
        """
        if stop is not None or age is None:
            return stop or WAITING
        late = age > self._timeouts[0]
        return Reason(Cause.ODOMETRY, f'odometry is {age:.2f} s old') if late else None

    def step(
        self, snapshot: Snapshot, now: float | None = None, late: Late | None = None
    ) -> Decision:
        """Decide on the next command.

        Args:
            snapshot: the inputs.
            now: when the command takes effect, on the clock of the stamps [s]; None if delays are
                not compensated.
            late: whether the deadline of searches has passed; they then return their best plan.
        """
        measured = snapshot.odometry
        unsafe = self.unsafe(None if measured is None else snapshot.odometry_age, snapshot.stop)
        if unsafe is not None or measured is None:
            sent, h = self._compensator.history.sent, self.problem.step
            self._change_speed((now - sent[-1][0]) / h if sent and now is not None else 1.0)
            return self._safe(measured, Status.FAILED, unsafe or WAITING)
        start = self._compensator.start(measured, snapshot.latency, now, snapshot.wind)
        hazards, left_out = self._hazards(snapshot, start.odometry)
        passed, lost = self._passed(start.odometry.time), ''
        if snapshot.goal is None:
            lost = 'there is no goal'
        elif snapshot.goal_age > self._timeouts[1]:
            lost = f'the goal is {snapshot.goal_age:.2f} s old'
        self._change_speed(passed)
        memory = self._memory
        memory.wanted = memory.wanted if lost else snapshot.wanted
        wanted = memory.wanted if self._wants_attitude else None  # otherwise unused
        reached = self._compensator.history.reached  # base of limited changes of speed
        state = State.at(**start.state, commanded=reached, wanted=wanted, hazards=hazards)
        memory.last, memory.passed = start.odometry.time, passed
        memory.flown += passed
        task = self._task(state, late)
        if lost:
            decision = self._hold(state, task, lost)
        elif task is None:
            reason = Reason(Cause.HORIZON, 'the horizon has run out')
            decision = self._safe(state, Status.FEASIBLE, reason)
        else:
            decision = self._planned(snapshot.goal, start, task)
        memory.decision = decision
        if any(start.odd):
            decision = replace(decision, reason=joined(decision.reason, *start.odd))
        return replace(decision, **start.compensated, left_out=left_out)

    def _hazards(
        self, snapshot: Snapshot, odometry: Odometry
    ) -> tuple[tuple[MovingObstacle, ...], int]:
        """Return the relevant hazards, and the number of those left out."""
        if snapshot.traffic is None:
            return (*snapshot.hazards, *self._still), 0
        horizons = float(FARTHEST if self._interception is not None else 1)
        hazards = *snapshot.traffic.hazards(odometry.time), *self._still
        return nearest(self.problem, odometry, self._compensator.disturbance, hazards, horizons)

    def _change_speed(self, steps: float) -> None:
        """Update the speed reached towards the last command, a number of steps later."""
        history, problem = self._compensator.history, self.problem
        if problem.max_acceleration and history.last is not None:
            commanded = history.last.speed_fraction
            before = max(history.fraction, min(commanded, problem.least_speed))
            history.reached = moved_towards(problem, before, commanded, steps)

    def _task(self, state: State, late: Late | None) -> Task | None:
        """Return the task, still without goals; None without any steps."""
        memory = self._memory
        count, step = self._steps(memory.flown)
        if not count:
            return None
        problem = self.problem
        if self._shrinking:  # the solver's is equal, and what follows from it is known already
            problem = self._solver_for(replace(problem, horizon=count, step=step)).problem
        before, since = memory.decision, memory.passed * self.problem.step
        pace = before.problem.step if before and before.problem else self.problem.step
        case, plan = (problem, state, np.zeros((0, 0))), before.plan if before else None
        return Task(*case, self._solver_for, plan, pace, since, self._projection, late)

    def _planned(self, goal: Any, start: PlanStart, task: Task) -> Decision:
        """Return the decision for a known goal."""
        memory, state, odometry = self._memory, task.state, start.odometry
        ends = odometry.time + task.problem.step * self._counted[: task.problem.horizon]
        motion, held, catch = goal if hasattr(goal, 'at') else None, '', None
        if isinstance(motion, Route):
            places, held = self._paced(motion, odometry, ends)
        elif motion is None:
            places = frozen(goal, (len(ends), self.problem.dimension), 'goal')
        else:
            places = np.array(motion.at(ends), dtype=float)
        places.setflags(write=False)
        goals, shortened = clamp_goal(self.problem, state, places)
        task = replace(task, goals=goals)
        if not held and (state.hazards or self.problem.obstacles):
            held = held_goal(task.problem, state, goals)
        if self._interception is not None and not shortened and not isinstance(motion, Route):
            task, (plan, status, message), catch = self._caught(task, self._interception, motion)
        else:
            task, (plan, status, message) = self._tracked(task)
        reason = Reason(Cause.NONE, joined(message, held, shortened))
        if plan is None:
            nothing = Case(*task.parts) if status is Status.INFEASIBLE else None
            return replace(self._fall_back(task, status, reason), infeasible=nothing)
        memory.fallbacks, memory.aim = 0, goals[-1]
        memory.until = memory.flown + task.problem.horizon
        decision = self._following(task, plan, status, reason)
        return replace(decision, catch=catch) if catch and decision.plan else decision

    def _paced(self, route: Route, odometry: Odometry, ends: Array) -> tuple[Array, str]:
        """Return the goals along a path, from the vehicle's progress on, and any trouble."""
        memory, problem = self._memory, self.problem
        near = memory.along if memory.route is route else None
        within = problem.horizon * problem.step * problem.forward
        memory.route, memory.along = route, route.nearest(odometry.position, near, within)
        times = np.array([odometry.time, *ends])
        pace = times, problem.forward, self._compensator.disturbance
        along = route.paced(memory.along, *pace)
        return route.place(along[1:]), route.trouble(along, *pace, self._max_rate)

    def _tracked(self, task: Task) -> tuple[Task, Answer]:
        """Return a task with the largest reserve for which there is a plan, and its answer.

        The reserve is the full one, or what the previous plan keeps.
        """
        if not task.state.hazards:
            return task, task.solved()
        for wary in reserving(task, self._reserve) if self._reserve else [task]:
            answer = wary.solved()
            if answer[0] is not None:
                break
        return wary, self._clear(task, wary, answer)

    def _clear(self, task: Task, wary: Task, answer: Answer) -> Answer:
        """Return an answer whose plan, steered, is clear of hazards, as far as there is one.

        The cheaper clear plan replaces it, of the given and the previous one: first of those that
        keep the reserve of the ``wary`` task.
        """
        plan, status, message = answer
        if plan is None or is_clear(wary, plan):
            return answer
        rest = [] if task.rest is None else [task.rest]
        instead = cheapest_clear(wary, rest) or cheapest_clear(task, [plan, *rest])
        instead = instead or clear_instead(wary, plan)
        if instead is plan:
            more = '' if is_clear(task, plan) else 'it turns into a hazard, as all plans found do'
            return plan, status, joined(message, more)
        instead = replace(instead, proof=plan.proof)
        less = 'a plan that turns in time is followed instead of a cheaper one'
        return instead, instead.status, joined(message, less)

    def _caught(
        self, task: Task, interception: Interception, motion: GoalMotion | None
    ) -> tuple[Task, Answer, Intercept]:
        """Return the task of the earliest catch and its answer; without one, of tracking.

        It is sought as if there were no hazards, which can only be earlier, so that its bound also
        holds among them. A catch that leads through hazards is discarded, and only a few plans are
        tried.
        """
        memory = self._memory
        now = memory.last or 0.0
        expected = (memory.catch - now) / task.problem.step
        if abs(expected - round(expected)) <= SNAP:
            expected = float(round(expected))
        alone, most = task, math.inf
        if task.state.hazards:
            alone, most = replace(task, state=replace(task.state, hazards=())), CATCHES_AMONG
        query = InterceptQuery(alone, motion, now, memory.passed or math.inf, expected, most)
        caught, catch = interception.earliest(query)
        message = ''
        if caught is None and self._approach.exists:
            message = f'approach: no catch in the cone found; none before {catch.bound:.4g} s'
        if caught is not None:
            chosen, answer = replace(caught[0], state=task.state), caught[1]
            duration = chosen.problem.step * chosen.problem.horizon
            if not task.state.hazards or cheapest_clear(chosen, filter(None, answer[:1])):
                memory.catch = now + duration
                return chosen, answer, catch
            message = f'the catch at {duration:.4g} s leads through traffic'
            catch = replace(catch, time=math.nan)
        task, (plan, status, why) = self._tracked(task)
        return task, (plan, status, joined(why, message)), catch

    # --- without a new plan

    def _hold(self, state: State, task: Task | None, message: str) -> Decision:
        """Continue without a goal: on the previous plan while allowed, then by the safe command."""
        before, reason = self._memory.decision, Reason(Cause.GOAL, message)
        unknown = self._wants_attitude and state.wanted is None
        if before is None or before.goals is None or task is None or unknown:
            return self._safe(state, Status.FAILED, reason)
        kept = np.arange(0.0, len(before.goals))
        goals = sealed(interpolated(task.knots - 1.0, kept, before.goals))
        return self._fall_back(replace(task, goals=goals), Status.FAILED, reason)

    def _fall_back(self, task: Task, status: Status, reason: Reason) -> Decision:
        memory = self._memory
        memory.fallbacks += 1
        lasts = memory.fallbacks <= FALLBACK_TICKS and memory.flown < memory.until - SNAP
        if lasts and task.rest and holds(*task.parts, task.rest):
            return self._following(task, task.rest, status, reason, Fallback.SHIFTED_PLAN)
        if reason.cause:
            return self._safe(task.state, status, reason)
        arriving = memory.until or task.problem.has_cones  # waiting means falling
        if arriving and task.problem.terminal == 'constraint':
            return self._arrive_softly(task, status, reason)
        if eased := leaving(task):
            plan, _, _ = eased.solved()
            if plan is not None:
                reason = reason.and_so('the plan leads out of it')
                return self._following(eased, plan, status, reason, Fallback.CLEAREST_WAY)
        plan, apart = clearest(task) if task.state.hazards else (None, 0.0)
        if plan is None:
            return self._safe(task.state, status, reason)
        reason = reason.and_so(f'the clearest plan is {-apart:.3g} m inside a hazard')
        return self._following(task, plan, status, reason, Fallback.CLEAREST_WAY)

    def _arrive_softly(self, task: Task, status: Status, reason: Reason) -> Decision:
        memory = self._memory
        soft = replace(task.problem, terminal='penalty', arrival_weight=ARRIVAL_WEIGHT)
        eased = replace(task, problem=soft)
        plan, _, _ = eased.solved(guessing=True)
        if plan is None:
            return self._safe(task.state, status, reason)
        miss = float(np.linalg.norm(plan.positions[-1] - task.goals[-1]))
        jump = float(np.linalg.norm(task.goals[-1] - memory.aim)) if memory.until else 0.0
        if jump > task.problem.maps.unit:
            jumped = f'the goal has jumped by {jump:.3g} m'
            reason = reason.and_so(f'{jumped}, the nearest plan misses by {miss:.3g} m')
            return self._safe(task.state, status, reason)
        memory.aim = task.goals[-1]
        reason = reason.and_so(f'the plan misses by {miss:.3g} m')
        return self._following(eased, plan, status, reason, Fallback.SOFT_ARRIVAL)

    # --- a command

    def _following(
        self,
        task: Task,
        plan: Plan,
        status: Status,
        reason: Reason,
        fallback: Fallback = Fallback.NONE,
    ) -> Decision:
        """Return the decision for a checked plan, if its command may be sent."""
        problem = task.problem
        if problem.max_rate != self._max_rate:
            problem = replace(problem, max_rate=self._max_rate)
        command = command_of(problem, task.state, plan)
        entry = entry_speed(problem, task.state) if problem.max_acceleration else 0.0
        sent = self._compensator.held_back(problem, plan, command) if self._lags else command
        wrong = command_violations(problem, plan, command, entry)
        if not wrong and (last_look := flaw(problem, sent, entry=entry)):
            wrong = [f'not sent: {last_look}']
        if wrong:
            reason = Reason(Cause.COMMAND, '; '.join(wrong))
            return self._safe(task.state, Status.FAILED, reason)
        if problem.max_acceleration:
            self._compensator.history.reached = entry
        context = task.problem, task.goals, reason.cause
        return Decision(status, reason.words, task.state, plan, sent, fallback, *context)

    def _safe(self, measured: Odometry | State | None, status: Status, reason: Reason) -> Decision:
        """Return the decision for the safe command, which is made only here.

        ``measured`` is the state to plan from, or odometry that provides the attitude.

        Raises:
            RuntimeError: the safe command violates its own limits, which cannot happen.
        """
        kind, problem, compensator = self._safe_kind, self.problem, self._compensator
        compensator.history.due, before = None, compensator.history.fraction
        attitude = np.eye(problem.dimension) if measured is None else measured.attitude
        command = safe_command(kind, problem, attitude, before, compensator.disturbance)
        entry = entry_of_safety(problem, before)
        wrong = flaw(problem, command, stopping=may_stop(kind, problem), entry=entry)
        if wrong:
            raise RuntimeError(f'the safe command is not sent: {wrong}')
        state = measured if isinstance(measured, State) else None
        fallback, cause = Fallback.SAFE_COMMAND, reason.cause
        return Decision(status, reason.words, state, None, command, fallback, cause=cause)
