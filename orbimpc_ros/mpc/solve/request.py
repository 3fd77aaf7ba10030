# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Solution methods: a request in, a trajectory and its bound out; the fastest one for a problem.

Mathematics: docs/mathematics.md, 4.1.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import starmap
from typing import Any, NamedTuple, Protocol

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.tree import ProofTree

# (module, class). The first one whose ``solves`` returns True is chosen, else the general one.
# Modules are imported one by one, since the later ones take longer to import.
METHODS = [('search.engine', 'PlanarSearch'), ('search.round_floor', 'RoundFloor')]
GENERAL = ('solve.branch_and_bound', 'BranchAndBound')
PACED = ('solve.paced_speeds', 'PacedSpeeds')  # imports Clarabel, hence only with max_acceleration


class Enough(NamedTuple):
    """Early stopping criteria of a search.

    Attributes:
        cost: stop at a trajectory that costs no more than this.
        bound: stop as soon as the lower bound exceeds this.
    """

    cost: float = -math.inf
    bound: float = math.inf

    def met(self, result: Found) -> bool:
        """Return True if a search with this result may stop."""
        return result.cost <= self.cost or result.lower_bound > self.bound


class Request(NamedTuple):
    """The input of a method; a tuple because one is created at every tick.

    Attributes:
        state: initial state of the plan.
        goals: g_1..g_N, shape (N, n) [m].
        guess: warm start from this state: rotation coordinates of R_1..R_N, shape (N, d), which
            may violate constraints.
        out_of_time: polled between iterations; once it returns True, the method returns its best
            result so far. None: no deadline.
        patient: whether the deadline leaves time to set up slower methods.
        enough: early stopping criteria, which a method may ignore.
        rounds: most rounds of a search: nodes of the general one, milliseconds of those over stage
            sets.
    """

    state: State
    goals: Array
    guess: Array | None = None
    out_of_time: Callable[[], bool] | None = None
    patient: bool = False
    enough: Enough = Enough()
    rounds: float = math.inf

    @property
    def hurried(self) -> bool:
        """Return True if the deadline leaves no time for slower methods."""
        return self.out_of_time is not None and not self.patient

    @property
    def late(self) -> bool:
        """Return True if the deadline has passed."""
        return self.out_of_time is not None and self.out_of_time()


@dataclass(frozen=True)
class Found:
    """The result of a method.

    Attributes:
        x: rotation coordinates of R_1..R_N, shape (N, d); None if no trajectory was found.
        cost: of that trajectory, inf without one.
        lower_bound: on the cost of every trajectory.
        nodes: number of relaxations or local problems solved.
        reason: why no trajectory was found, or why it is not proved optimal.
        proofs: trees that prove bounds, in the units of the request; the first one that there is
            time to verify counts.
    """

    x: Array | None = None
    cost: float = math.inf
    lower_bound: float = -math.inf
    nodes: int = 0
    reason: str = ''
    proofs: tuple[ProofTree, ...] = ()

    @property
    def gap(self) -> float:
        """Return (cost - lower bound) / max(1e-9, |cost|); infinite if either is not finite."""
        if not (math.isfinite(self.cost) and math.isfinite(self.lower_bound)):
            return math.inf
        return (self.cost - self.lower_bound) / max(1e-9, abs(self.cost))


class Method(Protocol):
    """A solver of one problem for any state and goals.

    Attributes:
        takes_guess: whether the method benefits from a warm start.
    """

    takes_guess: bool

    def solve(self, request: Request) -> Found:
        """Return the best trajectory found and the lower bound.

        Raises:
            Infeasible: it was proved that no trajectory satisfies the constraints.
            SolverFailure: neither a trajectory nor a bound was found.
        """


def method_for(
    problem: Problem, tolerance: float, *, coasting: bool = False, among: bool = False
) -> Method:
    """Return the fastest method for a problem in natural units, compiled for it.

    Args:
        problem: what to solve.
        tolerance: relative gap at which a search stops.
        coasting: whether states come with a ``coasted`` rotation.
        among: whether states come with hazards, which only the last method handles.
    """
    options = {'among': True} if among else {}
    for place in [PACED] * bool(problem.max_acceleration) + METHODS * (not among) + [GENERAL]:
        method = _imported(*place)
        if among or place == GENERAL or method.solves(problem, coasting=coasting):
            break
    made: Method = method(problem, tolerance, coasting=coasting, **options)
    return made


def bodiless(problem: Problem, tolerance: float, *, coasting: bool) -> Any:
    """Return the search over stage sets for a problem without its bodies; None without one.

    In space, its cost is that of R e1 alone: no other column's is negative.
    """
    alone, methods = replace(problem, obstacles=()), starmap(_imported, METHODS)
    asked = alone
    if problem.dimension == 3:
        asked = replace(alone, weights=replace(problem.weights, input=0.0, attitude=0.0))
    fitting = (method for method in methods if method.solves(asked, coasting=coasting))
    return next((method(alone, tolerance) for method in fitting), None)


def _imported(place: str, name: str) -> Any:
    return getattr(import_module(f'orbimpc_ros.mpc.{place}'), name)
