# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The true floor where the cost sees R e1 alone: a local optimum, and the proof that it is global.

That is all of R for n = 2. For n = 3 it takes an input weight of zero; the other columns are then
free, and are carried along by the shortest turns from one thrust axis to the next.

A local optimum is sought from the shifted previous plan, from the hull's optimum, then from all
around. Its own multipliers nearly always prove it global (:mod:`orbimpc_ros.mpc.kernels.annulus`),
or the best multipliers do (:mod:`orbimpc_ros.mpc.kernels.dual`). What those leave open, typically a
goal about to pass the vehicle, so that two ways round cost nearly the same, is settled in the plane
by branch and bound: the floor is cut into arcs, and beyond the chord of an arc the problem is
convex. With an arrival that takes many more arcs; what they leave open, and all of it in space, the
general search settles.

Mathematics: docs/mathematics.md, 4.4 to 4.6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import carried
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.annulus import (
    BOUND,
    COST,
    SLICE,
    TRIED,
    Annulus,
    Progress,
    begun,
    improve,
    improve_from_hull,
    multipliers_at,
)
from orbimpc_ros.mpc.kernels.dual import BOUND as RAISED
from orbimpc_ros.mpc.kernels.dual import ascent, climb, no_cuts, pull_at
from orbimpc_ros.mpc.model.condensed import LONGEST, Condensed
from orbimpc_ros.mpc.model.dynamics import adrift, first_length, length_weights
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.mpc.proof.tree import ProofTree
from orbimpc_ros.mpc.solve.arc_search import ArcSearch
from orbimpc_ros.mpc.solve.convexity import tangent
from orbimpc_ros.mpc.solve.hull_riccati import HullRiccati
from orbimpc_ros.mpc.solve.registry import General
from orbimpc_ros.mpc.solve.request import Found, Guess, Request

FURTHER_STARTS = 30
SETTLED = 90.0  # tolerances at which starts from all around, and searches, may stop
NODES, ARRIVING = 6400, 600  # of the search over arcs; with an arrival, before the general one
YOUNG, EVERY = 4, 4  # a local search starts from each of its first nodes, from then on from some
BRANCHES = 8000  # polls of the general search, where nobody waits for it
OUT_OF_REACH = 1e-9  # share of the way to an arrival
NOTHING = Found(None, np.inf, -np.inf, 0)


@dataclass(frozen=True)
class _Tick:
    """What one solve is about.

    Attributes:
        request: what is asked for.
        q: linear terms of the cost in the headings, shape (N, n).
        constant: the cost of headings of zero.
        left: what sum_k a_k z_k must come to, shape (n,) [m], or (0,) without an arrival.
    """

    request: Request
    q: Array
    constant: float
    left: Array

    @property
    def late(self) -> bool:
        return self.request.late


class AnnulusNewton:
    """Solves problems of rotation order 1 with a circular floor and no limits but a terminal one.

    Args:
        problem: what to solve.
        tolerance: relative gap at which a plan is good enough to stop.
    """

    takes_guess, trusts_guess = True, False  # anywhere is good enough to start from

    def __init__(self, problem: Problem, tolerance: float, *, coasting: bool = False) -> None:
        self._problem, self._tolerance = problem, tolerance
        self._condensed = Condensed(problem)
        self._arrives = problem.terminal == 'constraint'
        length, arrival = length_weights(problem)[1:], np.zeros(problem.horizon)
        if self._arrives:
            arrival = problem.maps.reach[-1, 1:].copy()
        hessian, floor = self._condensed.hessian, float(problem.floor.fraction)
        self._annulus = Annulus(hessian, length, arrival, floor)
        self._disks = Annulus(hessian, np.zeros(problem.horizon), arrival, 0.0)
        self._least_length = floor * float(length.sum())
        self._no_cuts = no_cuts(problem.dimension)
        self._arcs: ArcSearch | None = None
        if problem.dimension == 2:
            most = ARRIVING if self._arrives else NODES
            self._arcs = ArcSearch(self._annulus, SETTLED * tolerance, most)
        self._stages = [self._from_hull, self._from_dual]
        if self._arrives or self._arcs is None:
            self._stages.append(self._from_around)
        if self._arcs is not None:
            self._stages.append(self._by_arcs)
        searched = tolerance if self._arcs is None else SETTLED * tolerance
        self._general = General(problem, searched)
        self._hull = _long_hull(problem, tolerance)
        self._compile()

    def _compile(self) -> None:
        """Compile, or load what was compiled before: at start-up, not in a tick."""
        if not COMPILED:
            return
        q = np.ones((self._problem.horizon, self._problem.dimension))
        start = State.at(np.zeros(q.shape[1]), np.eye(q.shape[1]))
        left = np.zeros(q.shape[1] * self._arrives)
        request = Request(start, np.zeros(q.shape), out_of_time=lambda: True)
        tick = _Tick(request, q, 0.0, left)
        progress = begun(*q.shape)
        progress.proved[:] = q
        self._stationary(self._annulus, tick, progress)
        self._tangent(tick, q, -q[:, 0], left)
        self._from_dual(tick, self._from_hull(tick, NOTHING))
        if self._arcs is not None:
            self._by_arcs(tick, replace(NOTHING, x=q))

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether this method applies to a problem."""
        constrained = problem.terminal == 'constraint'
        arrives = constrained or problem.arrival_weight > 0.0
        decided = constrained and not problem.maps.reach[-1, 1:].any()  # the state arrives, or not
        return (
            (problem.floor.shape, problem.rotation_order) == ('circle', 1)
            and not (problem.inertial and arrives)
            and not decided
            and (problem.dimension == 2 or problem.weights.input == problem.weights.attitude == 0.0)
            and not (problem.max_rate or problem.obstacles or problem.has_cones)
            and not problem.approach.exists
        )

    def settles(self, found: Found) -> bool:
        """Return whether what was found is proved as well as searches do."""
        return found.x is not None and found.gap <= SETTLED * self._tolerance

    def solve(self, request: Request) -> Found:
        """Return the best trajectory found, with the best bound proved.

        Raises:
            Infeasible: no trajectory satisfies the constraints.
        """
        tick = self._tick(request)
        found = self._headings(tick)
        if found.x is not None and self._problem.dimension == 3:
            found = replace(found, x=coordinates(carried(request.state.attitude, found.x)))
        searched = self._arcs is not None and not self._arrives
        # To set the general search up takes longer than those with a deadline can wait.
        if self.settles(found) or searched or request.hurried:
            return found
        return self._by_branches(tick, found)

    def local(self, state: State, goals: Array, start: Array) -> Found:
        """Return where a local search ends, and the bound that its multipliers prove.

        Args:
            state: where the plan starts.
            goals: g_1..g_N, shape (N, n) [m].
            start: headings, shape (N, n), taken to the annulus first.
        """
        return self._from(self._tick(Request(state, goals)), NOTHING, start[None])

    def _tick(self, request: Request) -> _Tick:
        q, constant = self._condensed.affine(request.state, request.goals)
        return _Tick(request, q, constant, self._left(request.state, request.goals))

    def _headings(self, tick: _Tick) -> Found:
        """Return the best headings found, with the best bound proved."""
        found, guess = NOTHING, tick.request.guess
        if guess is not None:
            # A copy: code for arrays that are read-only or strided would be compiled in a tick.
            start = np.array(guess.x[None, :, : self._problem.dimension], order='C')
            found = self._from(tick, found, start)
            if found.gap <= self._tolerance:
                return found
        for stage in self._stages:
            found = stage(tick, found)
            if self.settles(found) or tick.late:
                break
        return found

    def _left(self, state: State, goals: Array) -> Array:
        problem = self._problem
        if not self._arrives:
            return np.zeros(0)
        reached = adrift(problem, state)[-1] + problem.maps.reach[-1, 0] * state.rotation[:, 0]
        left = np.asarray(goals[-1] - reached)
        reach = float(self._annulus.arrival.sum())
        if np.linalg.norm(left) > reach + OUT_OF_REACH * (reach or 1.0):
            raise Infeasible('the goal is out of reach')
        return left

    def _from(self, tick: _Tick, found: Found, starts: Array, more: int = 0) -> Found:
        """Return the better of what was found and where starts lead, shape (S, N, n), and more."""
        progress, annulus = begun(*tick.q.shape), self._annulus
        progress.numbers[BOUND] = found.lower_bound - tick.constant
        limit = (SETTLED if more else 1.0) * self._tolerance
        while not improve(
            annulus, tick.q, tick.left, tick.constant, starts, more, limit, progress, SLICE
        ):
            if tick.late:
                break
        proof = None
        if progress.numbers[BOUND] > found.lower_bound - tick.constant:
            proof = self._stationary(annulus, tick, progress)
        return _better(found, progress, tick.constant, proof)

    def _stationary(self, annulus: Annulus, tick: _Tick, progress: Progress) -> ProofTree:
        """Return the proof that the multipliers of a stationary point are."""
        known = tick.q, tick.left, progress.proved, progress.held
        return self._tangent(tick, progress.proved, *multipliers_at(annulus, *known))

    def _tangent(self, tick: _Tick, z: Array, theta: Array, nu: Array) -> ProofTree:
        """Return the proof that multipliers are, of moduli and of an arrival."""
        annulus = self._annulus
        return tangent(annulus.hessian, annulus.arrival, tick.left, z, theta, nu).proof()

    def _from_hull(self, tick: _Tick, found: Found) -> Found:
        """Start from the optimum over the disks without lengths, of which a floor's are certain."""
        if self._hull is not None:
            relaxed, _ = self._hull.relaxed(tick.request)
            assert relaxed.x is not None
            bound = relaxed.lower_bound + first_length(self._problem, tick.request.state)
            found = _raised(found, bound + self._least_length, proof=relaxed.proof)
            return self._from(tick, found, relaxed.x[None])
        hull, progress = begun(*tick.q.shape), begun(*tick.q.shape)
        progress.numbers[BOUND] = found.lower_bound - tick.constant
        floors, asked = (self._disks, self._annulus), (tick.q, tick.left, tick.constant)
        limits = self._least_length, self._tolerance
        while not improve_from_hull(*floors, *asked, *limits, hull, progress, SLICE):
            if tick.late:
                break
        at = (self._annulus, tick, progress)
        if progress.numbers[BOUND] <= hull.numbers[BOUND] + self._least_length:
            at = (self._disks, tick, hull)
        better = progress.numbers[BOUND] > found.lower_bound - tick.constant
        proof = self._stationary(*at) if better else None
        found = _better(found, progress, tick.constant, proof)
        # Where time ran out over the hull, that is still a start.
        return found if found.x is not None else self._from(tick, found, hull.best[None])

    def _from_dual(self, tick: _Tick, found: Found) -> Found:
        """Raise the bound by the best multipliers, and start from their Lagrangian's minimum."""
        enough = found.cost - SETTLED * self._tolerance * max(1e-9, abs(found.cost))
        known, none = found.lower_bound - tick.constant, self._no_cuts
        progress, asked = ascent(self._annulus, tick.q, none, known), (tick.q, tick.left, none)
        while not climb(self._annulus, *asked, enough - tick.constant, progress, float(SLICE)):
            if tick.late:
                break
        nu = pull_at(self._annulus, tick.q, tick.left, progress.theta, progress.z)
        proof = self._tangent(tick, progress.z, progress.theta, nu)
        found = _raised(found, float(progress.numbers[RAISED]) + tick.constant, proof=proof)
        return found if self.settles(found) else self._from(tick, found, progress.z[None])

    def _from_around(self, tick: _Tick, found: Found) -> Found:
        return self._from(tick, found, tick.q[None][:0], FURTHER_STARTS)

    def _by_arcs(self, tick: _Tick, found: Found) -> Found:
        """Return the better of what was found and where a search over arcs leads, with bound."""
        search, constant = self._arcs, tick.constant
        assert search is not None
        if found.x is None:  # without a cost to undercut, it would not end
            return found
        known = found.cost - constant, found.lower_bound - constant
        search.begin(tick.q, tick.left, constant, *known)
        ended, before = False, 0
        while not (ended or self.settles(found)):
            ended = search.run(tick.request.out_of_time)
            found = _raised(found, search.bound + constant, search.nodes - before)
            before = search.nodes
            if not (ended or self.settles(found)) and (before <= YOUNG or before % EVERY == 0):
                found = self._from(tick, found, search.last[None])
                search.beat(found.cost - constant)
        return found if found.proof is not None else replace(found, proof=search.proof())

    def _by_branches(self, tick: _Tick, found: Found) -> Found:
        """Return the better of what was found and where the general search leads."""
        guess = None if found.x is None else Guess(found.x, found.cost)
        asked = iter(range(BRANCHES))
        other = self._general.solve(
            tick.request._replace(guess=guess, out_of_time=lambda: next(asked, None) is None)
        )
        best = other if other.cost < found.cost else found
        known = replace(found, x=best.x, cost=best.cost)
        raised = _raised(known, other.lower_bound, other.nodes)
        better = other.lower_bound > found.lower_bound
        return replace(raised, proof=other.proof) if better else raised


def _long_hull(problem: Problem, tolerance: float) -> HullRiccati | None:
    """Return the method for a hull over a horizon too long for dense code, where there is one."""
    free = replace(problem, floor=Floor(), weights=replace(problem.weights, length=0.0))
    return (
        HullRiccati(free, tolerance)
        if problem.horizon > LONGEST and HullRiccati.solves(free)
        else None
    )


def _raised(found: Found, bound: float, nodes: int = 0, proof: ProofTree | None = None) -> Found:
    """Return what was found with a bound that may be better, after so many more nodes."""
    nodes += found.nodes
    if bound > found.lower_bound:
        return replace(found, lower_bound=bound, nodes=nodes, proof=proof)
    return replace(found, nodes=nodes)


def _better(found: Found, progress: Progress, constant: float, proof: ProofTree | None) -> Found:
    """Return the cheaper of what was found and what a local search came to, with its bound.

    Args:
        found: before.
        progress: of the local search.
        constant: what its costs lack.
        proof: of its bound.
    """
    cost, bound = progress.numbers[COST] + constant, progress.numbers[BOUND] + constant
    if cost < found.cost:
        found = replace(found, x=progress.best, cost=float(cost))
    return _raised(found, float(bound), int(progress.counts[TRIED]), proof)
