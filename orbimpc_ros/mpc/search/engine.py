# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Searches as methods of the solver: from a request to a trajectory and its proof tree.

Mathematics: docs/mathematics.md, 4.3.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from threading import get_ident

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.kernels import COMPILED, bare
from orbimpc_ros.mpc.model.dynamics import Condensed, length_weights, regular
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.problem import LEEWAY
from orbimpc_ros.mpc.problem.reach import decided, entry_speed
from orbimpc_ros.mpc.proof.tree import CHILD, CHILDREN, NOTHING, NOWHERE, ROW, ProofTree
from orbimpc_ros.mpc.proof.verify import SLICE as VERIFIED
from orbimpc_ros.mpc.search.best_first import EMPTY, LEAST, MADE, NODES, PAUSED, VALUE
from orbimpc_ros.mpc.search.relax import StageProblem, room_for
from orbimpc_ros.mpc.search.ring import Ring
from orbimpc_ros.mpc.search.tree import KEY, Tree, search, tree_for
from orbimpc_ros.mpc.solve.request import Found, Request

LONGEST = 120  # horizon up to which a search proves more in a tick than sparse solves do
LONGEST_INERTIAL = 58  # without a floor: beyond it interior steps take longer than sparse solves
ROOM = 1_000_000  # memory of the search, in nodes times steps
SLICE = 3e5  # multiplications between checks of the deadline: less than a millisecond
NONE: Array = np.zeros((0, 2))  # no guess
NO_ROWS = np.zeros(0, np.int64)
STIFF = 1e4  # weight of an arrival, in units of the largest curvature
OUT_OF_REACH = 1e-9  # relative margin beyond the reach
SETTLED = 90.0  # factor on the tolerance of the search if constraints couple steps


class TreeSearch:
    """A method that bounds and branches in machine code.

    Args:
        problem: to solve, in natural units.
        tolerance: relative gap at which a plan is good enough to stop.
        search: begins or continues a search, as :func:`~orbimpc_ros.mpc.search.tree.search` does.

    Attributes:
        has_ended: whether the last search cannot prove more.
    """

    def __init__(self, problem: Problem, tolerance: float, search: Callable) -> None:
        self._problem, self._tolerance, self._search = problem, tolerance, search
        self._condensed = Condensed(problem)
        self._hessian, self._inverse, self._excess = regular(self._condensed.hessian)
        self._lengths = length_weights(problem)[1:].astype(float)
        self._arrival, self._stiff = np.zeros(problem.horizon), 0.0
        if problem.terminal == 'constraint':
            self._arrival = problem.maps.reach[-1, 1:].copy()
            largest = np.diag(self._hessian).max() / np.square(self._arrival).max()
            self._stiff = STIFF * float(largest)
        self._floor = float(problem.floor.fraction) if problem.floor.exists else 0.0

    def _prepare(self) -> None:
        """Compile or load the machine code by its first call: at start-up, not in a tick."""
        if bare(self._search) is self._search:
            steps, n = self._problem.horizon, self._problem.dimension
            start = State.at(np.zeros(n), np.eye(n), wanted=np.eye(n), coasted=np.eye(n))
            with suppress(Infeasible):
                self.solve(Request(start, np.zeros((steps, n)), out_of_time=lambda: True))
        self._search = bare(self._search)

    def solve(self, request: Request) -> Found:
        """Return the best trajectory found, with the tree that proves a bound.

        Raises:
            Infeasible: no trajectory satisfies the constraints.
        """
        raise NotImplementedError

    def _posed(self, request: Request, left: Array) -> StageProblem:
        """Return the problem from a state, with ``left`` to arrive at, shape (n,)."""
        q, constant = self._condensed.affine(request.state, request.goals)
        cost = self._hessian, self._inverse, q, self._lengths, constant
        return StageProblem(*cost, self._floor, self._arrival, left, self._stiff)

    def _left(self, request: Request) -> Array:
        """Return what headings have to add up to, weighted by the arrival's shares, shape (n,)."""
        state, goal = request.state, request.goals[-1]
        if not self._stiff:
            return np.zeros(len(goal))
        left = np.asarray(goal - decided(self._problem, state)[0][-1])
        reach = float(self._arrival.sum())
        if np.linalg.norm(left) > reach + OUT_OF_REACH * (reach or 1.0):
            raise Infeasible('the goal is out of reach')
        return left

    def _run(self, request: Request, posed: StageProblem, tree: Tree, *inputs: object) -> Found:
        """Search from the root; return the result with its proofs; see :meth:`resumed`."""
        tree.counts[:] = 0  # it begins
        self._last = posed, tree, inputs
        return self.proved(request, self.resumed(request))

    def resumed(self, request: Request) -> Found:
        """Go on with the last search until it ends, or the rounds or the time are up; no proof yet.

        Args:
            request: the one that the search began with, but for its rounds.

        Raises:
            Infeasible: the root is empty.
        """
        left, (posed, tree, inputs) = request.rounds, self._last
        while (status := self._search(posed, self._tolerance, tree, *inputs, SLICE)) == PAUSED:
            left -= 1.0
            if request.late or left <= 0.0 or request.enough.met(self._result(tree, posed)):
                break
        if status == EMPTY:
            raise Infeasible('no turns arrive, or meet the cone of approach')
        self.has_ended = status != PAUSED
        return self._result(tree, posed)

    def _result(self, tree: Tree, posed: StageProblem) -> Found:
        """Return the incumbent, with the bound proved so far."""
        value, bound = float(tree.numbers[VALUE]), float(tree.numbers[LEAST])
        best = tree.best.copy() if value < np.inf else None
        values = value + posed.constant, bound - self._excess + posed.constant
        return Found(best, *values, int(tree.counts[NODES]))

    def proved(self, request: Request, found: Found) -> Found:
        """Return a result of the last search with its proof.

        With a deadline also with that of the first nodes, which is verified in one slice; after it
        only with that, which may prove a weaker bound.
        """
        posed, tree, _ = self._last
        made, most = int(tree.counts[MADE]), VERIFIED // len(posed.q)
        if made <= most or request.out_of_time is None:
            return replace(found, proofs=(self._proof(tree, made),))
        first = tree.nodes[: min(made, 2 * most)]  # each split has two children at least
        ends = np.sort((first[:, CHILD] + first[:, CHILDREN])[first[:, CHILD] > 0])
        few = int(ends[ends - np.arange(1, len(ends) + 1) <= most].max(initial=1))
        brief = self._proof(tree, few)
        if not request.late:
            return replace(found, proofs=(self._proof(tree, made), brief))
        leaves = brief.nodes[:, ROW] >= 0
        least = float(tree.progress[:few, KEY][leaves].min()) - self._excess + posed.constant
        return replace(found, lower_bound=min(found.lower_bound, least), proofs=(brief,))

    def _proof(self, tree: Tree, made: int) -> ProofTree:
        """Return the first nodes of the tree as a proof."""
        nodes, at = tree.nodes[:made].copy(), tree.at[:made].copy()
        if made < tree.counts[MADE]:
            unsplit = nodes[:, CHILD] >= made
            nodes[unsplit], at[unsplit] = 0, 0.0
        leaves = np.flatnonzero(nodes[:, ROW] == 0)  # -1 for splits and for empty parts
        nodes[leaves, ROW] = np.arange(len(leaves))
        kept: Array = np.zeros((len(leaves), len(tree.best)))
        if tree.kept.size:
            spare = 2.0 * self._excess / len(tree.best)  # the verifier's cost is less convex
            kept = tree.kept[leaves, 0] - spare
        return ProofTree(
            nodes,
            at,
            tree.point[leaves],
            kept,
            np.zeros(len(leaves), np.int64),
            NO_ROWS,
            NOWHERE,
            tree.pull[leaves] if self._stiff else NOTHING,
        )


class PlanarSearch(TreeSearch):
    """Solver of problems in the plane by branch and bound over stage sets."""

    def __init__(self, problem: Problem, tolerance: float, *, coasting: bool = False) -> None:
        super().__init__(problem, tolerance, search)
        floor = problem.floor
        self._faces = floor.faces if floor.shape == 'polygon' else 0
        self._widest = problem.widest_turn if floor.exists else math.pi
        if self._stiff:
            bent = self._hessian + self._stiff * np.outer(self._arrival, self._arrival)
            self._inverse = np.linalg.inv(bent)
        self.takes_guess = floor.exists  # relaxations over disks need none
        if problem.max_rate or problem.max_acceleration or floor.shape == 'circle' or self._stiff:
            self._tolerance *= SETTLED
        self._prepare()

    @staticmethod
    def solves(problem: Problem, *, coasting: bool = False) -> bool:
        """Return True if stage sets express all limits of a problem, and there is machine code.

        At rotation order 2 this takes a ``coasted`` rotation, and a floor: without one the optimum
        has to come from the interior-point method, for which the first set has no interior.
        """
        floor, aimed, late = problem.floor, problem.approach.exists, problem.rotation_order == 2
        changes = problem.max_rate > 0.0 or problem.max_acceleration > 0.0
        disks = not any((floor.exists, changes, aimed, late))
        straight = disks and not problem.weights.length
        kind = problem.dimension, problem.rotation_order - coasting * late, problem.terminal
        bound_to = aimed or late or problem.inertial or problem.max_acceleration > 0.0
        curved = problem.weights.position > 0.0 or problem.weights.input > 0.0
        moved = problem.decided_steps < problem.horizon  # else the state decides the arrival
        arriving = floor.exists and curved and moved and not bound_to
        longest = LONGEST_INERTIAL if disks and problem.inertial else LONGEST
        return all(
            (
                COMPILED,
                kind == (2, 1, 'penalty') or (kind == (2, 1, 'constraint') and arriving),
                not problem.obstacles,
                straight or floor.shape == 'polygon' or (floor.exists and (changes or late)),
                not (aimed and floor.fraction < problem.least_heading),
                problem.horizon <= longest,
            )
        )

    def solve(self, request: Request) -> Found:
        """Return the best trajectory found, with the tree that proves a bound.

        Raises:
            Infeasible: no turns lead to an allowed last heading.
        """
        ring, posed = self._ring(request.state), self._posed(request, self._left(request))
        thread, steps = get_ident(), self._problem.horizon
        tree, room = tree_for(thread, ROOM // steps, steps, 2, 0), room_for(thread, steps)
        # Copied, since for a read-only or strided array other code would be compiled in a tick.
        guess = NONE if request.guess is None else np.array(request.guess, order='C')
        return self._run(request, posed, tree, ring, guess, room)

    def _ring(self, state: State) -> Ring:
        """Return the floor and the limits of headings and speeds from a state."""
        problem, decided = self._problem, self._problem.rotation_order - 1
        ahead = (state.attitude if state.coasted is None or not decided else state.coasted)[:, 0]
        entry, change, last, within = 1.0, np.inf, 0.0, math.pi
        if problem.max_acceleration > 0.0:
            entry, change = entry_speed(problem, state), problem.speed_change
        if problem.approach.exists:
            axis = problem.approach.axis(state)
            last, within = math.atan2(axis[1], axis[0]), problem.approach.cone + LEEWAY
        first = math.atan2(ahead[1], ahead[0])
        floor = self._floor, self._faces, self._widest
        return Ring(*floor, first, entry, change, last, within, decided)
