"""Interception: the earliest step of a plan that can catch the goal, and that none before it can.

To be near a goal on average is not to touch it. For each step k that the goal is within reach of, a
problem of k steps asks for the least miss |s_k - g_k|, and next to nothing else:

    minimise |s_k - g_k|^2 + r (|u_0|^2 + ... + |u_{k-1}|^2),

with r so small that the inputs of no trajectory cost more than a share of the squared radius.
Whatever catches the goal at step k then costs at most (1 + share) radius^2: a greater lower bound
proves that nothing does. The first step whose plan comes well within the radius is aimed at.

Mathematics: docs/mathematics.md, 7.10.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.dynamics import drift
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem, State, Weights

AIM = 0.5  # of the radius: what a plan must come within, so that gusts leave some of it
EFFORT = 0.1  # of the squared radius: what the inputs of a plan cost at most
LARGEST_CHANGE = 8.0  # of a rotation, |R' - R|_F^2, that of half a turn


@dataclass(frozen=True)
class Catch:
    """How soon the goal can be caught, as far as it is known.

    Attributes:
        step: k, at whose end the plan catches the goal; 0 if none does within the horizon.
        bound: no trajectory catches it at the end of any step before this one.
    """

    step: int
    bound: int


def catching(problem: Problem, radius: float, step: int) -> Problem:
    """Return the problem of coming as close as possible to the goal within so many steps.

    Args:
        problem: what is solved where nothing is to be caught.
        radius: within which the goal is caught [m].
        step: k, at whose end.
    """
    change = LARGEST_CHANGE / problem.step**2
    if problem.rotation_order == 2:
        change *= 4.0 / problem.step**2  # a change, and back
    effort = EFFORT * radius**2 / (step * change)
    return replace(problem, horizon=step, weights=Weights(0.0, effort, 0.0, 1.0))


class Interception:
    """Looks for the earliest catch.

    Args:
        problem: what is solved where nothing is caught within the horizon.
        radius: within which the goal is caught [m].
    """

    def __init__(self, problem: Problem, radius: float) -> None:
        self._radius = radius
        self._reach = np.abs(problem.maps.reach).sum(axis=1)
        self.problems = tuple(
            catching(problem, radius, step) for step in range(1, problem.horizon + 1)
        )

    def earliest(
        self,
        state: State,
        goals: Array,
        solved: Callable[[int], Plan | None],
        late: Callable[[], bool],
    ) -> tuple[Plan | None, Catch]:
        """Return the plan of the earliest catch, if one is found, and how early one can be.

        Args:
            state: where the plan starts.
            goals: g_1..g_N, shape (N, n) [m].
            solved: returns a checked plan for the problem of so many steps, if there is one.
            late: returns whether time is up; what is found by then counts.
        """
        bound, open_ = 1, True
        for step, reachable in enumerate(self._within_reach(state, goals), 1):
            plan = None
            if reachable:
                plan = None if late() else solved(step)
                if plan is not None and self._miss(plan, goals) <= AIM * self._radius:
                    return plan, Catch(step, bound)
                open_ = open_ and plan is not None and self._excluded(plan)
            bound = step + 1 if open_ else bound
        return None, Catch(0, bound)

    def _within_reach(self, state: State, goals: Array) -> Array:
        """Return at which steps the goal is not too far away, whatever the headings, shape (N,)."""
        away = np.linalg.norm(goals - drift(self.problems[-1], state)[: len(goals)], axis=1)
        return np.asarray(away <= self._reach[: len(goals)] + self._radius)

    def _miss(self, plan: Plan, goals: Array) -> float:
        return float(np.linalg.norm(plan.positions[-1] - goals[plan.horizon - 1]))

    def _excluded(self, plan: Plan) -> bool:
        """Return whether a plan's lower bound is more than any catch costs."""
        return plan.lower_bound > (1.0 + EFFORT) * self._radius**2
