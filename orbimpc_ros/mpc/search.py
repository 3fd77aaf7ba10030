"""Branch and bound over disjunctions, with the convex program at its nodes.

Best first: the open node with the least bound is solved next, so that no node is solved whose bound
already exceeds the optimum. Before a child is solved it inherits its parent's bound raised by one
exact dual step. With the parent's multipliers held, the dual function along the multiplier t >= 0
of a new row a.x >= beta is

    D(t) = D(0) + t (beta - a.x) - t^2/2 a.H^-1 a,

a parabola in the parent's solution x and the condensed Hessian H of the rotations, so the child
costs at least D(0) + max(0, beta - a.x)^2 / (2 a.H^-1 a). That prunes most children unsolved.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from orbimpc_ros.mpc import dynamics
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.condensed import hessian
from orbimpc_ros.mpc.disjunction import Disjunction
from orbimpc_ros.mpc.errors import Infeasible, SolverFailure
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.program import Program
from orbimpc_ros.mpc.trajectory import Trajectory, trajectory_of

SATISFIED = 1e-7  # an alternative missed by less holds; a tenth of what the plan's check allows
UNDECIDED = -1


@dataclass(frozen=True)
class Found:
    """What a search found and proved.

    Attributes:
        x: rotation coordinates of R_1..R_N, shape (N, d); None if no trajectory was found.
        cost: of that trajectory, inf if there is none.
        lower_bound: no trajectory costs less.
        nodes: relaxations solved.
    """

    x: Array | None
    cost: float
    lower_bound: float
    nodes: int


@dataclass(order=True)
class _Node:
    bound: float
    order: int  # later nodes first among equals: deeper ones
    choice: tuple[int, ...] = field(compare=False)


class Search:
    """One run of branch and bound over the disjunctions of a bound program.

    Args:
        program: the relaxation, bound to state and goals.
        curvature: from :func:`inverse_curvature`, one array per disjunction.
        state: the state that the program is bound to.
        goals: the goals that it is bound to, shape (N, n).
        tolerance: relative gap at which the search stops.
        guess: coordinates of a feasible trajectory, shape (N, d), and its cost.
    """

    def __init__(
        self,
        program: Program,
        curvature: list[Array],
        state: State,
        goals: Array,
        *,
        tolerance: float,
        guess: tuple[Array, float] | None = None,
    ) -> None:
        self._program, self._curvature = program, curvature
        self._state, self._goals, self._tolerance = state, goals, tolerance
        self._best: Array | None = None
        self._cost = np.inf
        if guess is not None:
            self._best, self._cost = guess
        self._closed = np.inf  # least bound among the nodes that were given up
        self._open = [_Node(-np.inf, 0, (UNDECIDED,) * len(program.disjunctions))]
        self._nodes = self._made = 0

    def run(self, out_of_time: Callable[[], bool] | None = None) -> Found:
        """Return the best trajectory and the proof so far; complete unless time runs out.

        Raises:
            Infeasible: no trajectory satisfies the constraints: every branch was refuted.
            SolverFailure: the relaxation without any choice could not be solved.
        """
        while self._open and self._open[0].bound < self._cutoff:
            if self._nodes and out_of_time is not None and out_of_time():
                break
            self._expand(heapq.heappop(self._open))
        lower = min([self._closed, self._cost, *(node.bound for node in self._open)])
        if lower == np.inf:
            raise Infeasible('no trajectory satisfies the constraints: every branch is infeasible')
        return Found(self._best, self._cost, lower, self._nodes)

    @property
    def _cutoff(self) -> float:
        """Return the bound from which on a node cannot improve on the best by enough."""
        if self._best is None:
            return np.inf
        return self._cost - self._tolerance * max(abs(self._cost), 1e-9)

    def _expand(self, node: _Node) -> None:
        self._nodes += 1
        try:
            relaxed = self._program.solve(node.choice)
        except Infeasible:
            if self._nodes == 1:
                raise
            return
        except SolverFailure:
            if self._nodes == 1:
                raise
            self._closed = min(self._closed, node.bound)  # neither refuted nor solved
            return
        bound = max(node.bound, relaxed.bound)
        trajectory = trajectory_of(self._program.problem, self._state, self._goals, relaxed.x)
        missed = self._missed(trajectory)
        if missed:
            self._branch(node, missed, bound)
        else:
            self._closed = min(self._closed, bound)
            if trajectory.cost < self._cost:
                self._best, self._cost = relaxed.x, trajectory.cost

    def _missed(self, trajectory: Trajectory) -> dict[int, Array]:
        """Return the shortfalls, by disjunction, of those of which no alternative holds."""
        missed = {}
        for j, disjunction in enumerate(self._program.disjunctions):
            shortfall = disjunction.shortfall(trajectory.headings, trajectory.positions)
            if shortfall.max(axis=1).min() > SATISFIED:
                missed[j] = shortfall
        return missed

    def _branch(self, node: _Node, missed: dict[int, Array], bound: float) -> None:
        """Open a child per alternative of the disjunction that raises the bound the most."""
        open_ = {j: s for j, s in missed.items() if node.choice[j] == UNDECIDED}
        if not open_:  # a chosen alternative is missed: the solve was not accurate enough
            self._closed = min(self._closed, bound)
            return
        gains = {j: self._gain(j, shortfall) for j, shortfall in open_.items()}
        chosen = max(open_, key=lambda j: (gains[j].min(), open_[j].max(axis=1).min()))
        for alternative, raised in self._children(gains[chosen], bound):
            choice = (*node.choice[:chosen], alternative, *node.choice[chosen + 1 :])
            self._made += 1
            heapq.heappush(self._open, _Node(raised, -self._made, choice))

    def _children(self, gains: Array, bound: float) -> Iterator[tuple[int, float]]:
        for alternative, gain in enumerate(gains):
            raised = bound + float(gain)
            if raised < self._cutoff:
                yield alternative, raised
            else:
                self._closed = min(self._closed, raised)

    def _gain(self, j: int, shortfall: Array) -> Array:
        """Return by how much each alternative raises the bound at least, shape (m,)."""
        return (np.maximum(shortfall, 0.0) ** 2 / (2.0 * self._curvature[j])).max(axis=1)


def inverse_curvature(problem: Problem, disjunction: Disjunction) -> Array:
    """Return a.H^-1 a of a disjunction's rows, one per step, shape (len(steps),).

    H is the Hessian of the quadratic part of the objective in R_1..R_N, positions eliminated. It
    is the same for each coordinate of R_k e1, and the normals have length one. Infinite (no gain)
    where H is singular.
    """
    curvature = hessian(problem)
    if np.linalg.cond(curvature) > 1e12:
        return np.full(len(disjunction.steps), np.inf)
    inverse = np.linalg.inv(curvature)
    steps = np.array(disjunction.steps) - 1
    if disjunction.on == 'heading':
        return np.diag(inverse)[steps]
    rows = dynamics.position_map(problem)[steps, 1:]
    along = np.einsum('ki,ij,kj->k', rows, inverse, rows)
    return np.where(along > 0.0, along, np.inf)
