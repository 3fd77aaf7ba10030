# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The interface of solution methods: a request in, a trajectory and its bound out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.tree import ProofTree


@dataclass(frozen=True)
class Guess:
    """A trajectory from the present state; it satisfies every constraint if the method trusts it.

    Attributes:
        x: rotation coordinates of R_1..R_N, shape (N, d).
        cost: its objective, for a method that trusts it; else infinite.
    """

    x: Array
    cost: float


class Enough(NamedTuple):
    """When a search may stop before it is proved how good its trajectory is.

    Attributes:
        cost: a trajectory that costs no more is good enough.
        bound: where none costs less than this, it no longer matters how much the best one does.
    """

    cost: float = -math.inf
    bound: float = math.inf

    def met(self, found: Found) -> bool:
        """Return whether a search that has found so much may stop."""
        return found.cost <= self.cost or found.lower_bound > self.bound


NEVER_ENOUGH = Enough()


class Request(NamedTuple):
    """What a method is asked for; a tuple, for one is made at every tick.

    Attributes:
        state: where the plan starts.
        goals: g_1..g_N, shape (N, n) [m].
        guess: a trajectory to start from.
        out_of_time: polled between steps; True makes a method return the best so far. None lets it
            take as long as it needs.
        patient: whether the deadline leaves time to set up slower methods.
        enough: what may end a search sooner; a method is free to go on.
    """

    state: State
    goals: Array
    guess: Guess | None = None
    out_of_time: Callable[[], bool] | None = None
    patient: bool = False
    enough: Enough = NEVER_ENOUGH

    @property
    def hurried(self) -> bool:
        """Return whether there is a deadline too near for slower methods."""
        return self.out_of_time is not None and not self.patient

    @property
    def late(self) -> bool:
        """Return whether the deadline has passed."""
        return self.out_of_time is not None and self.out_of_time()


@dataclass(frozen=True)
class Found:
    """What a method found and proved.

    Attributes:
        x: rotation coordinates of R_1..R_N, shape (N, d); None if no trajectory was found.
        cost: of that trajectory, inf if there is none.
        lower_bound: no trajectory costs less.
        nodes: relaxations or local problems solved.
        reason: why there is no trajectory.
        proof: the tree that proves the bound, in the units of the request; None where there is
            none.
    """

    x: Array | None
    cost: float
    lower_bound: float
    nodes: int
    reason: str = ''
    proof: ProofTree | None = None

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

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether the method applies to a problem, and is fast on this machine."""

    def solve(self, request: Request) -> Found:
        """Return the best trajectory found with the bound proved.

        Raises:
            Infeasible: proved that no trajectory satisfies the constraints.
            SolverFailure: nothing could be found or proved.
        """
