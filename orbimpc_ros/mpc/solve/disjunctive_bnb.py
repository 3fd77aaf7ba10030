# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Branch and bound over disjunctions, with the convex program at its nodes.

Best first: the open node with the least bound is solved next, so that no node is solved whose bound
already exceeds the optimum. Before a child is solved it inherits its parent's bound raised by one
exact dual step (:mod:`orbimpc_ros.mpc.solve.branching`).

A round floor is branched on its cells, and the cells are cut finer where a solution slips below the
floor. Trajectories come from :mod:`orbimpc_ros.mpc.solve.dives`, those that turn in space first of
all from a plane (:mod:`orbimpc_ros.mpc.solve.planar_way`).

Mathematics: docs/mathematics.md, 4.9 and 5.4.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.model.dynamics import trajectory_of
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.problem.traffic import Traffic, traffic_of
from orbimpc_ros.mpc.proof.tree import ProofTree
from orbimpc_ros.mpc.solve.branching import (
    Branch,
    Branching,
    inverse_curvatures,
    inverse_hessian,
    steps_are_exchangeable,
    unraised,
)
from orbimpc_ros.mpc.solve.choice_tree import ChoiceTree
from orbimpc_ros.mpc.solve.disjunction import Slot, disjunctions_of
from orbimpc_ros.mpc.solve.dives import Dives
from orbimpc_ros.mpc.solve.incumbent import Incumbent, arrives, is_accurate
from orbimpc_ros.mpc.solve.passages import Passages
from orbimpc_ros.mpc.solve.place_program import PlaceProgram
from orbimpc_ros.mpc.solve.planar_way import PlanarWay
from orbimpc_ros.mpc.solve.posed import Choice, Missed, Posed
from orbimpc_ros.mpc.solve.relaxation import Relaxation, Relaxed
from orbimpc_ros.mpc.solve.request import Found, Request
from orbimpc_ros.mpc.solve.scouting import Scout
from orbimpc_ros.mpc.solve.so3_multipliers import SO3Multipliers
from orbimpc_ros.mpc.solve.turns import Turns

NEAR = 0.05  # a round floor missed by less is worth a dive
NOTHING = 'no trajectory satisfies the constraints'
MAX_NODES = 20_000
HALFWAY = (
    50.0  # times the tolerance, where many cells cost alike: half of the gap counted as proved
)


class DisjunctiveSearch:
    """Solves any problem by branch and bound; without disjunctions, by its one relaxation.

    Args:
        problem: what to solve.
        tolerance: relative gap at which a search stops.
        coasting: whether states come with a ``coasted`` rotation.
        among: whether states will come with hazards.
    """

    trusts_guess = True

    def __init__(
        self, problem: Problem, tolerance: float, *, coasting: bool = False, among: bool = False
    ) -> None:
        self.problem = problem
        among = among or len(problem.boxes) < len(problem.obstacles)
        rounded = problem.dimension == 3 and problem.floor.radius > 0.0
        slow = problem.has_cones or among or rounded
        self.tolerance = (HALFWAY if slow else 1.0) * tolerance
        self.disjunctions = disjunctions_of(problem)
        self.takes_guess = bool(self.disjunctions) or among  # one relaxation needs none
        self._exchangeable = steps_are_exchangeable(problem)
        self._condensed = Condensed(problem)
        self._inverse = inverse_hessian(self._condensed.hessian)
        self._curvature = inverse_curvatures(problem, self.disjunctions, self._inverse)
        slots = [slot for d in self.disjunctions for slot in d.slots]
        self.turns = Turns(problem) if problem.turns_are_angles else None
        if self.turns is not None:
            slots += self.turns.slots
        self.program = _program(problem, slots, coasting, among)
        self._plane = PlanarWay(problem, tolerance) if PlanarWay.leads(problem) else None
        self.scout = Scout(problem) if among else None

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether this method applies: it does to every problem."""
        return True

    def solve(self, request: Request) -> Found:
        """Return the best trajectory and the proof; complete unless time or nodes run out.

        Raises:
            Infeasible: no trajectory satisfies the constraints: every branch was refuted.
        """
        traffic = traffic_of(self.problem, request.state)
        if traffic is None and not self.disjunctions:
            return self._relaxed(request)
        passages = None
        if traffic is not None:
            passages = Passages(self.problem, request.state, traffic)
        known = self.program, self.disjunctions, self.turns, request, passages
        posed, curvature = Posed(self.problem, *known), list(self._curvature)
        if passages is not None:
            curvature += passages.curvatures(self._inverse)
        branching = Branching(posed, curvature, self._exchangeable)
        run = _Run(posed, branching, self.tolerance, self._tree(posed))
        planar = [] if self._plane is None else [self._plane.way(request)]
        return run.run(planar, () if traffic is None else self._ways(request, traffic, planar))

    def _tree(self, posed: Posed) -> ChoiceTree:
        """Return what writes the proof of a search."""
        return ChoiceTree(
            posed, self.program, self._condensed, self._inverse, ordered=self._exchangeable
        )

    def _relaxed(self, request: Request) -> Found:
        """Return the optimum of the one relaxation that is all of the problem."""
        state, goals = request.state, request.goals
        try:
            relaxed = self.program.relax(request)
        except Infeasible:
            raise Infeasible(NOTHING, self._root(request, empty=True)) from None
        if relaxed.x is None:
            return Found(None, np.inf, relaxed.bound, 1)
        trajectory = trajectory_of(self.problem, state, goals, relaxed.x)
        found = Found(relaxed.x, trajectory.cost, relaxed.bound, 1, proof=relaxed.proof)
        # What was solved to the end needs no second look, which costs a quarter of a tick.
        solved = abs(found.gap) <= self.tolerance and not request.late
        accurate = arrives if solved else is_accurate
        if not accurate(self.problem, goals, trajectory):
            return Found(None, np.inf, relaxed.bound, 1)
        return found if found.proof is not None else replace(found, proof=self._root(request))

    def _root(self, request: Request, *, empty: bool = False) -> ProofTree | None:
        """Return what the bound of a relaxation rests on where nothing is left to choose."""
        posed = Posed(self.problem, self.program, (), self.turns, request)
        tree = self._tree(posed)
        tree.solved(0, posed.undecided, empty=empty)
        return tree.proof()

    def _ways(self, request: Request, traffic: Traffic, planar: list[Array]) -> Iterator[Array]:
        """Yield headings R_1 e1..R_N e1, shape (N, n), of ways to start from.

        The guessed one, the one in a plane, whose coordinates are given, and the one scouted.
        """
        if request.guess is not None:
            yield request.guess.x[:, : self.problem.dimension]
        for x in planar:
            yield x[:, : self.problem.dimension]
        if self.scout is None or request.late:
            return
        scouted = self.scout.way(request.state, request.goals, traffic, request.out_of_time)
        if scouted is not None:
            yield scouted


def _program(problem: Problem, slots: Sequence[Slot], coasting: bool, among: bool) -> Relaxed:
    """Return the fastest convex program for a problem, perhaps among what is round or moves."""
    if not among and SO3Multipliers.solves(problem, slots):
        return SO3Multipliers(problem, slots, coasting=coasting)
    if PlaceProgram.solves(problem):
        return PlaceProgram(problem, slots)
    from orbimpc_ros.mpc.solve.program import Program  # takes Clarabel

    return Program(problem, slots, coasting=coasting)


@dataclass(order=True)
class _Node:
    bound: float
    order: int  # later nodes first among equals: deeper ones
    choice: Choice = field(compare=False)
    number: int = field(compare=False, default=0)  # in the tree


class _Run:
    """One search: the open nodes, the best trajectory, the least bound given up.

    Args:
        posed: what is searched.
        branching: how nodes are branched on.
        tolerance: relative gap at which it stops.
        tree: writes the proof.
    """

    def __init__(
        self,
        posed: Posed,
        branching: Branching,
        tolerance: float,
        tree: ChoiceTree,
    ) -> None:
        self._posed, self._branching = posed, branching
        self._tree = tree
        self._best, self._tolerance = Incumbent(posed, tolerance), tolerance
        self._root: Relaxation | None = None
        self._dives = Dives(posed, self._best)
        self._guided = posed.passages is not None  # trajectories come from ways, not yet from dives
        self._closed = np.inf
        self._open = [_Node(-np.inf, 0, posed.undecided)]
        self._made = 0

    def run(self, known: Sequence[Array] = (), ways: Iterable[Array] = ()) -> Found:
        """Search, from the best trajectories that pass everything on the same sides as some ways.

        Args:
            known: rotation coordinates, shape (N, d) each, of trajectories that may be legal.
            ways: headings R_1 e1..R_N e1, shape (N, n) each.
        """
        posed, best = self._posed, self._best
        for x in known:
            trajectory = posed.flown(x)
            if not posed.missed(trajectory):
                best.offer(x, trajectory)
        if self._guided:  # the root first: its bound holds whatever becomes of them
            self._expand(heapq.heappop(self._open))
            for way in ways:
                self._dives.follow(way)
            self._guided = False
        while self._open and self._open[0].bound < self._limit:
            if posed.solved >= MAX_NODES or (posed.solved and posed.late):
                break
            self._expand(heapq.heappop(self._open))
        lower = min([self._closed, best.cost, *(node.bound for node in self._open)])
        if lower == np.inf:
            raise Infeasible(NOTHING, self._tree.proof())
        return Found(best.x, best.cost, lower, posed.solved, proof=self._proof(lower))

    def _proof(self, lower: float) -> ProofTree | None:
        """Return what proves a bound: the tree, or its root where that is as good."""
        root = self._root
        if root is not None and root.bound >= lower - self._tolerance * abs(lower) and root.proof:
            return root.proof
        return self._tree.proof_in_time(self._posed.request.out_of_time)

    @property
    def _limit(self) -> float:
        """Return the bound from which on a node can neither improve the plan nor the bound.

        What turns too wide leave open at a leaf, no other leaf makes up for.
        """
        if self._best.x is None or self._posed.turns is None:
            return self._best.cutoff
        return min(self._best.cutoff, self._closed)

    def _expand(self, node: _Node) -> None:
        """Solve a node, and branch on it or take its solution."""
        posed, choice = self._posed, node.choice
        try:
            relaxed = posed.relax(choice)
        except Infeasible:
            self._note(node, empty=True)
            if posed.solved == 1:
                raise Infeasible(NOTHING, self._tree.proof()) from None
            return
        if self._root is None:
            self._root = relaxed
        bound = max(node.bound, relaxed.bound)
        self._note(node, better=relaxed.bound >= node.bound)
        if relaxed.x is None:  # neither refuted nor solved
            self._give_up(node, bound)
            return
        trajectory = posed.flown(relaxed.x)
        missed = posed.missed(trajectory)
        if not missed:
            self._close(bound)
            self._best.offer(relaxed.x, trajectory)
            if not relaxed.is_accurate:
                self._dives.dive(choice, trajectory, posed.round_floors(trajectory))
            elif not posed.turns_in_time(trajectory):
                self._dives.turn(choice, trajectory)
            return
        if (self._best.x is None and not self._guided) or self._is_nearly_round(missed):
            self._dives.dive(choice, trajectory, missed)
        if posed.late:  # to branch may take as long as to solve
            self._close(bound)
            return
        branch = self._branching.children(choice, missed, bound, relaxed.dual_value)
        if branch is None:
            self._close(bound)
            return
        self._part(node, branch)

    def _note(self, node: _Node, *, better: bool = True, empty: bool = False) -> None:
        self._tree.solved(node.number, node.choice, better=better, empty=empty)

    def _give_up(self, node: _Node, bound: float) -> None:
        """Close a node that was not solved, unless it is the root, whose parts may be."""
        if self._posed.solved > 1 or self._posed.late:
            self._close(bound)
            return
        self._part(node, unraised(0, self._posed.cells(0, None), bound))

    def _part(self, node: _Node, branch: Branch) -> None:
        """Put the parts of a node among those that are open."""
        before, after = node.choice[: branch.split], node.choice[branch.split + 1 :]
        numbers = self._tree.split(node.number, node.choice, branch)
        for number, cell, bound in zip(numbers, branch.cells, branch.bounds.tolist(), strict=True):
            self._push((*before, cell, *after), bound, number)

    def _is_nearly_round(self, missed: Missed) -> bool:
        """Return whether all that is missed are round floors, and those by little."""
        every = self._posed.alternatives
        return all(every[j].radius and by < NEAR for j, (by, _) in missed.items())

    def _push(self, choice: Choice, bound: float, number: int) -> None:
        if bound >= self._best.cutoff:
            self._close(bound)
            return
        self._made += 1
        heapq.heappush(self._open, _Node(bound, -self._made, choice, number))

    def _close(self, bound: float) -> None:
        """Note that a node is not searched any further."""
        self._closed = min(self._closed, bound)
