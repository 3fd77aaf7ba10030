"""Interception: the earliest step of a plan that can catch the goal, and that none before it can.

To be near a goal on average is not to touch it. For each step k that the goal is within reach of, a
problem of k steps asks for the least miss |s_k - g_k|, and next to nothing else:

    minimise |s_k - g_k|^2 + r (|u_0|^2 + ... + |u_{k-1}|^2),

with r so small that the inputs of no trajectory cost more than a share of the squared radius.
Whatever catches the goal at step k then costs at most (1 + share) radius^2: a greater lower bound
proves that nothing does. The first step whose plan comes well within the radius is aimed at, or
else the one whose plan comes closest, if that is within the radius.

Where no step of the horizon has a catch, one is looked for beyond it, by as many steps that are
longer. A vehicle that cannot stop finds so the way out and back to a goal inside its smallest
circle. It keeps to the time at which it means to catch the goal, unless it can be sooner: whoever
looks anew each time for any way that leads there may put it off for ever.

Mathematics: docs/mathematics.md, 7.10.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.dynamics import drift
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem, State, Weights
from orbimpc_ros.mpc.solve.request import Enough

AIM = 0.5  # of the radius: what a plan must come within, so that gusts leave some of it
EFFORT = 0.1  # of the squared radius: what the inputs of a plan cost at most
LARGEST_CHANGE = 8.0  # of a rotation, |R' - R|_F^2, that of half a turn
FARTHEST = 4  # times the horizon, to look beyond it
SHARPEST = 0.5 * math.pi  # turn within a step: beyond it the way is a caricature


@dataclass(frozen=True)
class Catch:
    """How soon the goal can be caught, as far as it is known.

    Attributes:
        time: when the plan catches it, from its start [s]; nan if no plan was found that does.
        bound: no trajectory of the problem's own steps catches it at the end of one before this
            time [s]; that of the first step past the horizon if none catches it at all.
    """

    time: float
    bound: float


def catching(problem: Problem, radius: float, end: int) -> Problem:
    """Return the problem of coming as close as possible to the goal at a time.

    Args:
        problem: what is solved where nothing is to be caught.
        radius: within which the goal is caught [m].
        end: when, counted in steps of ``problem``; beyond its horizon as many steps are longer,
            and turns within them are integrated, however the shorter ones are.
    """
    steps = min(end, problem.horizon)
    length, how = problem.step, problem.discretisation
    if end > steps:
        length, how = problem.step * end / steps, 'exact'
    change = LARGEST_CHANGE / length**2
    if problem.rotation_order == 2:
        change *= 4.0 / length**2  # a change, and back
    weights = Weights(0.0, EFFORT * radius**2 / (steps * change), 0.0, 1.0)
    return replace(problem, horizon=steps, step=length, discretisation=how, weights=weights)


@dataclass(frozen=True)
class Hunt:
    """What an interception is looked for with, ends being counted in steps from the start.

    Attributes:
        state: where the plan starts.
        goals: returns where the goal is at the ends of the steps that lead to an end, shape
            (N or less, n) [m].
        solved: returns a checked plan for the problem of an end and its goals, if there is one.
        late: returns whether time is up; what is found by then counts.
        farthest: the last end that the goal is known at.
        expected: the end at which the goal was to be caught so far; 0 if none.
    """

    state: State
    goals: Callable[[int], Array]
    solved: Callable[[int, Array], Plan | None]
    late: Callable[[], bool]
    farthest: int
    expected: int = 0


class Interception:
    """Looks for the earliest catch.

    Args:
        problem: what is solved where no catch is found.
        radius: within which the goal is caught [m].

    Attributes:
        farthest: the last end at which a catch is looked for.
    """

    def __init__(self, problem: Problem, radius: float) -> None:
        self._radius, self._step, self._horizon = radius, problem.step, problem.horizon
        self.farthest = _farthest(problem)
        ends = range(1, self.farthest + 1)
        self._problems = [catching(problem, radius, end) for end in ends]
        self._reach = [float(np.abs(each.maps.reach[-1]).sum()) for each in self._problems]

    def problem(self, end: int) -> Problem:
        """Return the problem of :func:`catching` the goal at an end."""
        return self._problems[end - 1]

    def enough(self, end: int) -> Enough:
        """Return what settles whether the goal is caught at an end.

        Past the horizon any way will do; within it the best one is wanted.
        """
        squared = self._radius**2
        well = AIM**2 * squared if end > self._horizon else -math.inf
        return Enough(well, (1.0 + EFFORT) * squared)

    def earliest(self, hunt: Hunt) -> tuple[Plan | None, Catch]:
        """Return the plan of the earliest catch, if one is found, and how early one can be."""
        kept = self._kept(hunt)  # first of all: time may run out
        bound, excluded, best = 1, True, MISSED
        for end in range(1, self._horizon + 1):
            attempt = self._tried(hunt, end)
            best = min(best, attempt, key=_miss)
            if best.miss <= AIM * self._radius:
                break
            excluded = excluded and attempt.never
            bound = end + 1 if excluded else bound
        if best.miss > self._radius:  # not even nearly
            best = self._sooner(hunt, kept) if kept.plan else self._beyond(hunt)
        caught = self._step * best.end if best.plan else math.nan
        return best.plan, Catch(caught, self._step * bound)

    def _kept(self, hunt: Hunt) -> _Attempt:
        """Try to catch the goal past the horizon when it was to be caught so far."""
        awaited = self._horizon < hunt.expected <= hunt.farthest
        return self._surely(hunt, hunt.expected) if awaited else MISSED

    def _beyond(self, hunt: Hunt) -> _Attempt:
        """Try to catch the goal past the horizon.

        How much later than so far is doubled until a catch is found, and then halved.
        """
        missed = max(self._horizon, min(hunt.expected, hunt.farthest))
        for end in _doubling(missed, hunt.farthest):
            found = self._surely(hunt, end)
            if found.plan is not None:
                return self._between(hunt, missed, found)
            missed = end
        return MISSED

    def _sooner(self, hunt: Hunt, found: _Attempt) -> _Attempt:
        """Return a sooner catch than the one found, by twice as much each time, if there is one."""
        for away in (1, 2, 4, 8):
            sooner = self._surely(hunt, max(self._horizon, found.end - away))
            if sooner.plan is None:
                break
            found = sooner
        return found

    def _between(self, hunt: Hunt, missed: int, found: _Attempt) -> _Attempt:
        """Return the first catch that halving finds between a miss and a catch."""
        while found.end - missed > 1:
            middle = (missed + found.end) // 2
            sooner = self._surely(hunt, middle)
            if sooner.plan is None:
                missed = middle
            else:
                found = sooner
        return found

    def _surely(self, hunt: Hunt, end: int) -> _Attempt:
        """Try to come well within the radius at an end past the horizon."""
        attempt = self._tried(hunt, end) if end > self._horizon else MISSED
        return attempt if attempt.miss <= AIM * self._radius else MISSED

    def _tried(self, hunt: Hunt, end: int) -> _Attempt:
        """Try to catch the goal at an end."""
        goals = hunt.goals(end)
        coasted = drift(self.problem(end), hunt.state)[-1]
        if np.linalg.norm(goals[-1] - coasted) > self._reach[end - 1] + self._radius:
            return MISSED._replace(never=True)  # too far away, whatever the headings
        plan = None if hunt.late() else hunt.solved(end, goals)
        if plan is None:
            return MISSED
        miss = float(np.linalg.norm(plan.positions[-1] - goals[-1]))
        return _Attempt(plan, end, miss, plan.lower_bound > self.enough(end).bound)


class _Attempt(NamedTuple):
    """A plan that comes as close to the goal at an end as was found, and whether none catches it.

    Without a plan, it misses by infinity, and the end is 0.
    """

    plan: Plan | None = None
    end: int = 0
    miss: float = math.inf
    never: bool = False


MISSED = _Attempt()
_miss = attrgetter('miss')


def _farthest(problem: Problem) -> int:
    """Return the last end, in steps, at which a catch is looked for.

    Steps get no longer where a box between their ends would not be seen.
    """
    if problem.rotation_order == 2 or problem.obstacles:
        return problem.horizon
    longest = FARTHEST * problem.step
    if problem.max_rate:
        longest = min(longest, max(problem.step, SHARPEST / problem.max_rate))
    return int(problem.horizon * longest / problem.step)


def _doubling(first: int, last: int) -> Iterator[int]:
    """Return ends after ``first``, twice as far away each, and the last of all."""
    away = 1
    while first + away < last:
        yield first + away
        away *= 2
    if first < last:
        yield last
