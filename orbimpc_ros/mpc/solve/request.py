"""The interface of a solution method: a guess in, a trajectory and its bound out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import State


@dataclass(frozen=True)
class Guess:
    """A trajectory from the present state; it satisfies every constraint if the method trusts it.

    Attributes:
        x: rotation coordinates of R_1..R_N, shape (N, d).
        cost: its objective, evaluated for the present state and goals.
    """

    x: Array
    cost: float


@dataclass(frozen=True)
class Found:
    """What a method found and proved.

    Attributes:
        x: rotation coordinates of R_1..R_N, shape (N, d); None if no trajectory was found.
        cost: of that trajectory, inf if there is none.
        lower_bound: no trajectory costs less.
        nodes: relaxations or local problems solved.
        reason: why there is no trajectory.
    """

    x: Array | None
    cost: float
    lower_bound: float
    nodes: int
    reason: str = ''

    @property
    def gap(self) -> float:
        """Return (cost - lower bound) / max(1e-9, |cost|); infinite where either is missing."""
        if not (math.isfinite(self.cost) and math.isfinite(self.lower_bound)):
            return math.inf
        return (self.cost - self.lower_bound) / max(1e-9, abs(self.cost))


class Method(Protocol):
    """Solves one problem for any state and goals.

    Attributes:
        takes_guess: whether a guess is worth making.
        trusts_guess: whether it relies on the guess to satisfy every constraint.
    """

    takes_guess: bool
    trusts_guess: bool

    def solve(
        self,
        state: State,
        goals: Array,
        guess: Guess | None,
        out_of_time: Callable[[], bool] | None,
    ) -> Found:
        """Return the best trajectory found with the bound proved.

        Args:
            state: where the plan starts.
            goals: g_1..g_N, shape (N, n) [m].
            guess: a feasible trajectory to start from.
            out_of_time: polled between steps; True returns the best so far.

        Raises:
            Infeasible: proved that no trajectory satisfies the constraints.
            SolverFailure: nothing could be found or proved.
        """
