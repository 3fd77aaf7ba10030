"""The true floor where the cost sees R e1 alone: a local optimum, and the proof that it is global.

That is all of R for n = 2. For n = 3 it takes an input weight of zero; the other columns are then
free, and are carried along by the shortest turns from one thrust axis to the next.

A local optimum is sought from the shifted previous plan, from the hull's optimum, then from all
around. Its own multipliers nearly always prove it global (:mod:`orbimpc_ros.mpc.kernels.annulus`).
What those leave open, typically a goal about to pass the vehicle, so that two ways round cost
nearly the same, is settled in the plane by branch and bound: the floor is cut into arcs, and beyond
the chord of an arc the problem is convex. With an arrival, and in space, the general search does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from orbimpc_ros.mpc import dynamics
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.condensed import Condensed
from orbimpc_ros.mpc.errors import Infeasible, SolverFailure
from orbimpc_ros.mpc.floors.cells import arcs
from orbimpc_ros.mpc.floors.tree import CellSearch
from orbimpc_ros.mpc.general import General
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
from orbimpc_ros.mpc.method import Found, Guess
from orbimpc_ros.mpc.orbitopes import coordinates
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.rotations import turned_onto

FURTHER_STARTS = 30
SETTLED = 50.0  # tolerances at which starts from all around, and searches, may stop
NODES = 25_600  # of the search over arcs
BRANCHES = 400  # of the general search, where nobody waits for it
CLIMBS = 60  # Newton steps up the dual function
TINY = 1e-300
OUT_OF_REACH = 1e-9  # share of the way to an arrival


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
        spent = problem.weights.length * problem.step * problem.forward
        length = np.full(problem.horizon, spent)
        length[-1] = 0.0
        self._arrives = problem.terminal == 'constraint'
        arrival = np.zeros(problem.horizon)
        if self._arrives:
            arrival = dynamics.position_map(problem)[-1, 1:].copy()
        hessian, floor = self._condensed.hessian, float(problem.floor.fraction)
        self._annulus = Annulus(hessian, length, arrival, floor)
        self._hull = Annulus(hessian, np.zeros(problem.horizon), arrival, 0.0)
        self._arcs: CellSearch | None = None
        if problem.dimension == 2 and not self._arrives:
            self._arcs = CellSearch(hessian, arcs(floor), SETTLED * tolerance, NODES)
        self._general = General(problem, SETTLED * tolerance)
        self._compile()

    def _compile(self) -> None:
        """Compile, or load what was compiled before: at start-up, not in a tick."""
        if not COMPILED:
            return
        q = np.ones((self._problem.horizon, self._problem.dimension))
        self._locally(q, 0.0, np.zeros(q.shape[1] * self._arrives), None, lambda: True)
        nothing = Found(None, np.inf, -np.inf, 0)
        self._from_dual(q, 0.0, np.zeros(q.shape[1] * self._arrives), nothing, lambda: True)
        if self._arcs is not None:
            self._arcs.begin(q, 0.0)
            self._arcs.run(lambda: True)

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
        left = self._left(state, goals)
        start = None if guess is None else guess.x[:, : self._problem.dimension]
        found = self._locally(q, constant, left, start, out_of_time)
        late = out_of_time is not None and out_of_time()
        if self.settles(found) or late:
            return self._whole(state, found)
        if self._arcs is not None:
            return self._by_arcs(q, constant, found, out_of_time)
        whole = self._whole(state, found)
        # To set the general search up takes longer than those with a deadline can wait.
        return whole if out_of_time is not None else self._by_branches(state, goals, whole)

    def _whole(self, state: State, found: Found) -> Found:
        if found.x is None or self._problem.dimension == 2:
            return found
        return replace(found, x=_carried(state.attitude, found.x))

    def _left(self, state: State, goals: Array) -> Array:
        """Return b, what sum_k a_k z_k must come to, shape (n,) [m], or (0,) without an arrival."""
        problem = self._problem
        if not self._arrives:
            return np.zeros(0)
        reached = state.position + problem.step * problem.forward * state.rotation[:, 0]
        left = np.asarray(goals[-1] - reached)
        reach = float(self._annulus.arrival.sum())
        if np.linalg.norm(left) > reach * (1.0 + OUT_OF_REACH) + OUT_OF_REACH:
            raise Infeasible('the goal is out of reach')
        return left

    def _locally(
        self,
        q: Array,
        constant: float,
        left: Array,
        start: Array | None,
        out_of_time: Callable[[], bool] | None,
    ) -> Found:
        """Return the best local optimum, and the bound of multipliers."""
        lower = -np.inf
        if start is not None:
            found, lower = self._from(q, constant, left, start[None], 0, lower, out_of_time)
            if found.gap <= self._tolerance:
                return found
        relaxed = begun(*q.shape)
        while not relax(self._hull, q, left, relaxed, SLICE):
            if out_of_time is not None and out_of_time():
                break
        least = self._annulus.floor * float(self._annulus.length.sum())
        lower = max(lower, float(relaxed.numbers[BOUND]) + least)
        other, lower = self._from(q, constant, left, relaxed.best[None], 0, lower, out_of_time)
        found = _better(found, other) if start is not None else other
        if self.settles(found) or (out_of_time is not None and out_of_time()):
            return found
        found, centre = self._from_dual(q, constant, left, found, out_of_time)
        if self.settles(found) or (out_of_time is not None and out_of_time()):
            return found
        lower = found.lower_bound - constant
        other, _ = self._from(
            q, constant, left, centre[None], FURTHER_STARTS, lower, out_of_time
        )
        return _better(found, other)

    def _from_dual(
        self,
        q: Array,
        constant: float,
        left: Array,
        found: Found,
        out_of_time: Callable[[], bool] | None,
    ) -> tuple[Found, Array]:
        """Return what was found with the best bound of multipliers, and headings to start from."""
        scale = float(np.abs(q).max() + np.abs(self._annulus.hessian).max()) + TINY
        theta, z, numbers = np.full(len(q), scale), np.zeros(q.shape), np.array([scale])
        for _ in range(CLIMBS):
            bound = climb(self._annulus, q, left, theta, z, numbers) + constant
            found = replace(found, lower_bound=max(found.lower_bound, float(bound)))
            if self.settles(found) or numbers[0] < SMALLEST * scale:
                break
            if out_of_time is not None and out_of_time():
                break
        return found, z

    def _from(
        self,
        q: Array,
        constant: float,
        left: Array,
        starts: Array,
        more: int,
        lower: float,
        out_of_time: Callable[[], bool] | None,
    ) -> tuple[Found, float]:
        """Return where starts lead, shape (S, N, n), and so many more, and the bound by then."""
        progress = begun(*q.shape)
        progress.numbers[BOUND] = lower
        tolerance = (SETTLED if more else 1.0) * self._tolerance
        while not improve(
            self._annulus, q, left, constant, starts, more, tolerance, progress, SLICE
        ):
            if out_of_time is not None and out_of_time():
                break
        return _found(progress, constant), float(progress.numbers[BOUND])

    def _by_arcs(
        self, q: Array, constant: float, found: Found, out_of_time: Callable[[], bool] | None
    ) -> Found:
        """Return the better of what was found and where a search over arcs leads, with its bound.

        It does not see path length, of which there is at least the floor's.
        """
        search = self._arcs
        assert search is not None
        least = constant + self._annulus.floor * float(self._annulus.length.sum())
        search.begin(q, least, found.cost - least)
        before = 0
        while True:
            ended = search.run(out_of_time)
            bound = max(found.lower_bound, search.bound + least)
            found = replace(found, lower_bound=bound, nodes=found.nodes + search.nodes - before)
            before = search.nodes
            if self.settles(found):
                return found
            late = out_of_time is not None and out_of_time()
            x = search.best if search.value < found.cost - least else search.last
            low = bound - constant
            other, _ = self._from(q, constant, np.zeros(0), x[None], 0, low, lambda: late)
            found = _better(found, other)
            search.beat(found.cost - least)
            if ended or late or self.settles(found):
                return found

    def _by_branches(self, state: State, goals: Array, found: Found) -> Found:
        """Return the better of what was found and where the general search leads."""
        guess = None if found.x is None else Guess(found.x, found.cost)
        asked = iter(range(BRANCHES))
        try:
            other = self._general.solve(state, goals, guess, lambda: next(asked, None) is None)
        except SolverFailure:
            return found
        return _better(found, other)


def _found(progress: Progress, constant: float) -> Found:
    cost, bound = progress.numbers[COST] + constant, progress.numbers[BOUND] + constant
    x = progress.best.copy() if cost < np.inf else None
    return Found(x, float(cost), float(bound), int(progress.counts[TRIED]))


def _better(one: Found, other: Found) -> Found:
    """Return the cheaper of two, with the greater bound of both."""
    best = other if other.cost < one.cost else one
    bound = max(one.lower_bound, other.lower_bound)
    return replace(best, lower_bound=bound, nodes=one.nodes + other.nodes)


def _carried(attitude: Array, headings: Array) -> Array:
    """Return coordinates, shape (N, 9), of |z_k| Q_k, with Q_k turned from Q_{k-1} onto z_k."""
    matrices = []
    for z in headings:
        size = float(np.linalg.norm(z))
        attitude = turned_onto(attitude, z / size)
        matrices.append(size * attitude)
    return coordinates(np.array(matrices))
