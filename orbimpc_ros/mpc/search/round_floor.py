# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Round floors, without constraints that couple headings except an arrival.

The cost may depend on R e1 only. In the plane that determines R; in space the other columns are
then free, and are carried along by the shortest turns from one thrust axis to the next.

Mostly a stationary point is proved optimal by its own multipliers; otherwise the best Shor
multipliers prove it or, in the plane, bound the nodes of a best-first search over sectors of
headings. In space remaining gaps are left to the general search.

Mathematics: docs/mathematics.md, 4.4 to 4.6.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from threading import get_ident

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import carried, coordinates
from orbimpc_ros.mpc.kernels import compiled, entry_point
from orbimpc_ros.mpc.kernels.linear import copy_to
from orbimpc_ros.mpc.model.dynamics import knowns, unbounded
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.proof.tree import ARCS, CUT, ProofTree
from orbimpc_ros.mpc.search.best_first import (
    CLOSED,
    DONE,
    FULL,
    LEAST,
    MADE,
    NODES,
    OPEN,
    PAUSED,
    VALUE,
    close,
    cutoff_of,
    least_left,
    leave_open,
    take,
)
from orbimpc_ros.mpc.search.engine import SETTLED, TreeSearch
from orbimpc_ros.mpc.search.relax import StageProblem, rise_of
from orbimpc_ros.mpc.search.ring import HIGH, LOW, TURN, cut_near, take_part
from orbimpc_ros.mpc.search.shells import (
    ACTIVE,
    ARRIVED,
    Descent,
    arrive,
    descend,
    land,
    misses,
    set_out,
)
from orbimpc_ros.mpc.search.shor import GOING, KINDS, PRUNED, certify, climb, priced_branching
from orbimpc_ros.mpc.search.tree import KEY, MOST_ARCS, branch, plant, take_better, tree_for
from orbimpc_ros.mpc.solve.request import Found, Method, Request

# In Tree.counts: node whose climb ended last; whether a descent from there is due; next start.
FROM, DUE, BEGIN = range(3, 6)
NEAR = 0.2  # share of a bound's gap: climbs that cannot gain more than this end early, except
# at the root, whose point is needed as a start for descents
YOUNG, EVERY = 4, 4  # descents start from each of the first nodes, then from every 4th
MOST, ROOM = 12_800, 800_000  # most nodes of a search; nodes times steps
BRANCHES = 2500  # most nodes of the general search
SAME = 1e-9  # relative: costs this close to the incumbent's count as equal


@compiled
def _begin(posed, tree, descent):
    """Begin a search with its root; with an arrival, a trajectory that satisfies it comes first."""
    plant(tree)
    tree.sectors[0, :, LOW], tree.sectors[0, :, HIGH] = -np.pi, np.pi
    descent.numbers[ACTIVE] = 0.0
    if posed.stiff > 0.0 and arrive(posed, descent.z):
        take_better(posed, tree, descent.z)


@compiled
def _set_out(posed, tree, descent, starts):
    """Begin the next descent, from a climb's end or else a start; return False if none remains.

    With an arrival, the last start is used only after the root is solved.
    """
    counts, usable = tree.counts, len(starts)
    if posed.stiff > 0.0 and counts[NODES] == 0:
        usable -= 1
    if counts[DUE] > 0:
        copy_to(descent.z, tree.z[counts[FROM]])
        counts[DUE] = 0
    elif counts[BEGIN] < usable:
        copy_to(descent.z, starts[counts[BEGIN]])
        counts[BEGIN] += 1
    else:
        return False
    set_out(posed, descent, tree.pull[counts[FROM], 0])
    return True


@compiled
def _descend(posed, tolerance, tree, descent, work):
    """Descend; if that leads to a new incumbent, try to prove it optimal by its own multipliers."""
    counts, numbers, z = tree.counts, tree.numbers, descent.z
    work = descend(posed, descent, work)
    if misses(posed, z) > ARRIVED:
        return work
    take_better(posed, tree, z)
    same = SAME * abs(numbers[VALUE] + posed.constant)
    if descent.numbers[ACTIVE] > 0.0 or rise_of(posed, tree.best, z) > same:
        return work
    before, cutoff = tree.progress[0, KEY], cutoff_of(numbers[VALUE], posed.constant, tolerance)
    certify(posed, z, descent.pull, tree, cutoff)
    key = tree.progress[0, KEY]
    if key >= cutoff:
        counts[MADE], counts[OPEN], numbers[CLOSED], tree.nodes[0] = 1, 0, key, 0
    elif counts[MADE] > 1:
        tree.progress[0, KEY] = before
    elif counts[OPEN] > 0:
        tree.keys[0] = key
    else:
        numbers[CLOSED] = key
    return work - len(z) ** 3


@compiled
def _split(tree, node, k, cutoff):
    """Create the children of a node by the directions of a step; their climbs begin at its end."""
    low, high = tree.sectors[node, k, LOW], tree.sectors[node, k, HIGH]
    cut, parts, kind = np.arctan2(tree.z[node, k, 1], tree.z[node, k, 0]), MOST_ARCS, ARCS
    if high - low < TURN:
        cut, parts, kind = cut_near(cut, low, high), 2, CUT
    first = branch(tree, node, kind, k, cut, parts)
    for i in range(first, first + parts):
        take_part(tree.sectors[i], k, LOW, HIGH, cut, parts, i - first)
        leave_open(tree, i, tree.progress[i, KEY], cutoff)


@compiled
def _solve_node(posed, tolerance, tree, node, work):
    """Climb a node, split it, and schedule a descent; return the remaining multiplications."""
    counts, near = tree.counts, NEAR if node > 0 else 0.0
    cutoff = cutoff_of(tree.numbers[VALUE], posed.constant, tolerance)
    status, work = climb(posed, tree, node, near, cutoff, work)
    key = tree.progress[node, KEY]
    if status == GOING:
        leave_open(tree, node, key, np.inf)
        return work
    counts[NODES] += 1
    if status != PRUNED and (counts[NODES] <= YOUNG or counts[NODES] % EVERY == 0):
        counts[FROM], counts[DUE] = node, 1
    k = -1
    if len(posed.left) == 2 and key < cutoff:
        k = priced_branching(posed, tree, node)
    if k < 0:
        close(tree, key)
    else:
        _split(tree, node, k, cutoff)
    return work


@entry_point
def _search(posed, tolerance, tree, descent, starts, work):
    """Begin or continue a best-first search.

    Args:
        posed: the problem.
        tolerance: relative gap at which to stop.
        tree: updated in place; without nodes, the search begins.
        descent: the current one, from a start or from a node.
        starts: headings to descend from: a guess, if there is one, and the minimiser without
            bounds on lengths, shape (S, N, n).
        work: multiplications to do.

    Returns:
        ``DONE``; ``FULL`` if there is no memory for more nodes; ``PAUSED`` if the work is done.
    """
    counts, numbers, status = tree.counts, tree.numbers, PAUSED
    if counts[MADE] == 0:
        _begin(posed, tree, descent)
    while work > 0.0 and status == PAUSED:
        if descent.numbers[ACTIVE] > 0.0:
            work = _descend(posed, tolerance, tree, descent, work)
        elif least_left(tree) >= cutoff_of(numbers[VALUE], posed.constant, tolerance):
            status = DONE
        elif _set_out(posed, tree, descent, starts):
            work -= 1.0
        elif counts[OPEN] == 0:
            status = DONE
        elif counts[MADE] + MOST_ARCS > len(tree.nodes):
            status = FULL
        else:
            work = _solve_node(posed, tolerance, tree, take(tree), work)
    if status == PAUSED and posed.stiff > 0.0 and descent.numbers[ACTIVE] > 0.0:
        z = descent.z.copy()
        if land(posed, z):
            take_better(posed, tree, z)
    numbers[LEAST] = min(least_left(tree), numbers[VALUE])
    return status


class RoundFloor(TreeSearch):
    """Solver of problems of rotation order 1 with a round floor and no limit but a terminal one.

    Args:
        problem: to solve, in natural units.
        tolerance: relative gap at which a plan is good enough to stop.
    """

    takes_guess = True

    def __init__(self, problem: Problem, tolerance: float, *, coasting: bool = False) -> None:
        super().__init__(problem, SETTLED * tolerance, _search)
        self._lifts = problem.dimension == 3 and problem.weighs_rotations
        if self._lifts:
            nowhere = (each[:0] for each in self._condensed.arrival)
            self._others = unbounded(0, self._condensed.others, *nowhere)
        self._prepare()

    @cached_property
    def _general(self) -> Method:
        from orbimpc_ros.mpc.solve.branch_and_bound import BranchAndBound  # slow to import

        return BranchAndBound(self._problem, self._tolerance)

    @staticmethod
    def solves(problem: Problem, *, coasting: bool = False) -> bool:
        """Return True if this method applies to a problem."""
        constrained = problem.terminal == 'constraint'
        arrives = constrained or problem.arrival_weight > 0.0
        decided = constrained and problem.decided_steps == problem.horizon  # by the state
        return (
            (problem.floor.shape, problem.rotation_order) == ('circle', 1)
            and not (problem.inertial and arrives)
            and not decided
            and (problem.dimension == 2 or not problem.weighs_rotations)
            and not (problem.max_rate or problem.obstacles or problem.has_cones)
            and not problem.approach.exists
        )

    def solve(self, request: Request) -> Found:
        """Return the best trajectory found, with the tree that proves a bound.

        Raises:
            Infeasible: no trajectory satisfies the constraints.
        """
        posed, guess = self._posed(request, self._left(request)), request.guess
        steps, n = posed.q.shape
        nodes = min(MOST, ROOM // steps) if n == 2 else 1
        tree = tree_for(get_ident(), nodes + MOST_ARCS, steps, n, KINDS)
        descent = Descent(np.zeros((steps, n)), np.zeros(n), np.zeros(6))
        guesses = [] if guess is None else [guess[:, :n]]
        starts = np.array([*guesses, -(self._inverse @ posed.q)])
        result = self._run(request, posed, tree, descent, starts)
        # Setting up the general search takes longer than callers with a deadline can wait.
        if result.gap <= self._tolerance or n == 2 or request.hurried or request.rounds < np.inf:
            return result
        return self._by_branches(request, result)

    def resumed(self, request: Request) -> Found:
        """See :meth:`TreeSearch.resumed`; in space, rotations are carried along."""
        result = super().resumed(request)
        if result.x is None or self._problem.dimension == 2:
            return result
        return replace(result, x=coordinates(carried(request.state.attitude, result.x)))

    def proved(self, request: Request, found: Found) -> Found:
        """See :meth:`TreeSearch.proved`; if R e2 and R e3 have a cost, the proof has them, too."""
        found = super().proved(request, found)
        proofs = [self._lifted(request, each) for each in found.proofs] if self._lifts else []
        return replace(found, proofs=tuple(proofs)) if proofs else found

    def _lifted(self, request: Request, tree: ProofTree) -> ProofTree:
        """Return a proof of whole rotations, at the least cost of R e2 and R e3."""
        condensed, every = self._condensed, (len(tree.point), self._problem.horizon, 6)
        slope = condensed.hessian @ tree.point + condensed.affine(request.state, request.goals)[0]
        slope -= tree.shor[:, :, None] * tree.point
        if self._stiff:
            slope += self._arrival[:, None] * tree.pull
        least = np.broadcast_to(self._others.minimiser[:, :-1] @ self._aside(request), every)
        return tree._replace(point=np.concatenate([tree.point, least], axis=2), share=slope)

    def _aside(self, request: Request) -> Array:
        """Return what is known of R e2 and R e3, shape (N + 4, 6)."""
        return knowns(request.state, request.goals)[:, 3:]

    def _posed(self, request: Request, left: Array) -> StageProblem:
        posed = super()._posed(request, left)
        if not self._lifts:
            return posed
        data = self._aside(request)
        least = float(np.vdot(data, self._others.least[:-1, :-1] @ data))
        return posed._replace(constant=posed.constant + least)

    def _by_branches(self, request: Request, result: Found) -> Found:
        """Return the better of a result and that of the general search, with the higher bound."""
        other = self._general.solve(request._replace(guess=result.x, rounds=BRANCHES))
        best = other if other.cost < result.cost else result
        bound = other if other.lower_bound > result.lower_bound else result
        combined = replace(best, lower_bound=bound.lower_bound, proofs=bound.proofs)
        return replace(combined, nodes=result.nodes + other.nodes)
