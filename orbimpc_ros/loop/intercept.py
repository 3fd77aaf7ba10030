# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Interception: the earliest step at which a plan can catch the goal, with a proof of none before.

For each step k at which the goal is within reach, a problem of k steps minimises the miss (7.10a);
the inputs of no trajectory cost more than a share of the squared radius, so that a lower bound
above (1 + share) radius^2 refutes a catch. The aim is the first step whose plan ends well within
the radius, or else the one with the smallest miss, if that is within the radius. If the planned
catch is narrowly lost, the vehicle still flies towards it: forecast, wind and model are not more
accurate than that.

Catches beyond the horizon are sought with the same number of longer steps: so a vehicle that cannot
stop finds the way out and back to a goal inside its smallest circle. The planned time of such a
catch is kept unless an earlier one is found; searching anew each time could postpone it forever.

Between the ends of two steps, shorter steps are tried if the goal's position is known then: before
the end of a step that has a catch, and within steps that may pass the goal, finely enough not to
skip a radius. A command remains in force until the next tick, which may come after the first
shorter step. In that case, they are tried only if turns are limited or take place within a step,
and not if the vehicle would turn by more than half a turn until the tick.

Mathematics: docs/mathematics.md, 7.10.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from orbimpc_ros.loop.compensation import followed
from orbimpc_ros.loop.goal.motion import GoalMotion
from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.check import holds
from orbimpc_ros.mpc.geometry.rotations import mean_axes
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem, State, Weights
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.problem.reach import missed
from orbimpc_ros.mpc.solve.request import Enough
from orbimpc_ros.mpc.solve.solver import Answer, Solver, Task

AIM = 0.95  # of the radius: largest miss of the plan of a catch
NARROW = 0.5  # of radius and cone, if a heading is required: a margin for gusts
GRAZE = 1.5  # radii: a goal missed by at most this is still flown at
SLACK = 0.5  # of the largest miss: distance of the end of a centred plan before the goal
TRIES = 3  # plans for one end, each for a goal shifted by the defect of the one before
WORTH = 0.01  # of the radius: smaller corrections of an aim justify no other plan
EFFORT = 0.1  # of the squared radius: largest cost of the inputs of a plan
LARGEST_CHANGE = 8.0  # of a rotation, |R' - R|_F^2, for half a turn
FARTHEST = 4  # horizons: latest catch that is sought
COARSEST, FINEST = 0.25, 0.0625  # of a step: range of the resolution of the time of a catch
TINY = 1e-9  # [m], [rad]
MEMORY = 256  # problems
SHARPEST = 0.5 * math.pi  # turn within a step, above which the path is too inaccurate


@dataclass(frozen=True)
class Intercept:
    """The earliest catch of the goal, as far as it is known.

    Attributes:
        time: when the plan catches it, from its start [s]; nan if no catching plan was found.
        bound: proved: no trajectory catches it at the end of one of the problem's steps before this
            time [s]; the end of the first step past the horizon if none in it has a catch. If a
            catch between two ends is earlier, its time.
        sought: what time and bound refer to.
        counted: time up to which the bound was verified independently of the solvers [s].
    """

    time: float
    bound: float
    sought: Case
    counted: float

    @property
    def checked(self) -> bool:
        """Return True if the whole bound was verified."""
        return self.bound <= self.counted


def steps_before(bound: float, step: float) -> int:
    """Return the number of steps [s] that end before a time [s], up to rounding."""
    return max(0, math.ceil(bound / step - TINY) - 1)


def catching(problem: Problem, radius: float, end: float, narrow: bool = False) -> Problem:
    """Return the problem of minimising the miss at an end, possibly in the ``narrow`` cone.

    An end, in units of steps, within a step shortens all steps. One beyond the horizon lengthens
    them; turns within longer steps are integrated, whatever the original discretisation.
    """
    steps, length = _steps_to(problem, end)
    how = 'exact' if end > steps else problem.discretisation
    change = LARGEST_CHANGE / length**2
    if problem.rotation_order == 2:
        change *= 4.0 / length**2  # a change, and its reversal
    weights, aimed = Weights(0.0, EFFORT * radius**2 / (steps * change), 0.0, 1.0), problem.approach
    aimed = replace(aimed, cone=NARROW * aimed.cone) if narrow else aimed
    return replace(
        problem,
        horizon=steps,
        step=length,
        discretisation=how,
        weights=weights,
        arrival_weight=0.0,
        approach=aimed,
    )


def _steps_to(problem: Problem, end: float) -> tuple[int, float]:
    """Return number and length [s] of the steps to an end, in units of a problem's steps."""
    steps = min(math.ceil(end), problem.horizon)
    return steps, problem.step if end == steps else problem.step * end / steps


@dataclass
class InterceptQuery:
    """Inputs of a search for an intercept."""

    task: Task  # of tracking the goal, without hazards
    motion: GoalMotion | None  # None if the goal is known only at the ends of the task's steps
    now: float  # start of the task, on the clock of the motion [s]
    pause: float = math.inf  # between ticks, in steps
    expected: float = 0.0  # planned end of the catch, in steps; none if not positive
    most: float = math.inf  # number of plans that may still be tried

    def late(self) -> bool:
        """Return True if the deadline has passed, or the limit of plans is reached."""
        late = self.task.late
        return self.most <= 0 or (late is not None and late())


class _Attempt(NamedTuple):
    """The plan found nearest to the goal at an end; ``never``: a catch there is refuted.

    The refutation has been verified if ``checked``.
    """

    solution: tuple[Task, Answer] | None = None
    end: float = 0
    miss: float = math.inf
    never: bool = False
    checked: bool = False

    @property
    def plan(self) -> Plan | None:
        """Return the plan, or None."""
        return None if self.solution is None else self.solution[1][0]


MISSED = _Attempt()
NEVER = _Attempt(never=True)  # no trajectory ends in the approach cone
_miss = attrgetter('miss')


class Interception:
    """Searches for the earliest catch within a radius [m].

    Args:
        problem: the problem solved without a catch, with the approach cone of a catch.
        radius: within which the goal is caught [m].
        solver_for: makes the solver of a problem; ``enough`` as for :class:`Solver`.
        lag: of the speed [s].
        centred: whether a catch leads through the centre of the goal, with a small margin.
    """

    def __init__(
        self,
        problem: Problem,
        radius: float,
        solver_for: Callable[..., Solver],
        lag: float = 0.0,
        *,
        centred: bool = False,
    ) -> None:
        self._tracked, self._radius, self._lag = problem, radius, lag
        self._near, self._centred = GRAZE * radius, centred
        self._step, self._horizon = problem.step, problem.horizon
        self.farthest = problem.horizon  # last end at which to search for a catch, in steps
        if problem.rotation_order == 1 and not problem.boxes:  # none is between longer steps
            longest = FARTHEST * problem.step
            if problem.max_rate:
                longest = min(longest, max(problem.step, SHARPEST / problem.max_rate))
            self.farthest = int(problem.horizon * longest / problem.step)
        share = radius / (problem.step * problem.forward)  # of a step that flies a radius
        self._finest = min(COARSEST, max(FINEST, 2.0 ** math.floor(math.log2(share))))
        self._divides = problem.rotation_order == 1  # at order 2, coasting lasts for a whole step
        self._turns_within = problem.max_rate > 0.0 or problem.discretisation != 'euler'
        self._coned = problem.approach.exists
        self._aim = (NARROW if self._coned else AIM) * radius
        self._costliest = (1.0 + EFFORT) * radius**2  # of catches
        self._solver_for = solver_for
        self.problem = lru_cache(maxsize=MEMORY)(partial(catching, problem, radius))
        for end in range(1, self._horizon + 1):  # used by nearly every search
            for narrow in (False, True) if self._coned else (False,):
                self.solver(end, narrow)

    def solver(self, end: float, narrow: bool = False) -> Solver:
        """Return the solver for an end, possibly in the narrower cone.

        Past the horizon, any plan well within the radius will do; within it, the best is wanted.
        """
        well = (NARROW * self._radius) ** 2 if end > self._horizon else -math.inf
        return self._solver_for(self.problem(end, narrow), enough=Enough(well, self._costliest))

    def prepare(self, expected: float) -> None:
        """Build the solvers of a catch expected at about an end, in steps.

        These are the ends next to it, as ticks are not quite regular, and the first one sooner.
        """
        late, soon = (_coarsely(expected + by) for by in (0.5 * COARSEST, -0.5 * COARSEST))
        for end in (late, soon, math.ceil(soon) - 1.0):
            if 0.0 < end <= self.farthest and self._divides:
                self.solver(end, self._coned)

    def earliest(self, query: InterceptQuery) -> tuple[tuple[Task, Answer] | None, Intercept]:
        """Return the task of the earliest catch with its answer, and bounds of its time.

        Without a catch, the former is None. If the catch flown towards has just been narrowly lost,
        it is the task of the nearest miss, and no time is returned.
        """
        # Past the horizon this takes a search and comes first; else it may be unnecessary.
        held = self._held(query) if query.expected > self._horizon else None
        best, bound, counted = self._in_view(query)
        lost = best.miss <= self._near and 0 < query.expected <= self._horizon
        if best.miss > self._radius and not lost:
            kept = held or self._held(query)
            best = self._sooner(query, kept) if kept.plan else self._beyond(query)
        if best.end == int(best.end) and self._is_well(best):
            best = self._bisected(query, best.end - 1.0, best, self._finest)
        if self._centred and self._is_well(best):
            best = self._through_the_middle(query, best)
        caught = best.miss <= self._radius
        first = min(bound, best.end) if caught else bound
        goals = self._goals(query, self._horizon)
        sought = Case(self._tracked, query.task.state, goals, self._radius)
        h, when = self._step, best.end if caught else math.nan
        return best.solution, Intercept(h * when, h * first, sought, h * min(counted, first))

    def _goals(self, query: InterceptQuery, end: float) -> Array:
        """Return the positions of the goal at all steps up to an end, shape (N or less, n)."""
        goals, motion = query.task.goals, query.motion
        if motion is None or (end <= len(goals) and end == int(end)):
            return goals[: int(end)]
        count, step = _steps_to(self._tracked, end)
        return motion.at(query.now + step * np.arange(1.0, count + 1.0))

    def _last(self, query: InterceptQuery) -> int:
        """Return the last end at which to search for a catch."""
        return len(query.task.goals) if query.motion is None else self.farthest

    def _in_view(self, query: InterceptQuery) -> tuple[_Attempt, int, int]:
        """Return the first catch within the horizon, or the nearest miss, and the bound in steps.

        The last value is its verified part. All ends before the bound are proved to have no catch.
        """
        bound, counted, best = 1, 1, MISSED
        goals = self._goals(query, self._horizon)
        moved = np.linalg.norm(np.diff(goals, axis=0), axis=1)
        # Largest relative motion of vehicle and goal in a step.
        travel = self._step * self._tracked.forward + float(moved.max(initial=0.0))
        near = max(self._near, self._radius + travel)
        case = self._tracked, query.task.state, goals
        out_of_reach, too_far = missed(*case, np.array([[self._radius], [near]]))
        for end in range(1, self._horizon + 1):
            attempt = MISSED if too_far[end - 1] else self._tried(query, end, goals[:end])
            surely = bool(out_of_reach[end - 1])
            bound += bound == end and (surely or attempt.never)
            counted += counted == end and (surely or (attempt.never and attempt.checked))
            if attempt.miss <= near and not self._is_well(attempt):
                attempt = min(attempt, self._passing(query, end), key=_miss)
            best = min(best, attempt, key=_miss)
            if self._is_well(best):
                break
        return best, bound, counted

    def _held(self, query: InterceptQuery) -> _Attempt:
        """Return the attempt of keeping to the planned catch; :data:`MISSED` if it is lost.

        The remainder of the previous plan is flown to its end. If it misses past the horizon, a new
        plan for about that time is tried first.
        """
        rest, end = MISSED, query.expected
        if 0.0 < end <= self._last(query) and self._may(query, end):
            goals = self._goals(query, end)
            task = replace(query.task, problem=self.problem(end), goals=sealed(goals))
            plan = task.rest
            if plan is not None and holds(*task.parts, plan) and not _turns_too_far(plan, end):
                answer = plan, Status.FEASIBLE, 'the previous plan to the catch is continued'
                miss = float(np.linalg.norm(self._off(query, end, plan, goals)))
                rest = _Attempt((task, answer), end, miss)
        if rest.miss > self._radius and self._horizon < _coarsely(end) <= self._last(query):
            anew = self._surely(query, _coarsely(end))
            rest = anew if anew.plan else rest
        return rest if rest.miss <= self._near else MISSED

    def _beyond(self, query: InterceptQuery) -> _Attempt:
        """Try to catch the goal past the horizon.

        The distance to the last miss is doubled until there is a catch, and then bisected.
        """
        last, away, catch = self._last(query), 1, MISSED
        missed: float = max(self._horizon, min(math.ceil(query.expected), last))
        while catch.plan is None and missed < last:
            end = min(missed + away, last)
            catch, away = self._surely(query, end), 2 * away
            missed = missed if catch.plan else end
        return self._bisected(query, missed, catch, 1.0)

    def _bisected(
        self, query: InterceptQuery, missed: float, catch: _Attempt, finest: float
    ) -> _Attempt:
        """Return the first catch after an end without one, up to the resolution ``finest``."""
        while catch.end - missed > finest:
            middle = finest * ((missed + catch.end) // (2.0 * finest))
            sooner = self._surely(query, middle)
            catch, missed = (sooner, missed) if sooner.plan else (catch, middle)
        return catch

    def _sooner(self, query: InterceptQuery, catch: _Attempt) -> _Attempt:
        """Return an earlier catch than the given one, if any, doubling the distance each time."""
        for away in (1, 2, 4, 8):
            end = math.ceil(catch.end) - away
            likely = end > self._horizon and catch.miss <= self._radius
            sooner = self._surely(query, end) if likely else MISSED
            if sooner.plan is None:
                break
            catch = sooner
        return catch

    def _through_the_middle(self, query: InterceptQuery, catch: _Attempt) -> _Attempt:
        """Return the catch at the same end through the centre of the goal, if there is one.

        It ends short of the goal by the remaining distance of the given catch, and a little more.
        The earliest catch turns at once and as fast as possible to gain a centimetre; a vehicle
        with lags in its turns oscillates about such plans.
        """
        end, goals = catch.end, self._goals(query, catch.end)
        if catch.plan is None or len(goals) < 2:  # too late to change much
            return catch
        passed = np.diff(catch.plan.positions[-2:], axis=0)[0] - np.diff(goals[-2:], axis=0)[0]
        ahead = passed / max(float(np.linalg.norm(passed)), TINY)
        off = self._off(query, end, catch.plan, goals)
        short = max(min(0.0, float(off @ ahead)) - SLACK * self._aim, -AIM * self._radius)
        before = np.concatenate([goals[:-1], goals[-1:] + short * ahead])
        through = self._attempted(query, end, before)
        if through.plan and self._is_well(through):
            miss = float(np.linalg.norm(self._off(query, end, through.plan, goals)))
            if miss <= self._radius:
                return catch._replace(solution=through.solution, miss=miss)
        return catch

    def _off(self, query: InterceptQuery, end: float, plan: Plan, goals: Array) -> Array:
        """Return the final position error of a vehicle that flies a plan, shape (n,) [m]."""
        astray = defect(self.problem(end), query.task.state, plan, self._lag)
        return np.asarray(plan.positions[-1] + astray - goals[-1])

    def _passing(self, query: InterceptQuery, end: int) -> _Attempt:
        """Return the first catch, or the nearest miss, within the step before an end."""
        best = MISSED
        for away in np.arange(1.0 - self._finest, 0.0, -self._finest):
            best = min(best, self._at(query, float(end - away)), key=_miss)
            if self._is_well(best):
                break
        return best

    def _at(self, query: InterceptQuery, end: float) -> _Attempt:
        """Try to catch the goal at any end where that is possible, as in :meth:`_attempted`."""
        if not self._may(query, end):
            return MISSED
        goals = self._goals(query, end)
        if missed(self.problem(end), query.task.state, goals, self._near)[-1]:
            return MISSED
        attempt = self._attempted(query, end, goals)
        return MISSED if attempt.plan and _turns_too_far(attempt.plan, end) else attempt

    def _may(self, query: InterceptQuery, end: float) -> bool:
        """Return True if catches at an end, in units of steps, may be tried."""
        allowed = self._turns_within or end / math.ceil(end) >= query.pause
        within = query.motion is not None and self._divides and allowed
        return within or end == int(end)

    def _is_well(self, attempt: _Attempt) -> bool:
        """Return True if a plan ends well within the radius: past the horizon with more margin."""
        within = self._aim if attempt.end <= self._horizon else NARROW * self._radius
        return attempt.miss <= within

    def _surely(self, query: InterceptQuery, end: float) -> _Attempt:
        """Try to come well within the radius at an end."""
        attempt = self._at(query, end)
        return attempt if self._is_well(attempt) else MISSED

    def _tried(self, query: InterceptQuery, end: int, goals: Array) -> _Attempt:
        """Try to catch the goal at an end, given its positions at the steps up to it.

        A plan possible only in the wider cone is never well within, however small its miss.
        """
        within = self._attempted(query, end, goals)
        if not self._coned or self._is_well(within):
            return within
        wider = self._attempted(query, end, goals, wide=True)
        wider = wider._replace(miss=max(wider.miss, self._radius))
        nearer = min(within, wider, key=_miss)
        return nearer._replace(never=wider.never, checked=wider.checked)

    def _attempted(
        self, query: InterceptQuery, end: float, goals: Array, *, wide: bool = False
    ) -> _Attempt:
        """Try to catch the goal at an end, in the narrower cone unless ``wide``.

        A plan is solved again for a goal shifted by its defect (iterated defect correction), while
        the next one may end near the goal if its defect is as here.
        """
        best, aims, narrow = MISSED, goals, self._coned and not wide
        problem = self.problem(end, narrow)
        posed = replace(query.task, problem=problem, solver_for=lambda _: self.solver(end, narrow))
        for _ in range(TRIES):
            if query.late():
                return best
            task = replace(posed, goals=aims)
            answer = task.solved()
            query.most -= 1
            plan, status, _ = answer
            if plan is None:
                return NEVER if status is Status.INFEASIBLE and aims is goals else best
            place = plan.positions[-1]
            astray = defect(problem, query.task.state, plan, self._lag)
            miss = float(np.linalg.norm(place + astray - goals[-1]))
            if aims is goals:  # only this proof concerns the goal itself
                never = plan.proof.lower_bound > self._costliest
                best = _Attempt((task, answer), end, miss, never, plan.proof.checked)
            elif miss < best.miss:
                best = best._replace(solution=(task, answer), miss=miss)
            aim = goals[-1] - astray
            away, change = (float(np.linalg.norm(each - aims[-1])) for each in (place, aim))
            worth = WORTH * self._radius < change >= away - self._near
            if self._is_well(best) or not worth:
                break
            aims = np.concatenate([goals[:-1], aim[None]])
        return best


def _coarsely(end: float) -> float:
    """Return an end rounded up to the coarsest share of a step."""
    return COARSEST * math.ceil(end / COARSEST)


def _turns_too_far(plan: Plan, end: float) -> bool:
    """Return True if a vehicle would turn by more than half a turn before the next tick."""
    change = float(np.sum((plan.projected[1] - plan.projected[0]) ** 2))
    return change > LARGEST_CHANGE * math.sin(0.5 * math.pi * end / math.ceil(end)) ** 2 + TINY


def defect(problem: Problem, state: State, plan: Plan, lag: float) -> Array:
    """Return the final position error of a vehicle that follows a plan, shape (n,) [m].

    An ``exact`` step integrates the chord between the thrust axes at its ends; the vehicle turns
    along the arc, and its speed has a ``lag`` [s]. The error is zero if thrust is an acceleration,
    if rates are commanded one step ahead, and for ``euler`` steps.
    """
    if problem.inertial or problem.rotation_order == 2 or problem.discretisation == 'euler':
        return np.zeros(problem.dimension)
    before, after = plan.projected[:-1], plan.projected[1:]
    ahead = mean_axes(before.transpose(0, 2, 1) @ after)
    flown, (reached, *shares) = [], plan.speed_fraction.tolist()
    for share in shares:
        reached, way = followed(reached, share, problem.step, lag)
        flown.append(way)
    travelled = problem.forward * np.einsum('k,kij,kj->i', flown, before, ahead)
    blown = problem.horizon * problem.step * state.disturbance
    return np.asarray(state.position + blown + travelled - plan.positions[-1])
