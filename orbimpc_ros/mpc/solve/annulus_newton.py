"""The true floor where the cost sees R e1 alone: a local optimum, and the proof that it is global.

That is all of R for n = 2. For n = 3 it takes an input weight of zero; the other columns are then
free, and are carried along by the shortest turns from one thrust axis to the next.

A local optimum is sought from the shifted previous plan, from the hull's optimum, then from all
around. Its own multipliers nearly always prove it global (:mod:`orbimpc_ros.mpc.kernels.annulus`),
or the best multipliers do (:mod:`orbimpc_ros.mpc.kernels.dual`). What those leave open, typically a
goal about to pass the vehicle, so that two ways round cost nearly the same, is settled in the plane
by branch and bound: the floor is cut into arcs, and beyond the chord of an arc the problem is
convex. With an arrival, and in space, the general search does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.cells import arcs
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
    relax,
)
from orbimpc_ros.mpc.kernels.dual import SMALLEST, climb
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.model.condensed import LONGEST, Condensed, first_length
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.mpc.solve.cell_tree import CellSearch
from orbimpc_ros.mpc.solve.general import General
from orbimpc_ros.mpc.solve.hull_riccati import Hull
from orbimpc_ros.mpc.solve.request import Found, Guess

FURTHER_STARTS = 30
SETTLED = 50.0  # tolerances at which starts from all around, and searches, may stop
NODES = 25_600  # of the search over arcs
BRANCHES = 8000  # polls of the general search, where nobody waits for it
CLIMBS = 60  # Newton steps up the dual function
TINY = 1e-300
OUT_OF_REACH = 1e-9  # share of the way to an arrival
NOTHING = Found(None, np.inf, -np.inf, 0)


@dataclass(frozen=True)
class _Tick:
    """What one solve is about.

    Attributes:
        state: where the plan starts.
        goals: g_1..g_N, shape (N, n) [m].
        q: linear terms of the cost in the headings, shape (N, n).
        constant: the cost of headings of zero.
        left: what sum_k a_k z_k must come to, shape (n,) [m], or (0,) without an arrival.
        out_of_time: as the caller gave it.
    """

    state: State
    goals: Array
    q: Array
    constant: float
    left: Array
    out_of_time: Callable[[], bool] | None

    @property
    def late(self) -> bool:
        return self.out_of_time is not None and self.out_of_time()


class Circle:
    """Solves problems of rotation order 1 with a circular floor and no limits but a terminal one.

    Args:
        problem: what to solve.
        tolerance: relative gap at which a plan is good enough to stop.
    """

    takes_guess, trusts_guess = True, False  # anywhere is good enough to start from

    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._problem, self._tolerance = problem, tolerance
        self._condensed = Condensed(problem)
        self._arrives = problem.terminal == 'constraint'
        spent = problem.weights.length * problem.step * problem.forward
        length, arrival = np.full(problem.horizon, spent), np.zeros(problem.horizon)
        length[-1] = 0.0
        if self._arrives:
            arrival = dynamics.position_map(problem)[-1, 1:].copy()
        hessian, floor = self._condensed.hessian, float(problem.floor.fraction)
        self._annulus = Annulus(hessian, length, arrival, floor)
        self._disks = Annulus(hessian, np.zeros(problem.horizon), arrival, 0.0)
        self._least_length = floor * float(length.sum())
        self._arcs: CellSearch | None = None
        if problem.dimension == 2 and not self._arrives:
            self._arcs = CellSearch(hessian, arcs(floor), SETTLED * tolerance, NODES)
        self._general = General(problem, SETTLED * tolerance)
        self._hull = _long_hull(problem, tolerance)
        self._compile()

    def _compile(self) -> None:
        """Compile, or load what was compiled before: at start-up, not in a tick."""
        if not COMPILED:
            return
        q = np.ones((self._problem.horizon, self._problem.dimension))
        start = State.at(np.zeros(q.shape[1]), np.eye(q.shape[1]))
        left = np.zeros(q.shape[1] * self._arrives)
        tick = _Tick(start, np.zeros(q.shape), q, 0.0, left, lambda: True)
        self._from_dual(tick, self._from_hull(tick, NOTHING))
        if self._arcs is not None:
            self._by_arcs(tick, NOTHING)

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether this method applies to a problem."""
        arrives = problem.terminal == 'constraint' or problem.arrival_weight > 0.0
        return (
            problem.floor.shape == 'circle'
            and problem.rotation_order == 1
            and (problem.translation_order == 1 or not arrives)
            and (problem.dimension == 2 or problem.weights.input == 0.0)
            and problem.max_rate == 0.0
            and not problem.obstacles
        )

    def settles(self, found: Found) -> bool:
        """Return whether what was found is proved as well as searches do."""
        return found.x is not None and found.gap <= SETTLED * self._tolerance

    def solve(
        self,
        state: State,
        goals: Array,
        guess: Guess | None = None,
        out_of_time: Callable[[], bool] | None = None,
    ) -> Found:
        """Return the best trajectory found, with the best bound proved.

        Args:
            state: where the plan starts.
            goals: g_1..g_N, shape (N, n) [m].
            guess: a trajectory to start from.
            out_of_time: polled every millisecond or so; True returns the best so far.

        Raises:
            Infeasible: no trajectory satisfies the constraints.
        """
        q, constant = self._condensed.affine(state, goals)
        tick = _Tick(state, goals, q, constant, self._left(state, goals), out_of_time)
        found = self._headings(tick, guess)
        if found.x is not None and self._problem.dimension == 3:
            found = replace(found, x=coordinates(carried(state.attitude, found.x)))
        # To set the general search up takes longer than those with a deadline can wait.
        if self.settles(found) or self._arcs is not None or out_of_time is not None:
            return found
        return self._by_branches(tick, found)

    def local(self, state: State, goals: Array, start: Array) -> Found:
        """Return where a local search ends, and the bound that its multipliers prove.

        Args:
            state: where the plan starts.
            goals: g_1..g_N, shape (N, n) [m].
            start: headings, shape (N, n), taken to the annulus first.
        """
        q, constant = self._condensed.affine(state, goals)
        tick = _Tick(state, goals, q, constant, self._left(state, goals), None)
        return self._from(tick, NOTHING, start[None])

    def _headings(self, tick: _Tick, guess: Guess | None) -> Found:
        """Return the best headings found, with the best bound proved."""
        found = NOTHING
        if guess is not None:
            # A copy: code for arrays that are read-only or strided would be compiled in a tick.
            start = np.array(guess.x[None, :, : self._problem.dimension], order='C')
            found = self._from(tick, found, start)
            if found.gap <= self._tolerance:
                return found
        for stage in (self._from_hull, self._from_dual, self._from_around):
            found = stage(tick, found)
            if self.settles(found) or tick.late:
                return found
        return found if self._arcs is None else self._by_arcs(tick, found)

    def _left(self, state: State, goals: Array) -> Array:
        problem = self._problem
        if not self._arrives:
            return np.zeros(0)
        reached = state.position + problem.step * problem.forward * state.rotation[:, 0]
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
        return _better(found, progress, tick.constant)

    def _from_hull(self, tick: _Tick, found: Found) -> Found:
        """Start from the optimum over the disks without lengths, of which a floor's are certain."""
        if self._hull is not None:
            relaxed, _ = self._hull.relaxed(tick.state, tick.goals, tick.out_of_time)
            assert relaxed.x is not None
            start, bound = relaxed.x, relaxed.lower_bound
            bound += first_length(self._problem, tick.state)
        else:
            progress = begun(*tick.q.shape)
            while not relax(self._disks, tick.q, tick.left, progress, SLICE):
                if tick.late:
                    break
            start, bound = progress.best, float(progress.numbers[BOUND]) + tick.constant
        bound = max(found.lower_bound, bound + self._least_length)
        return self._from(tick, replace(found, lower_bound=bound), start[None])

    def _from_dual(self, tick: _Tick, found: Found) -> Found:
        """Raise the bound by the best multipliers, and start from their Lagrangian's minimum."""
        q = tick.q
        scale = float(np.abs(q).max() + np.abs(self._annulus.hessian).max()) + TINY
        theta, z, numbers = np.full(len(q), scale), np.zeros(q.shape), np.array([scale])
        for _ in range(CLIMBS):
            bound = climb(self._annulus, q, tick.left, theta, z, numbers) + tick.constant
            found = replace(found, lower_bound=max(found.lower_bound, float(bound)))
            if self.settles(found) or numbers[0] < SMALLEST * scale or tick.late:
                break
        return found if self.settles(found) else self._from(tick, found, z[None])

    def _from_around(self, tick: _Tick, found: Found) -> Found:
        return self._from(tick, found, tick.q[None][:0], FURTHER_STARTS)

    def _by_arcs(self, tick: _Tick, found: Found) -> Found:
        """Return the better of what was found and where a search over arcs leads, with its bound.

        It does not see path length, of which there is at least the floor's.
        """
        search, before = self._arcs, 0
        assert search is not None
        least = tick.constant + self._least_length
        search.begin(tick.q, least, found.cost - least)
        while True:
            ended = search.run(tick.out_of_time)
            bound = max(found.lower_bound, search.bound + least)
            found = replace(found, lower_bound=bound, nodes=found.nodes + search.nodes - before)
            if self.settles(found):
                return found
            before = search.nodes
            x = search.best if search.value < found.cost - least else search.last
            found = self._from(tick, found, x[None])
            search.beat(found.cost - least)
            if ended or self.settles(found) or tick.late:
                return found

    def _by_branches(self, tick: _Tick, found: Found) -> Found:
        """Return the better of what was found and where the general search leads."""
        guess = None if found.x is None else Guess(found.x, found.cost)
        asked = iter(range(BRANCHES))
        other = self._general.solve(
            tick.state, tick.goals, guess, lambda: next(asked, None) is None
        )
        best = other if other.cost < found.cost else found
        bound = max(found.lower_bound, other.lower_bound)
        return replace(best, lower_bound=bound, nodes=found.nodes + other.nodes)


def _long_hull(problem: Problem, tolerance: float) -> Hull | None:
    """Return the method for a hull over a horizon too long for dense code, where there is one."""
    free = replace(problem, floor=Floor(), weights=replace(problem.weights, length=0.0))
    return Hull(free, tolerance) if problem.horizon > LONGEST and Hull.solves(free) else None


def _better(found: Found, progress: Progress, constant: float) -> Found:
    """Return the cheaper of what was found and what a local search came to, with its bound."""
    cost, bound = progress.numbers[COST] + constant, progress.numbers[BOUND] + constant
    x = found.x
    if cost < found.cost:
        x = progress.best
    bound = max(found.lower_bound, float(bound))
    return Found(x, min(float(cost), found.cost), bound, found.nodes + int(progress.counts[TRIED]))
