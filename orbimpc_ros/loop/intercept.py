# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Interception: the earliest step of a plan that can catch the goal, and that none before it can.

To be near a goal on average is not to touch it. For each step k that the goal is within reach of, a
problem of k steps asks for the least miss |s_k - g_k|, and next to nothing else:

    minimise |s_k - g_k|^2 + r (|u_0|^2 + ... + |u_{k-1}|^2),

with r so small that the inputs of no trajectory cost more than a share of the squared radius.
Whatever catches the goal at step k then costs at most (1 + share) radius^2: a greater lower bound
proves that nothing does. The first step whose plan comes well within the radius is aimed at, or
else the one whose plan comes closest, if that is within the radius.

Where no step of the horizon has a catch, one is looked for beyond it, by as many steps that are
longer: so a vehicle that cannot stop finds the way out and back to a goal inside its smallest
circle. It keeps to the time at which it means to catch the goal, unless it can be sooner; to look
anew each time could put the catch off for ever.

With a cone of approach a catch counts only if its last heading is inside of it, and well within
means inside of a narrower cone, too.

A catch that was flown towards, and is then lost by little, is still flown at: the forecast, the
wind and the model are no better than that.

An ``exact`` step takes the chord between the thrust axes at its ends; a vehicle turns along the
arc, and its speed follows with a lag. Plans are made anew for a goal moved by the difference at
their end, their *defect* (iterated defect correction).

Between the ends of two steps, shorter steps are tried where it is known where the goal is then:
before the end of a step that has a catch, and within steps that could have led past the goal, so
finely that no radius is jumped over. A command is obeyed until the next tick, which may come after
the first of these steps. Then none is tried but where turns are limited, or take place within a
step; and none that would turn by more than half a turn until then.

The first catch turns at once and as fast as it may, for a centimetre's sake; a vehicle whose turns
take time swings about such plans. On demand a catch is *centred*: it ends at the same time, a
little short of that, and heads through the middle of the goal, so that turns are gentle.

Mathematics: docs/mathematics.md, 7.10.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from orbimpc_ros.loop.goal.motion import GoalMotion
from orbimpc_ros.loop.task import Answer, Task
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import holds
from orbimpc_ros.mpc.geometry.rotations import log, turned
from orbimpc_ros.mpc.model.dynamics import drift
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem, State, Weights
from orbimpc_ros.mpc.problem.reach import missed
from orbimpc_ros.mpc.problem.sought import Sought
from orbimpc_ros.mpc.solve.request import Enough
from orbimpc_ros.mpc.solve.solver import Solver

AIM = 0.95  # of the radius, within which the plan of a catch ends
NARROW = 0.5  # of radius and cone, where a heading is asked for: gusts leave some of it
GRAZE = 1.5  # radii: a goal missed by no more is still flown at
SLACK = 0.5  # of that, by which a plan that leads through the middle ends before it
TRIES = 3  # plans for one end, each for a goal moved by the defect of the one before
WORTH = 0.01  # of the radius, by which another plan for the same end should come nearer
EFFORT = 0.1  # of the squared radius: what the inputs of a plan cost at most
LARGEST_CHANGE = 8.0  # of a rotation, |R' - R|_F^2, that of half a turn
FARTHEST = 4  # times the horizon, to look beyond it
COARSEST, FINEST = 0.25, 0.0625  # of a step: to what the time of a catch is looked for
TINY = 1e-9  # [m]
MEMORY = 256  # problems
SHARPEST = 0.5 * math.pi  # turn within a step: beyond it the way is a caricature


@dataclass(frozen=True)
class Intercept:
    """How soon the goal can be caught, as far as it is known.

    Attributes:
        time: when the plan catches it, from its start [s]; nan if no plan was found that does.
        bound: no trajectory of the problem's own steps catches it at the end of one before this
            time [s]; that of the first step past the horizon if none catches it at all. Where a
            catch between two ends is sooner, its time.
        sought: what both are about.
        counted: up to when the bound was verified by code that shares nothing with the solvers [s].
    """

    time: float
    bound: float
    sought: Sought
    counted: float

    @property
    def checked(self) -> bool:
        """Return whether all of the bound was verified."""
        return self.bound <= self.counted


def steps_before(bound: float, step: float) -> int:
    """Return how many steps [s] end before a time [s], but for rounding."""
    return max(0, math.ceil(bound / step - TINY) - 1)


def catching(problem: Problem, radius: float, end: float) -> Problem:
    """Return the problem of coming as close as possible to the goal at an end, counted in steps.

    Within a step all are shorter; beyond the horizon as many are longer, and turns within them are
    integrated, however the shorter ones are.
    """
    steps = min(math.ceil(end), problem.horizon)
    length = problem.step if end == steps else problem.step * end / steps
    how = 'exact' if end > steps else problem.discretisation
    change = LARGEST_CHANGE / length**2
    if problem.rotation_order == 2:
        change *= 4.0 / length**2  # a change, and back
    weights = Weights(0.0, EFFORT * radius**2 / (steps * change), 0.0, 1.0)
    return replace(problem, horizon=steps, step=length, discretisation=how, weights=weights)


class Target(NamedTuple):
    """When a goal is to be caught, counted in steps, and whether inside of the narrower cone."""

    end: float
    narrow: bool = False


@dataclass
class InterceptQuery:
    """What an intercept is looked for with."""

    task: Task  # of tracking the goal, without what moves
    motion: GoalMotion | None  # None where the goal is known at the ends of the task's steps alone
    now: float  # when the task begins, on the clock of the motion [s]
    pause: float = math.inf  # between ticks, in steps
    expected: float = 0.0  # the end at which the goal was to be caught, in steps; 0 or less if none
    most: float = math.inf  # plans that are tried
    tried: int = 0

    def late(self) -> bool:
        """Return whether time is up, or enough was tried."""
        late = self.task.late
        return self.tried >= self.most or (late is not None and late())


class _Attempt(NamedTuple):
    """A plan that comes as close to the goal at an end as was found, and whether none catches it.

    That none does is ``checked`` where it was verified.
    """

    found: tuple[Task, Answer] | None = None
    end: float = 0
    miss: float = math.inf
    never: bool = False
    checked: bool = False

    @property
    def plan(self) -> Plan | None:
        """Return the plan, if there is one."""
        return None if self.found is None else self.found[1][0]


MISSED = _Attempt()
NEVER = _Attempt(never=True)  # too far away, or nothing leads into the cone of approach
_miss = attrgetter('miss')


class Interception:
    """Looks for the earliest catch within a radius [m].

    Args:
        problem: what is solved where no catch is found, with the cone of approach of a catch.
        radius: within which the goal is caught [m].
        solver_for: makes a solver of a problem; ``enough`` as of :class:`Solver`.
        lag: of the speed [s].
        centred: whether a catch leads through the middle of the goal, with a little to spare.
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
        self._solver_for = solver_for
        self._tracked, self._radius, self._lag = problem, radius, lag
        self._centred = centred
        self._step, self._horizon = problem.step, problem.horizon
        self.farthest = _farthest(problem)
        self._finest = _finest(problem, radius)
        self._divides = problem.rotation_order == 1  # at order 2, what coasts does so for a step
        self._turns_within = problem.max_rate > 0.0 or problem.discretisation != 'euler'
        self._coned = problem.approach.exists
        self._aim = (NARROW if self._coned else AIM) * radius
        self.problem = lru_cache(maxsize=MEMORY)(self._problem)
        self.solver = lru_cache(maxsize=MEMORY)(self._solver)
        for end in range(1, self._horizon + 1):  # what nearly every search tries
            for narrow in (False, True) if self._coned else (False,):
                self.solver(Target(end, narrow))

    def _problem(self, target: Target) -> Problem:
        """Return the problem of :func:`catching` the goal."""
        made = catching(self._tracked, self._radius, target.end)
        if not target.narrow:
            return made
        return replace(made, approach=replace(made.approach, cone=NARROW * made.approach.cone))

    def enough(self, end: float) -> Enough:
        """Return what settles whether the goal is caught at an end.

        Past the horizon any way will do; within it the best one is wanted.
        """
        squared = self._radius**2
        well = self._well(end) ** 2 if end > self._horizon else -math.inf
        return Enough(well, (1.0 + EFFORT) * squared)

    def _solver(self, target: Target) -> Solver:
        return self._solver_for(self.problem(target), enough=self.enough(target.end))

    def earliest(self, query: InterceptQuery) -> tuple[tuple[Task, Answer] | None, Intercept]:
        """Return the task of the earliest catch with its answer, and how early one can be.

        Without a catch, None. Where the catch that was flown towards has just been lost by
        little, it is the task of the nearest miss, without a time.
        """
        # Past the horizon that takes a search, which comes first; elsewhere it may not be needed.
        held = self._held(query) if query.expected > self._horizon else None
        best, bound, counted = self._in_view(query)
        near = self._radius < best.miss <= GRAZE * self._radius
        goals = self._goals(query, self._horizon)
        sought = Sought(self._tracked, query.task.state, goals, self._radius)
        never = Intercept(math.nan, self._step * bound, sought, self._step * counted)
        if near and 0 < query.expected <= self._horizon:
            return best.found, never
        if best.miss > self._radius:  # not even nearly
            rest, kept = held or self._held(query)
            best = self._sooner(query, kept) if kept.plan else self._beyond(query)
            if best.plan is None:
                lost = rest if rest.miss <= GRAZE * self._radius else MISSED
                return lost.found, never
        if best.end == int(best.end) and self._is_well(best):
            best = self._within(query, best)
        if self._centred and self._is_well(best):
            best = self._through_the_middle(query, best)
        first = min(bound, best.end)
        known = self._step * min(counted, first)
        when = best.end if best.miss <= self._radius else math.nan
        catch = Intercept(self._step * when, self._step * first, sought, known)
        return best.found, catch

    def _goals(self, query: InterceptQuery, end: float) -> Array:
        """Return where the goal is at the ends of the steps up to an end, shape (N or less, n)."""
        known, motion = query.task.goals, query.motion
        if motion is None or (end <= len(known) and end == int(end)):
            return known[: int(end)]
        problem = self.problem(Target(end))
        return motion.at(query.now + problem.step * np.arange(1.0, problem.horizon + 1.0))

    def _last(self, query: InterceptQuery) -> int:
        """Return the last end at which a catch is looked for."""
        return len(query.task.goals) if query.motion is None else self.farthest

    def _in_view(self, query: InterceptQuery) -> tuple[_Attempt, int, int]:
        """Return the first catch in the horizon, or the nearest miss, and the bound in steps.

        Then up to where that was verified. Each end before the bound is proved to have no catch.
        """
        bound, counted, best = 1, 1, MISSED
        goals = self._goals(query, self._horizon)
        too_far = self._too_far(query.task.state, goals, self._tracked)
        surely = missed(self._tracked, query.task.state, goals, self._radius)
        moved = np.linalg.norm(np.diff(goals, axis=0), axis=1)
        # So far a step takes a vehicle past the goal at most.
        travel = self._step * self._tracked.forward + float(moved.max(initial=0.0))
        for end in range(1, self._horizon + 1):
            attempt = NEVER if too_far[end - 1] else self._tried(query, end, goals[:end])
            if self._is_well(attempt):
                return attempt, bound, counted
            bound += bound == end and attempt.never
            known = attempt.checked or bool(surely[end - 1])
            counted += counted == end and attempt.never and known
            if attempt.miss <= self._radius + travel:
                attempt = min(attempt, self._passing(query, end), key=_miss)
            best = min(best, attempt, key=_miss)
            if self._is_well(best):
                break
        return best, bound, counted

    def _flown_on(self, query: InterceptQuery) -> _Attempt:
        """Return what becomes of the goal when the plan before is flown to its end."""
        end = query.expected
        whole = end.is_integer()
        if not (0.0 < end <= self._last(query) and (whole or self._may(query, end))):
            return MISSED
        goals = self._goals(query, end)
        task = query.task.within(self.problem(Target(end)), goals)
        plan = task.rest
        if plan is None or not holds(*task.known, plan):
            return MISSED
        if _first_turn(plan) > max(whole, end / math.ceil(end)) * math.pi:
            return MISSED
        answer = plan, plan.status, 'the catch planned before is flown on'
        miss = float(np.linalg.norm(self._off(query, Target(end), plan, goals)))
        return _Attempt((task, answer), end, miss)

    def _held(self, query: InterceptQuery) -> tuple[_Attempt, _Attempt]:
        """Return what becomes of the goal when the plan before is flown on, and the catch to keep.

        That is the same or, where it misses past the horizon, a new plan for about the same time.
        """
        rest = self._flown_on(query)
        if rest.miss <= self._radius:
            return rest, rest
        end = COARSEST * math.ceil(query.expected / COARSEST)
        anew = self._surely(query, end) if end <= self._last(query) else MISSED
        return rest, anew if anew.plan is not None or rest.miss > GRAZE * self._radius else rest

    def _beyond(self, query: InterceptQuery) -> _Attempt:
        """Try to catch the goal past the horizon.

        How much later than so far is doubled until a catch is found, and then halved.
        """
        missed = max(self._horizon, min(math.ceil(query.expected), self._last(query)))
        for end in _doubling(missed, self._last(query)):
            found = self._surely(query, end)
            if found.plan is not None:
                return self._between(query, missed, found)
            missed = end
        return MISSED

    def _sooner(self, query: InterceptQuery, found: _Attempt) -> _Attempt:
        """Return a sooner catch than the one found, by twice as much each time, if there is one."""
        for away in (1, 2, 4, 8):
            sooner = self._surely(query, max(self._horizon, math.ceil(found.end) - away))
            if sooner.plan is None:
                break
            found = sooner
        return found

    def _between(self, query: InterceptQuery, missed: float, found: _Attempt) -> _Attempt:
        """Return the first catch that halving finds between a miss and a catch."""
        while found.end - missed > 1:
            middle = (missed + found.end) // 2
            sooner = self._surely(query, middle)
            if sooner.plan is None:
                missed = middle
            else:
                found = sooner
        return found

    def _within(self, query: InterceptQuery, found: _Attempt) -> _Attempt:
        """Return the first catch that halving finds within the step at whose end one is found."""
        away = 0.5
        while away >= self._finest:
            sooner = self._at(query, found.end - away, self._radius)
            if self._is_well(sooner):
                found = sooner
            away *= 0.5
        return found

    def _through_the_middle(self, query: InterceptQuery, found: _Attempt) -> _Attempt:
        """Return the catch that leads through the middle of the goal, if there is one.

        It ends at the same time, before the goal by what that is short of it, and a little more.
        """
        target, goals = Target(found.end, narrow=self._coned), self._goals(query, found.end)
        if found.plan is None or len(goals) < 2:  # too late to change much
            return found
        passed = np.diff(found.plan.positions[-2:], axis=0)[0] - np.diff(goals[-2:], axis=0)[0]
        ahead = passed / max(float(np.linalg.norm(passed)), TINY)
        off = self._off(query, target, found.plan, goals)
        short = max(min(0.0, float(off @ ahead)) - SLACK * self._aim, -AIM * self._radius)
        before = np.concatenate([goals[:-1], goals[-1:] + short * ahead])
        through = self._attempted(query, target, before, GRAZE * self._radius)
        if through.plan is None or not self._is_well(through):
            return found
        miss = float(np.linalg.norm(self._off(query, target, through.plan, goals)))
        if miss > self._radius:
            return found
        return found._replace(found=through.found, miss=miss)

    def _off(self, query: InterceptQuery, target: Target, plan: Plan, goals: Array) -> Array:
        """Return how far from the goal a vehicle ends that flies a plan, shape (n,) [m]."""
        astray = defect(self.problem(target), query.task.state, plan, self._lag)
        return np.asarray(plan.positions[-1] + astray - goals[-1])

    def _passing(self, query: InterceptQuery, end: int) -> _Attempt:
        """Return the first catch in the step before an end that has none, or the nearest miss."""
        best = MISSED
        for away in np.arange(1.0 - self._finest, 0.0, -self._finest):
            best = min(best, self._at(query, float(end - away), GRAZE * self._radius), key=_miss)
            if self._is_well(best):
                break
        return best

    def _at(self, query: InterceptQuery, end: float, near: float) -> _Attempt:
        """Try to catch the goal between the ends of steps, as in :meth:`_attempted`."""
        if not self._may(query, end):
            return MISSED
        found = self._at_end(query, end, near)
        if found.plan is not None and _first_turn(found.plan) > end / math.ceil(end) * math.pi:
            return MISSED
        return found

    def _may(self, query: InterceptQuery, end: float) -> bool:
        """Return whether a catch may be looked for between the ends of steps."""
        allowed = self._turns_within or end / math.ceil(end) >= query.pause
        return query.motion is not None and self._divides and allowed

    def _is_well(self, attempt: _Attempt) -> bool:
        return attempt.miss <= self._well(attempt.end)

    def _well(self, end: float) -> float:
        """Return within what a catch at an end is well within the radius [m]."""
        return self._aim if end <= self._horizon else NARROW * self._radius

    def _surely(self, query: InterceptQuery, end: float) -> _Attempt:
        """Try to come well within the radius at an end past the horizon."""
        if end <= self._horizon:
            return MISSED
        attempt = self._at_end(query, end, self._radius)
        return attempt if self._is_well(attempt) else MISSED

    def _at_end(self, query: InterceptQuery, end: float, near: float) -> _Attempt:
        """Try to catch the goal at any end, as in :meth:`_attempted`."""
        target, goals = Target(end, narrow=self._coned), self._goals(query, end)
        if self._too_far(query.task.state, goals, self.problem(target))[-1]:
            return NEVER
        return self._attempted(query, target, goals, near)

    def _tried(self, query: InterceptQuery, end: int, goals: Array) -> _Attempt:
        """Try to catch the goal at an end, given where it is at the steps that lead there.

        What only the wider cone allows is not well within, however close it comes.
        """
        near = GRAZE * self._radius
        if not self._coned:
            return self._attempted(query, Target(end), goals, near)
        within = self._attempted(query, Target(end, narrow=True), goals, near)
        if self._is_well(within):
            return within
        wider = self._attempted(query, Target(end), goals, near)
        wider = wider._replace(miss=max(wider.miss, self._radius))
        found = min(within, wider, key=_miss)
        return found._replace(never=wider.never, checked=wider.checked)

    def _attempted(
        self, query: InterceptQuery, target: Target, goals: Array, near: float
    ) -> _Attempt:
        """Try to catch the goal at an end, less the defect of the plans towards it.

        Plans are made again where they are expected to miss by less than the one before, and by no
        more than counts as ``near`` [m].
        """
        found, aims = MISSED, goals
        for _ in range(TRIES):
            if query.late():
                return found
            solver = self.solver(target)
            task = query.task.within(solver.problem, aims, solver)
            answer = task.solved()
            query.tried += 1
            plan, status, _ = answer
            if plan is None:
                return NEVER if status is Status.INFEASIBLE and aims is goals else found
            end = plan.positions[-1]
            astray = defect(self.problem(target), query.task.state, plan, self._lag)
            miss = float(np.linalg.norm(end + astray - goals[-1]))
            if aims is goals:  # what is proved is about the goal itself
                never = plan.proof.lower_bound > self.enough(target.end).bound
                found = _Attempt((task, answer), target.end, miss, never, plan.proof.checked)
            elif miss < found.miss:
                found = found._replace(found=(task, answer), miss=miss)
            left, change = aims[-1] - end, goals[-1] - astray - aims[-1]
            worth = min(near, miss - WORTH * self._radius)
            if self._is_well(found) or self._expected(target, left, change, miss) > worth:
                break
            aims = np.concatenate([goals[:-1], aims[-1:] + change])
        return found

    def _expected(self, target: Target, left: Array, change: Array, miss: float) -> float:
        """Return how near a plan will come to the goal if what is aimed at changes [m].

        To first order, where the last one, which ``left`` so much to its aim, came as near to it as
        any; no plan for an aim that changes by so much, which the defect does then too, is nearer
        than the ``miss`` by more than twice that.
        """
        away, size = math.sqrt(left @ left), math.sqrt(change @ change)
        if away <= self._well(target.end):  # where any way will do, there may be nearer ones
            return miss - 2.0 * size
        return float(away + change @ left / max(away, size))

    def _too_far(self, state: State, goals: Array, problem: Problem) -> np.ndarray:
        """Return at the end of which steps the goal is out of reach, even if R_0 were free.

        A goal that the first step passes is out of reach at its end, and met within it. The problem
        that is tracked tells it of all ends within the horizon at once.
        """
        reach = np.abs(problem.maps.reach).sum(axis=1)
        away = goals - drift(problem, state)
        return np.asarray(np.sqrt(np.einsum('kc,kc->k', away, away)) > reach + self._radius)


def _first_turn(plan: Plan) -> float:
    """Return the angle that a plan turns by in its first step [rad]."""
    return float(np.linalg.norm(log(plan.projected[0].T @ plan.projected[1])))


def _farthest(problem: Problem) -> int:
    """Return the last end, in steps, at which a catch is looked for.

    Steps get no longer where a box between their ends would not be seen.
    """
    if problem.rotation_order == 2 or problem.boxes:
        return problem.horizon
    longest = FARTHEST * problem.step
    if problem.max_rate:
        longest = min(longest, max(problem.step, SHARPEST / problem.max_rate))
    return int(problem.horizon * longest / problem.step)


def _finest(problem: Problem, radius: float) -> float:
    """Return the share of a step in which a vehicle flies no farther than a radius [m], bounded."""
    share = radius / (problem.step * problem.forward)
    return float(min(COARSEST, max(FINEST, 2.0 ** math.floor(math.log2(share)))))


def _doubling(first: int, last: int) -> Iterator[int]:
    """Return ends after ``first``, twice as far away each, and the last of all."""
    away = 1
    while first + away < last:
        yield first + away
        away *= 2
    if first < last:
        yield last


def defect(problem: Problem, state: State, plan: Plan, lag: float) -> Array:
    """Return how far from the end of a plan a vehicle gets that follows it, shape (n,) [m].

    Its speed has a ``lag`` [s]. Zero where thrust is an acceleration, where rates are commanded a
    step ahead, and with ``euler`` steps.
    """
    if problem.inertial or problem.rotation_order == 2 or problem.discretisation == 'euler':
        return np.zeros(problem.dimension)
    coasted = drift(problem, state)[-1]
    flown = _speeds(problem.step, plan.speed_fraction, lag) @ _means(plan.projected)
    way = problem.step * problem.forward * flown
    return np.asarray(coasted + way - plan.positions[-1])


def _means(attitudes: Array) -> Array:
    """Return the mean of the thrust axis in each step, (N, n), that turns evenly between them."""
    turns = np.swapaxes(attitudes[:-1], 1, 2) @ attitudes[1:]
    if turns.shape[-1] == 2:
        half = 0.5 * np.arctan2(turns[:, 1, 0], turns[:, 0, 0])
        reached = np.stack([np.cos(half), np.sin(half)], axis=1) * np.sinc(half / np.pi)[:, None]
    else:
        ahead = np.eye(3)[0]
        reached = np.array([turned(log(each), ahead)[0] for each in turns])
    return np.einsum('kij,kj->ki', attitudes[:-1], reached)


def _speeds(step: float, commanded: Array, lag: float) -> Array:
    """Return the mean share of full speed in each step, (N,), a lag behind commands, (N + 1,)."""
    left = math.exp(-step / lag) if lag else 0.0
    spread = lag / step * (1.0 - left)
    now, means = float(commanded[0]), []
    for wanted in commanded[1:].tolist():
        means.append(wanted + spread * (now - wanted))
        now = wanted + left * (now - wanted)
    return np.array(means)
